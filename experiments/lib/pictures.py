"""Shared by the programs of figures: drawing models and views, and the files of a figure.

A figure NAME is WORKDIR/figures/NAME.png. NAME.json beside it has its caption, its contents and the
command that made it. Volumes are drawn from SIDE degrees beside the input's camera.
"""

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from absl import flags
from PIL import Image
from tqdm import tqdm

from cvn import figures, infer
from cvn.dataset import Dataset, open_dataset, read_record
from cvn.files import atomic_write
from cvn.grid import ColoredVoxels
from experiments.lib import differences, picks, protocol, runs, scoring, stages
from experiments.lib.picks import Pick
from experiments.lib.protocol import Plan, Predictor
from experiments.lib.runs import Run

SIDE = 30  # degrees
COLORED = tuple(name for name, m in protocol.METHODS.items() if m.color)


class Shown(NamedTuple):
  """A pick's data."""

  view: np.ndarray  # [H, W, 4] u8
  true: ColoredVoxels


def define_flags(f: flags.FlagValues, name: str) -> None:
  """The flags of every figure; `name` is the default of --name."""
  own = {'flag_values': f}
  protocol.define_flags(f)
  flags.DEFINE_string('name', name, 'Name of the files in WORKDIR/figures.', **own)
  flags.DEFINE_integer('tile', 192, 'Size of each small picture in pixels.', lower_bound=32, **own)


def define_choice_flags(f: flags.FlagValues, per_category: int) -> None:
  """The flags of figures that show random models."""
  own = {'flag_values': f}
  flags.DEFINE_integer('figure_seed', 0, 'Seed of the choice of models and views.', 0, **own)
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
  """Something made of networks for each category.

  Args:
    plan: how networks are trained.
    categories: may repeat.
    make: called once for each set of networks, with the category they are trained on or
      `protocol.ALL`.
  """
  found = {}
  for trained_on, judged in protocol.trained_for(plan, list(dict.fromkeys(categories))):
    found |= dict.fromkeys(judged, make(trained_on))
  return found


def find_predictors(plan: Plan, categories: Iterable[str], method: str) -> dict[str, Predictor]:
  """A method's predictors by category; trains and evaluates what is missing."""
  seed = plan.seeds[0]
  return by_category(plan, categories, lambda c: protocol.make_predictor(plan, method, c, seed))


def arrange(
  rows: Sequence[Sequence[np.ndarray]], titles: Sequence[str], shown: Sequence[Pick]
) -> np.ndarray:
  """Rows of tiles, one for each pick, with their titles: category and azimuth of the view."""
  return figures.grid_of_images(
    figures.trim(rows),
    column_titles=titles,
    row_titles=[f'{p.model.category}\n{p.azimuth:g}°' for p in shown],
  )


def draw(voxels: ColoredVoxels, pick: Pick, *, tile: int, turn: float = 0) -> np.ndarray:
  """Draws voxels from beside the pick's view, turned by further degrees; `tile` pixels wide."""
  return figures.draw_voxels(voxels, pick.azimuth + SIDE + turn, size=tile)


def make_random(
  plan: Plan, methods: Sequence[str], *, name: str, tile: int, seed: int, per_category: int
) -> None:
  """Draws and writes the results of methods for random test models and views.

  Args:
    plan: how networks are trained; what is missing is trained.
    methods: keys of `protocol.METHODS`.
    name: of the figure.
    tile: size of each small picture in pixels.
    seed: of the choice.
    per_category: models of each category.
  """
  dataset = open_dataset(plan.data)
  shown = choose(plan, dataset, seed=seed, per_category=per_category)
  image = draw_results(plan, dataset, shown, methods, tile=tile)
  found = find_runs(plan, shown, methods)
  caption = f'{say_choice(seed)} {say_training(found)}'
  write(plan, name, image, caption, shown, methods, found, figure_seed=seed)


def draw_results(
  plan: Plan, dataset: Dataset, shown: Sequence[Pick], methods: Sequence[str], *, tile: int
) -> np.ndarray:
  """A row for each pick: the input, each method's result and the truth, from two opposite sides."""
  known = [read(dataset, p) for p in shown]
  rows = [[figures.enlarge(k.view, tile)] for k in known]

  def add(results):
    for row, voxels, p in zip(rows, results, shown, strict=True):
      row += [draw(voxels, p, tile=tile, turn=turn) for turn in (0, 180)]

  categories = [p.model.category for p in shown]
  for method in tqdm(methods, desc='draw', unit='method', disable=None):
    predictors = find_predictors(plan, categories, method)
    add(
      infer.to_voxels(predictors[c](k.view[None])[0])
      for c, k in zip(categories, known, strict=True)
    )
  add(k.true for k in known)
  # The font of pictures has no Greek letters.
  names = [protocol.METHODS[m].title.replace('α', 'alpha').replace(' (', '\n(') for m in methods]
  titles = [t for name in (*names, 'truth') for t in (name, 'from behind')]
  return arrange(rows, ['input', *titles], shown)


def draw_flow_code(size: int) -> np.ndarray:
  """The colour code of flows: each place (u, v) of the input in its colour."""
  ticks = (np.arange(size) + 0.5) / size
  return figures.to_uint8(figures.flow_color_code(np.stack(np.meshgrid(ticks, ticks), -1)))


def say_choice(seed: int) -> str:
  """How the models were chosen, for a caption."""
  return f'Random test models and views, seed {seed}; none was chosen by eye.'


def find_runs(
  plan: Plan, shown: Sequence[Pick], methods: Sequence[str], trainings: Sequence[str] = ()
) -> dict[str, dict[str, Run]]:
  """The runs of the networks in a figure, by category and training.

  Args:
    plan: how they are trained.
    shown: the figure's picks.
    methods: keys of `protocol.METHODS`.
    trainings: of the networks; by default all trainings of the methods.
  """
  used = trainings or sorted(
    {t for m in methods for t in (protocol.METHODS[m].shape, protocol.METHODS[m].color)}
  )

  def find(trained_on):
    return {t: protocol.train(plan, t, trained_on, plan.seeds[0]) for t in used}

  return by_category(plan, picks.categories_of(shown), find)


def say_training(found: Mapping[str, Mapping[str, Run]]) -> str:
  """Which networks a figure shows, for a caption."""
  return differences.say_training(run for own in found.values() for run in own.values())


def write(
  plan: Plan,
  name: str,
  image: np.ndarray,
  caption: str,
  shown: Sequence[Pick],
  methods: Sequence[str],
  found: Mapping[str, Mapping[str, Run]],
  **facts: Any,
) -> None:
  """Writes a figure and the file beside it, and prints their paths.

  Args:
    plan: how the networks are trained.
    name: of the figure.
    image: uint8 [H, W, 3].
    caption: for people.
    shown: the picks in the order of the rows.
    methods: keys of `protocol.METHODS`.
    found: of `find_runs`.
    **facts: more to store, as JSON values.
  """
  stem = os.path.join(plan.workdir, 'figures', name)
  with atomic_write(f'{stem}.png') as temporary:
    Image.fromarray(image).save(temporary)
  known = {
    'caption': caption,
    'data': plan.data,
    'methods': {m: protocol.METHODS[m].title for m in methods},
    'networks': {
      category: {t: os.path.relpath(run.workdir, plan.workdir) for t, run in own.items()}
      for category, own in found.items()
    },
    'runs': runs.to_json(run for own in found.values() for run in own.values()),
    'rows': [picks.to_json(p) for p in shown],
  }
  stages.write_results(f'{stem}.json', known | facts)
  print(f'{stem}.png\n{stem}.json')
