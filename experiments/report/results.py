"""What the report knows of each --workdir: the results of other programs, read and checked."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from cvn.evaluation.intervals import Estimate
from experiments.lib.tables import Comparison

# Of models, in words.
SOURCES = {
  'sweethome3d': 'models of Sweet Home 3D',
  'procedural': 'procedural models',
  'humans': 'people made from MakeHuman’s bodies',
  'shapenet': 'models of ShapeNet',
  'im2avatar_release': 'models of the authors’ release',
  'meshes': 'other meshes',
}


class Number(NamedTuple):
  """A method in a category; NaN where there is no number."""

  mean: float
  error: float  # standard error over models
  models: int
  published: float


class Line(NamedTuple):
  """A method in a table."""

  title: str
  categories: dict[str, Number]
  seeds: list[float]  # the mean of the categories' means, one a seed
  published: float  # the paper's mean of the categories


class Lines(NamedTuple):
  """A table of methods."""

  rows: list[Line]
  comparisons: list[Comparison]


class Source(NamedTuple):
  """What a program told of how it made its results."""

  argv: list[str]  # its command
  data: str  # the data set
  runs: dict[str, dict[str, Any]]  # configurations and steps of networks, see `runs.to_json`


class Tabled(NamedTuple):
  """What one program of tables found."""

  source: Source
  parts: dict[str, Lines]  # see `read.PARTS`


class People(NamedTuple):
  """What experiments.paper.people found."""

  source: Source
  category: str
  networks: list[str]
  models: int
  means: dict[str, Estimate]  # by metric; 'baseline_iou': of the mean training shape
  sides: Estimate
  front_and_back: Estimate
  difference: Estimate
  by_complexity: list[tuple[str, int, int, Estimate]]  # complexity, views, models, IoU
  correlation: Estimate


class Training(NamedTuple):
  """A network's training."""

  name: str  # of its folder
  training: str  # a key of `protocol.TRAININGS`
  scope: str  # the category, or `protocol.ALL`
  seed: str
  config: dict[str, Any]
  steps: int
  epochs: float
  samples: int  # views seen
  loss: list[tuple[float, float]]  # (samples, mean over the steps since the one before)
  validation: list[tuple[float, dict[str, float]]]  # (samples, metrics)


class Score(NamedTuple):
  """A method's evaluation on test models."""

  method: str  # a key of `protocol.METHODS`
  data: str
  shape: str  # folder of the network; '' for none
  color: str
  threshold: float
  alpha: float
  models: dict[str, str]  # category of each model, by id
  runs: dict[str, dict[str, Any]]  # what identifies the networks, see `evaluation.describe_run`


class Figure(NamedTuple):
  """A picture of WORKDIR/figures or WORKDIR/user_study."""

  name: str
  png: bytes
  facts: dict[str, Any]  # of the JSON file beside it; empty without one


class Workdir(NamedTuple):
  """All that was found in a folder."""

  path: str
  key: str  # its name, no other's; for names of files
  label: str  # what tells it from others, such as 'one network for all categories'
  tables: dict[str, Tabled]  # by name: iou, psnr, ablation, structure
  people: People | None
  trainings: list[Training]
  scores: list[Score]
  figures: dict[str, Figure]  # by name
  study: dict[str, Figure]  # preferences, standin
  seconds: dict[str, float]  # by command, in their order


def span(values: Sequence[float]) -> str:
  """The lowest and the highest of some numbers, or the one that they are, in words."""
  if not values:
    return 'not told'
  low, high = min(values), max(values)
  return f'{low:,}' if low == high else f'{low:,} to {high:,}'


def label_of(tables: Mapping[str, Tabled], trainings: Sequence[Training]) -> str:
  """What networks the tables are of or, without tables, which have been trained."""
  if tables:
    used = [*next(iter(tables.values())).source.runs.values()]
  else:
    used = [t.config for t in trainings]
  names = sorted({c for x in used if len(x['category']) == 1 for c in x['category']})
  seeds = {str(x.get('seed')) for x in used}
  parts = ['one network for all categories'] * any(len(x['category']) != 1 for x in used)
  parts += [f'a network a category ({", ".join(names)})'] * bool(names)
  parts += [f'{len(seeds)} seeds'] * (len(seeds) > 1)
  sources = {s: None for t in trainings for s in t.config.get('source', [])}
  parts += ["also by the authors' recipe"] * any(
    t.config.get('recipe') == 'release' for t in trainings
  )
  parts += [f'trained on {" and ".join(SOURCES.get(s, s) for s in sources)} alone'] * bool(sources)
  return ', '.join(parts)
