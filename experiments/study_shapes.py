"""What the user study and its automatic stand-in judge: random held-out views, and what is made of
them."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from absl import flags

from cvn import data
from cvn.dataset import Dataset, Record, open_dataset, read_record
from cvn.errors import UserError
from cvn.grid import ColoredVoxels
from experiments import protocol

COLORED = tuple(name for name, m in protocol.METHODS.items() if m.color)


class Shape(NamedTuple):
  """A test model and the view that the methods are given."""

  row: int  # of the data set
  view: int
  id: str
  category: str
  azimuth: float  # degrees


class Results(NamedTuple):
  """What the methods make of a shape."""

  shape: Shape
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


def choose(f: flags.FlagValues) -> list[Shape]:
  """Random models of the split test, so many of each category, and a random view of each.

  Raises:
    UserError: there is no finished one.
  """
  dataset = open_dataset(f.data)
  rng = np.random.default_rng(f.study_seed)
  chosen = []
  for category in protocol.categories(f):
    rows = data.select_rows(dataset, 'test', [category], f.source)
    for row in rng.permutation(rows)[: f.shapes]:
      view = int(rng.integers(len(dataset.manifest.azimuths)))
      chosen.append(_shape(dataset, int(row), view))
  if not chosen:
    raise UserError(f'{f.data} has no finished model in the split test')
  return chosen


def describe(shapes: Sequence[Shape]) -> str:
  """How many there are, by category."""
  names = dict.fromkeys(s.category for s in shapes)
  counts = [f'{sum(s.category == c for s in shapes)} {c}' for c in names]
  return f'{len(shapes)} shapes: {", ".join(counts)}'


def reconstruct(f: flags.FlagValues, shapes: Sequence[Shape]) -> Iterator[Results]:
  """Every method's result for each shape; networks that are missing are trained first."""
  dataset = open_dataset(f.data)
  names = list(dict.fromkeys(s.category for s in shapes))
  for trained, judged in protocol.trained_for(f, names):
    predictors = {
      m: protocol.make_predictor(f, m, trained, f.seeds[0]) for m in (f.ours, *f.against)
    }
    for shape in (s for s in shapes if s.category in judged):
      record = read_record(dataset, shape.row)
      view = record.views[[shape.view]].astype(np.float32) / 255
      yield Results(shape, record, {m: predict(view)[0] for m, predict in predictors.items()})


def _shape(dataset: Dataset, row: int, view: int) -> Shape:
  model = dataset.manifest.models[row]
  return Shape(row, view, model.id, model.category, float(dataset.manifest.azimuths[view]))
