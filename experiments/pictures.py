"""What the programs of figures share: the models and views they show, and the files they leave.

A figure NAME is WORKDIR/figures/NAME.png; NAME.json beside it tells what it shows. Models and views
are drawn at random and not chosen: whoever gives the same --figure_seed sees the same ones.

Volumes are drawn as seen from SIDE degrees beside the input's camera, and from the opposite side.
"""

import functools
import json
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from absl import flags
from PIL import Image
from tqdm import tqdm

from cvn import data, figures
from cvn.dataset import Dataset, Model, read_record
from cvn.errors import UserError
from cvn.files import atomic_write
from cvn.grid import ColoredVoxels
from experiments import protocol, scoring, tables

SIDE = 30  # degrees
COLORED = tuple(name for name, m in protocol.METHODS.items() if m.color)


class Example(NamedTuple):
  """A test model and one of its views."""

  row: int
  view: int
  model: Model
  azimuth: float  # of the view, degrees


class Shown(NamedTuple):
  """What the data set has of an example."""

  view: np.ndarray  # [H, W, 4] u8
  batch: np.ndarray  # the same as networks take it: [1, H, W, 4] in [0, 1]
  true: ColoredVoxels


def define_flags(f: flags.FlagValues, name: str) -> None:
  """The flags of every figure; `name` is its own."""
  own = {'flag_values': f}
  protocol.define_flags(f)
  flags.DEFINE_string('name', name, 'Of the files, below WORKDIR/figures.', **own)
  flags.DEFINE_integer('tile', 192, 'Pixels of each small picture.', lower_bound=32, **own)


def define_choice_flags(f: flags.FlagValues, per_category: int) -> None:
  """The flags of figures that show models drawn at random."""
  own = {'flag_values': f}
  flags.DEFINE_integer('figure_seed', 0, 'Of the choice of models and views.', 0, **own)
  flags.DEFINE_integer('per_category', per_category, 'Test models of each category.', 1, **own)


def choose(f: flags.FlagValues, dataset: Dataset) -> list[Example]:
  """Test models of each category and a view of each, at random.

  Raises:
    UserError: there is no test model.
  """
  rng = np.random.default_rng(f.figure_seed)
  azimuths = dataset.manifest.azimuths
  examples = []
  for category in protocol.categories(f):
    rows = data.select_rows(dataset, 'test', [category], f.source)
    for row in rng.permutation(rows)[: f.per_category]:
      examples.append(example_of(dataset, row, rng.integers(len(azimuths))))
  if not examples:
    raise UserError(f'{f.data} has no finished model in the split test')
  return examples


def example_of(dataset: Dataset, row: int, view: int) -> Example:
  """The example of a row and a view."""
  m = dataset.manifest
  return Example(int(row), int(view), m.models[row], m.azimuths[view])


def categories_of(examples: Sequence[Example]) -> list[str]:
  """Of each example."""
  return [e.model.category for e in examples]


def read(dataset: Dataset, example: Example) -> Shown:
  """The example's view and true voxels."""
  record = read_record(dataset, example.row)
  view = record.views[example.view]
  true = scoring.to_voxels(record, dataset.manifest.grid_size)
  return Shown(view, view[None].astype(np.float32) / 255, true)


def by_category(
  f: flags.FlagValues, categories: Iterable[str], make: Callable[[str], Any]
) -> dict[str, Any]:
  """What is made of networks, by category.

  Args:
    f: the flags.
    categories: any may occur more than once.
    make: takes what networks are trained on, a category or `protocol.ALL`.
  """
  found = {}
  for trained_on, judged in protocol.trained_for(f, list(dict.fromkeys(categories))):
    found |= dict.fromkeys(judged, make(trained_on))
  return found


def title_of(method: str) -> str:
  """A method's title in the letters that pictures have."""
  return protocol.METHODS[method].title.replace('α', 'alpha').replace(' (', '\n(')


def arrange(
  rows: Sequence[Sequence[np.ndarray]], titles: Sequence[str], examples: Sequence[Example]
) -> np.ndarray:
  """Rows of tiles, one an example, with their titles: category and the view's azimuth."""
  return figures.grid_of_images(
    figures.trim(rows),
    column_titles=titles,
    row_titles=[f'{e.model.category}\n{e.azimuth:g}°' for e in examples],
  )


