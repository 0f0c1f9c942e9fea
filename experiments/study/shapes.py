"""Random held-out views and the methods' results for them, for the user study and its stand-in."""

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from absl import flags

from cvn import infer
from cvn.dataset import Record, open_dataset, read_record
from cvn.grid import ColoredVoxels
from experiments.lib import picks, pictures, protocol, runs
from experiments.lib.picks import Pick
from experiments.lib.pictures import COLORED
from experiments.lib.protocol import Plan


class Results(NamedTuple):
  """What the methods make of a view."""

  pick: Pick
  record: Record
  voxels: dict[str, ColoredVoxels]  # by method


def define_flags(f: flags.FlagValues) -> None:
  """Flags of the choice of shapes and methods, besides those of `protocol`."""
  own = {'flag_values': f}
  flags.DEFINE_enum('ours', 'blended_0.2', COLORED, 'The method that is compared.', **own)
  flags.DEFINE_list(
    'against',
    ['regression', 'flow'],
    f'The methods it is compared with: {", ".join(COLORED)}.',
    **own,
  )
  flags.DEFINE_integer('shapes', 5, 'Of each category, where it has as many.', lower_bound=1, **own)
  flags.DEFINE_integer('study_seed', 0, 'Of shapes and views.', lower_bound=0, **own)
  flags.register_validator(
    'against',
    lambda names: bool(names) and len({*names}) == len(names) and {*names} <= {*COLORED},
    f'must be different ones of {", ".join(COLORED)}',
    f,
  )
  flags.register_multi_flags_validator(
    ['ours', 'against'],
    lambda v: v['ours'] not in v['against'],
    '--against must not name the method of --ours',
    f,
  )
  flags.register_validator('seeds', lambda s: len(s) == 1, 'must be one: that of the networks', f)


def choose(plan: Plan, *, shapes: int, seed: int) -> list[Pick]:
  """Random test models, so many of each category, and a random view of each; see `picks.choose`."""
  options = {'sources': plan.sources, 'per_category': shapes, 'seed': seed}
  return picks.choose(open_dataset(plan.data), protocol.categories(plan), **options)


def describe(shown: Sequence[Pick]) -> str:
  """How many there are, by category."""
  counts = Counter(p.model.category for p in shown)
  return f'{len(shown)} shapes: {", ".join(f"{n} {c}" for c, n in counts.items())}'


def reconstruct(plan: Plan, shown: Sequence[Pick], methods: Sequence[str]) -> Iterator[Results]:
  """Every method's result for each view; networks that are missing are trained first."""
  dataset = open_dataset(plan.data)
  for trained, judged in protocol.trained_for(plan, picks.categories_of(shown)):
    predictors = {m: protocol.make_predictor(plan, m, trained, plan.seeds[0]) for m in methods}
    for pick in (p for p in shown if p.model.category in judged):
      record = read_record(dataset, pick.row)
      view = record.views[[pick.view]]
      found = {m: infer.to_voxels(predict(view)[0]) for m, predict in predictors.items()}
      yield Results(pick, record, found)


def describe_networks(plan: Plan, shown: Sequence[Pick], methods: Sequence[str]) -> dict[str, Any]:
  """The data set and the runs of the networks, as JSON values."""
  found = pictures.find_runs(plan, shown, methods)
  used = [run for own in found.values() for run in own.values()]
  return {'data': plan.data, 'runs': runs.to_json(used)}
