"""What the programs of figures share: how they draw models and views, and the files they leave.

A figure NAME is WORKDIR/figures/NAME.png; NAME.json beside it has its caption, what it shows and
the command that made it.

Volumes are drawn as seen from SIDE degrees beside the input's camera, and from the opposite side.
"""

import json
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from absl import flags
from PIL import Image
from tqdm import tqdm

from cvn import figures, infer
from cvn.dataset import Dataset, read_record
from cvn.files import atomic_write
from cvn.grid import ColoredVoxels
from experiments.lib import differences, picks, protocol, runs, scoring
from experiments.lib.picks import Pick
from experiments.lib.protocol import Plan
from experiments.lib.runs import Run
from experiments.lib.stages import argv

SIDE = 30  # degrees
COLORED = tuple(name for name, m in protocol.METHODS.items() if m.color)
Runs = Mapping[str, Mapping[str, Run]]  # by category, then by training


class Shown(NamedTuple):
  """What the data set has of a pick."""

  view: np.ndarray  # [H, W, 4] u8
  true: ColoredVoxels


def define_flags(f: flags.FlagValues, name: str) -> None:
  """The flags of every figure; `name` is its own."""
  own = {'flag_values': f}
  protocol.define_flags(f)
  flags.DEFINE_string('name', name, 'The name of the files in WORKDIR/figures.', **own)
  flags.DEFINE_integer('tile', 192, 'Pixels of each small picture.', lower_bound=32, **own)


def define_choice_flags(f: flags.FlagValues, per_category: int) -> None:
  """The flags of figures that show models drawn at random."""
  own = {'flag_values': f}
  flags.DEFINE_integer('figure_seed', 0, 'The seed of the choice of models and views.', 0, **own)
  flags.DEFINE_integer('per_category', per_category, 'Test models of each category.', 1, **own)


def choose(plan: Plan, dataset: Dataset, *, seed: int, per_category: int) -> list[Pick]:
  """Random test models of the plan's categories and sources; see `picks.choose`."""
  options = {'sources': plan.sources, 'per_category': per_category, 'seed': seed}
  return picks.choose(dataset, protocol.categories(plan), **options)


def read(dataset: Dataset, pick: Pick) -> Shown:
  """The pick's view and true voxels."""
  record = read_record(dataset, pick.row)
  view = record.views[pick.view]
  true = scoring.to_voxels(record, dataset.manifest.grid_size)
  return Shown(view, true)


def by_category(
  plan: Plan, categories: Iterable[str], make: Callable[[str], Any]
) -> dict[str, Any]:
  """What is made of networks, by category.

  Args:
    plan: how networks are trained.
    categories: any may occur more than once.
    make: takes what networks are trained on, a category or `protocol.ALL`.
  """
  found = {}
  for trained_on, judged in protocol.trained_for(plan, list(dict.fromkeys(categories))):
    found |= dict.fromkeys(judged, make(trained_on))
  return found


def title_of(method: str) -> str:
  """A method's title in the letters that pictures have."""
  return protocol.METHODS[method].title.replace('α', 'alpha').replace(' (', '\n(')


def arrange(
  rows: Sequence[Sequence[np.ndarray]], titles: Sequence[str], shown: Sequence[Pick]
) -> np.ndarray:
  """Rows of tiles, one for each pick, with their titles: category and the view's azimuth."""
  return figures.grid_of_images(
    figures.trim(rows),
    column_titles=titles,
    row_titles=[f'{p.model.category}\n{p.azimuth:g}°' for p in shown],
  )


def draw(voxels: ColoredVoxels, pick: Pick, *, tile: int, turn: float = 0) -> np.ndarray:
  """Voxels as seen from beside the pick's view, turned further by degrees; `tile` pixels wide."""
  return figures.draw_voxels(voxels, pick.azimuth + SIDE + turn, size=tile)