def draw(
  f: flags.FlagValues, voxels: ColoredVoxels, example: Example, turn: float = 0
) -> np.ndarray:
  """Voxels as seen from beside the example's view, turned further by degrees."""
  return figures.draw_voxels(voxels, example.azimuth + SIDE + turn, size=f.tile)


def draw_results(
  f: flags.FlagValues, dataset: Dataset, examples: Sequence[Example], methods: Sequence[str]
) -> np.ndarray:
  """Rows of examples: the input, each method's result and the truth, from two opposite sides."""
  shown = [read(dataset, e) for e in examples]
  rows = [[figures.enlarge(s.view, f.tile)] for s in shown]

  def add(results):
    for row, voxels, e in zip(rows, results, examples, strict=True):
      row += [draw(f, voxels, e, turn) for turn in (0, 180)]

  for method in tqdm(methods, desc='draw', unit='method', disable=None):
    make = functools.partial(protocol.make_predictor, f, method, seed=f.seeds[0])
    predictors = by_category(f, categories_of(examples), make)
    add(predictors[e.model.category](s.batch)[0] for e, s in zip(examples, shown, strict=True))
  add(s.true for s in shown)
  titles = ['input']
  for title in (*map(title_of, methods), 'truth'):
    titles += [title, 'from behind']
  return arrange(rows, titles, examples)


def draw_flow_code(size: int) -> np.ndarray:
  """The colour code of flows: the place (u, v) of the input in its colour."""
  ticks = (np.arange(size) + 0.5) / size
  return figures.to_uint8(figures.flow_color_code(np.stack(np.meshgrid(ticks, ticks), -1)))


def describe_choice(f: flags.FlagValues) -> dict[str, int]:
  """The flags that chose models and views, as JSON values."""
  return {'figure_seed': f.figure_seed, 'per_category': f.per_category}


def say_choice(f: flags.FlagValues) -> str:
  """How the models were chosen, for a caption."""
  return f'Test models and views drawn at random, not chosen: seed {f.figure_seed}.'


def say_training(f: flags.FlagValues) -> str:
  """Which networks these are, for a caption."""
  scope = 'for all categories' if f.models == protocol.ALL else 'a category'
  epochs = 1 if f.quick else f.epochs
  return f'Networks: one {scope}, epochs: {epochs}, seed {f.seeds[0]}.'


def describe(
  f: flags.FlagValues,
  examples: Sequence[Example],
  methods: Sequence[str],
  trainings: Sequence[str] = (),
) -> dict[str, Any]:
  """What a figure shows, as JSON values.

  Args:
    f: the flags.
    examples: in the order of the figure's rows.
    methods: keys of `protocol.METHODS`.
    trainings: whose networks it shows; by default all that the methods have.
  """
  used = trainings or sorted(
    {t for m in methods for t in (protocol.METHODS[m].shape, protocol.METHODS[m].color)}
  )

  def networks(trained_on):
    folders = {t: protocol.train(f, t, trained_on, f.seeds[0]) for t in used}
    return {t: os.path.relpath(folder, f.workdir) for t, folder in folders.items()}

  return {
    **tables.describe(f),
    'seed': f.seeds[0],
    'methods': {m: protocol.METHODS[m].title for m in methods},
    'networks': by_category(f, categories_of(examples), networks),
    'rows': [
      {'azimuth': e.azimuth, **{k: v for k, v in e.model._asdict().items() if k != 'split'}}
      for e in examples
    ],
  }


def write(f: flags.FlagValues, image: np.ndarray, caption: str, facts: Mapping[str, Any]) -> None:
  """Writes a figure with a caption below it, and what it shows; prints where.

  Args:
    f: the flags.
    image: uint8 [H, W, 3].
    caption: for people.
    facts: for programs, JSON values.
  """
  stem = os.path.join(f.workdir, 'figures', f.name)
  image = figures.stack([image, figures.draw_text(caption, image.shape[1])])
  with atomic_write(f'{stem}.png') as temporary:
    Image.fromarray(image).save(temporary)
  with atomic_write(f'{stem}.json') as temporary, open(temporary, 'w') as out:
    out.write(json.dumps({'caption': caption, **facts}, indent=1) + '\n')
  print(f'{stem}.png\n{stem}.json')
