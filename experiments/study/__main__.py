r"""The paper's user study as a page: which of two methods' coloured 3D models do people prefer?

python -m experiments.study --data=DIR --workdir=DIR [--ours=blended_0.2]
  [--against=regression,flow] [--shapes=5] [--study_seed=0] [--output=DIR] [...]

The program takes up to 5 random test models of each category and a random view of each. Every
method makes a model of the view, and subjects choose between ours and each of the others. The
folder --output gets

  study.html   the page in one file: hand it to the subjects; it works offline
  key.json     which result belongs to which method; for experiments.study.chart, not for subjects

Each subject sees the pairs in another order and on other sides. The page saves the answers as a
file.
"""

import os
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from absl import flags
from tqdm import tqdm

from cvn import infer
from cvn.dataset import open_dataset
from cvn.files import atomic_write
from cvn.grid import ColoredVoxels
from experiments.lib import cli, picks, pictures, protocol, runs, stages
from experiments.lib.assets import to_png
from experiments.lib.picks import Pick
from experiments.lib.pictures import COLORED, Shown
from experiments.lib.protocol import Plan
from experiments.study import page, turntables
from experiments.study.page import Pair, Study


class Results(NamedTuple):
  """The methods' models of a view."""

  pick: Pick
  shown: Shown
  voxels: dict[str, ColoredVoxels]  # by method


def define_flags(f: flags.FlagValues) -> None:
  protocol.define_flags(f)
  own = {'flag_values': f}
  known = ', '.join(COLORED)
  flags.DEFINE_enum('ours', 'blended_0.2', COLORED, 'Method in every pair.', **own)
  flags.DEFINE_list(
    'against', ['regression', 'flow'], f'Methods to compare with it, of {known}.', **own
  )
  flags.DEFINE_integer('shapes', 5, 'Maximum number of models of each category.', 1, **own)
  flags.DEFINE_integer('study_seed', 0, 'Seed of the choice of models and views.', 0, **own)
  flags.DEFINE_integer(
    'size',
    420,
    'Size of the pictures in pixels, before empty margins are cut off.',
    32,
    1024,
    **own,
  )
  flags.DEFINE_string('output', None, 'A folder; WORKDIR/user_study by default.', **own)
  flags.register_validator(
    'against',
    lambda names: bool(names) and len({*names}) == len(names) and {*names} <= {*COLORED},
    f'must be different ones of {known}',
    f,
  )
  flags.register_multi_flags_validator(
    ['ours', 'against'],
    lambda v: v['ours'] not in v['against'],
    '--against must not name the method of --ours',
    f,
  )
  flags.register_validator('seeds', lambda s: len(s) == 1, 'must be one: that of the networks', f)


@cli.program(define_flags)
def main(f: flags.FlagValues) -> None:
  plan = protocol.read_flags(f)
  chosen = {'seed': f.study_seed, 'per_category': f.shapes}
  shown = pictures.choose(plan, open_dataset(plan.data), **chosen)
  output = f.output or os.path.join(plan.workdir, 'user_study')
  make_study(plan, shown, f.ours, f.against, seed=f.study_seed, size=f.size, output=output)


def make_study(
  plan: Plan,
  shown: Sequence[Pick],
  ours: str,
  against: Sequence[str],
  *,
  seed: int,
  size: int,
  output: str,
) -> None:
  """Reconstructs, draws and writes the page and its key.

  Args:
    plan: how networks are trained.
    shown: the test models and their views.
    ours: the method in every pair.
    against: the methods it is compared with.
    seed: of names and of the order of pairs.
    size: of the pictures in pixels, before the margins are cut off.
    output: the folder.
  """
  counts = Counter(p.model.category for p in shown)
  count = f'{len(shown)} shapes: {", ".join(f"{n} {c}" for c, n in counts.items())}'
  print(f'{count}; seed {seed}')
  methods = [ours, *against]
  rng = np.random.default_rng(seed)
  names = [f'r{n:03d}' for n in rng.permutation(len(shown) * len(methods))]
  views, sheets, key, order = [], {}, {}, []
  progress = tqdm(shown, desc='draw', unit='shape', disable=None)
  for n, results in enumerate(reconstruct(plan, shown, methods)):
    order.append(results.pick)
    views.append(to_png(turntables.crop_to_object(results.shown.view)))
    made = turntables.draw(list(results.voxels.values()), results.pick.azimuth, size)
    for method, sheet in zip(methods, made, strict=True):
      name = names[len(sheets)]
      sheets[name] = sheet
      key[name] = {'shape': n, 'method': method}
    progress.update()
  progress.close()
  pairs = make_pairs(key, ours, rng)
  study = Study(
    f'{count}, chosen with seed {seed}.',
    tuple(views),
    dict(sorted(sheets.items())),
    turntables.FRAMES,
    turntables.COLUMNS,
    pairs,
  )
  path = os.path.join(output, 'study.html')
  with atomic_write(path) as temporary, open(temporary, 'w', encoding='utf-8') as out:
    out.write(page.render(study))
  found = pictures.find_runs(plan, shown, methods)
  report = {
    'page': page.identify(study),
    'study_seed': seed,
    'ours': ours,
    'titles': {m: protocol.METHODS[m].title for m in methods},
    'shapes': [picks.to_json(p) for p in order],
    'results': dict(sorted(key.items())),
    'pairs': {name: pair.sheets for name, pair in pairs.items()},
    'data': plan.data,
    'runs': runs.to_json(run for own in found.values() for run in own.values()),
  }
  stages.write_results(os.path.join(output, 'key.json'), report)
  print(f'{len(pairs)} pairs, {os.path.getsize(path) / 1e6:.1f} MB: {path}')
  print(f'key of the results, not for subjects: {os.path.join(output, "key.json")}')


def reconstruct(plan: Plan, shown: Sequence[Pick], methods: Sequence[str]) -> Iterator[Results]:
  """Every method's model of each view; trains networks that are missing."""
  dataset = open_dataset(plan.data)
  for trained, judged in protocol.trained_for(plan, picks.categories_of(shown)):
    predictors = {m: protocol.make_predictor(plan, m, trained, plan.seeds[0]) for m in methods}
    for pick in (p for p in shown if p.model.category in judged):
      known = pictures.read(dataset, pick)
      found = {m: predict(known.view[None])[0] for m, predict in predictors.items()}
      yield Results(pick, known, {m: infer.to_voxels(x) for m, x in found.items()})


def make_pairs(key: dict[str, dict], ours: str, rng: np.random.Generator) -> dict[str, Pair]:
  """Pairs of our result and each other method's result for the same shape, in random order.

  Args:
    key: {result: {'shape': number, 'method': method}}.
    ours: the method in every pair.
    rng: of the order.
  """
  own = {k['shape']: name for name, k in key.items() if k['method'] == ours}
  found = [
    Pair(k['shape'], tuple(sorted((own[k['shape']], name))))
    for name, k in key.items()
    if k['method'] != ours
  ]
  return {f'p{n:03d}': found[i] for n, i in enumerate(rng.permutation(len(found)))}


if __name__ == '__main__':
  main()