def draw_results(
  plan: Plan, dataset: Dataset, shown: Sequence[Pick], methods: Sequence[str], *, tile: int
) -> np.ndarray:
  """Rows of picks: the input, each method's result and the truth, from two opposite sides."""
  known = [read(dataset, p) for p in shown]
  rows = [[figures.enlarge(k.view, tile)] for k in known]

  def add(results):
    for row, voxels, p in zip(rows, results, shown, strict=True):
      row += [draw(voxels, p, tile=tile, turn=turn) for turn in (0, 180)]

  categories = [p.model.category for p in shown]
  for method in tqdm(methods, desc='draw', unit='method', disable=None):
    predictors = by_category(
      plan, categories, lambda c, m=method: protocol.make_predictor(plan, m, c, plan.seeds[0])
    )
    add(
      infer.to_voxels(predictors[c](k.view[None])[0])
      for c, k in zip(categories, known, strict=True)
    )
  add(k.true for k in known)
  titles = ['input']
  for title in (*map(title_of, methods), 'truth'):
    titles += [title, 'from behind']
  return arrange(rows, titles, shown)


def draw_flow_code(size: int) -> np.ndarray:
  """The colour code of flows: the place (u, v) of the input in its colour."""
  ticks = (np.arange(size) + 0.5) / size
  return figures.to_uint8(figures.flow_color_code(np.stack(np.meshgrid(ticks, ticks), -1)))


def say_choice(seed: int) -> str:
  """How the models were chosen, for a caption."""
  return f'Test models and views drawn at random, not chosen: seed {seed}.'


def find_runs(
  plan: Plan, shown: Sequence[Pick], methods: Sequence[str], trainings: Sequence[str] = ()
) -> Runs:
  """The runs of the networks that a figure shows.

  Args:
    plan: how they are trained.
    shown: the figure's picks.
    methods: keys of `protocol.METHODS`.
    trainings: of the networks that it shows; by default all that the methods have.
  """
  used = trainings or sorted(
    {t for m in methods for t in (protocol.METHODS[m].shape, protocol.METHODS[m].color)}
  )

  def find(trained_on):
    return {t: protocol.train(plan, t, trained_on, plan.seeds[0]) for t in used}

  return by_category(plan, picks.categories_of(shown), find)


def say_training(found: Runs) -> str:
  """Which networks these are, for a caption."""
  return differences.say_training(_each(found))


def describe(
  plan: Plan, shown: Sequence[Pick], methods: Sequence[str], found: Runs
) -> dict[str, Any]:
  """What a figure shows, as JSON values.

  Args:
    plan: how its networks are trained.
    shown: in the order of the figure's rows.
    methods: keys of `protocol.METHODS`.
    found: the runs of its networks.
  """
  return {
    'data': plan.data,
    'methods': {m: protocol.METHODS[m].title for m in methods},
    'networks': {
      category: {t: os.path.relpath(run.workdir, plan.workdir) for t, run in own.items()}
      for category, own in found.items()
    },
    'runs': runs.to_json(_each(found)),
    'rows': [picks.to_json(p) for p in shown],
  }


def write(stem: str, image: np.ndarray, caption: str, facts: Mapping[str, Any]) -> None:
  """Writes a figure, and beside it its caption and what it shows; prints where.

  Args:
    stem: the path without suffix.
    image: uint8 [H, W, 3].
    caption: for people.
    facts: for programs, JSON values.
  """
  with atomic_write(f'{stem}.png') as temporary:
    Image.fromarray(image).save(temporary)
  write_facts(stem, caption, facts)
  print(f'{stem}.png\n{stem}.json')


def write_facts(stem: str, caption: str, facts: Mapping[str, Any]) -> None:
  """Writes STEM.json: a figure's caption, its facts, and the command that made it."""
  with atomic_write(f'{stem}.json') as temporary, open(temporary, 'w') as out:
    out.write(json.dumps({'caption': caption, 'argv': argv(), **facts}, indent=1) + '\n')


def _each(found: Runs) -> list[Run]:
  return [run for own in found.values() for run in own.values()]
