"""Reads and checks what the other programs left in a --workdir.

Everything is optional: what was not made is None or empty. A file of an unexpected form ends the
report with a line that names it.
"""

import glob
import io
import itertools
import json
import os
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from PIL import Image

from cvn.errors import UserError
from experiments.lib import differences, protocol, results
from experiments.lib.results import Table
from experiments.lib.runs import Run
from experiments.lib.scoring import METRICS
from experiments.lib.stages import damage, read_bytes, read_json, read_seconds
from experiments.paper.people import summary

# The parts of each table.
PARTS: Mapping[str, Sequence[str]] = {
  'iou': ('paper', 'val'),
  'psnr': ('psnr_rgb', 'psnr_ycbcr'),
  'ablation': ('val iou', 'test iou', 'val psnr_rgb', 'test psnr_rgb'),
  'structure': ('iou', 'psnr_rgb'),
  'measures': tuple(METRICS),
}
SOURCES = {  # of models, in words
  'sweethome3d': 'models of Sweet Home 3D',
  'procedural': 'procedural models',
  'humans': 'people made from MakeHuman’s bodies',
  'shapenet': 'models of ShapeNet',
  'im2avatar_release': 'models of the authors’ release',
  'meshes': 'other meshes',
}


class Source(NamedTuple):
  """How a program made its results."""

  argv: list[str]  # its command
  data: str  # the data set
  runs: dict[str, dict[str, Any]]  # configurations and steps of networks, see `runs.to_json`


class Tabled(NamedTuple):
  """The results of a program of tables."""

  source: Source
  parts: dict[str, Table]  # see `PARTS`


class People(NamedTuple):
  """The results of experiments.paper.people."""

  source: Source
  text: str  # Markdown


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
  logged: list[tuple[float, dict[str, float]]]  # (samples, means since the line before)
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
  runs: dict[str, dict[str, Any]]  # the networks, see `evaluation.describe_run`


class Figure(NamedTuple):
  """A picture of WORKDIR/figures or WORKDIR/user_study."""

  name: str
  png: bytes
  facts: dict[str, Any]  # of the JSON file beside it; empty without one


class Workdir(NamedTuple):
  """The contents of a folder."""

  path: str
  key: str  # a name for files, unique among the folders
  label: str  # a name for people, such as 'one network for all categories'
  tables: dict[str, Tabled]  # by the names of `PARTS`
  people: People | None
  trainings: list[Training]
  scores: list[Score]
  figures: dict[str, Figure]  # by name
  study: dict[str, Figure]
  seconds: dict[str, float]  # by command, in order


def read_workdirs(paths: Sequence[str]) -> list[Workdir]:
  """Reads folders and gives them different names.

  Raises:
    UserError: a folder is missing, empty or named twice, or a file is damaged.
  """
  found: list[Workdir] = []
  for path in paths:
    w = read_workdir(path.rstrip('/'))
    if any(w.path == other.path for other in found):
      raise UserError(f'{path} is named twice in --workdir')
    found.append(w._replace(key=_distinct(w.key, [x.key for x in found])))
  first = [w.label for w in found]
  labels: list[str] = []
  for w in found:
    epochs = f', {span([round(t.epochs) for t in w.trainings])} epochs'
    labels.append(_distinct(w.label + epochs * (first.count(w.label) > 1), labels))
  return [w._replace(label=label) for w, label in zip(found, labels, strict=True)]


def read_workdir(path: str) -> Workdir:
  """Reads a folder; raises as `read_workdirs`."""
  if not os.path.isdir(path):
    raise UserError(f'{path} is not a folder: name the --workdir of other programs')
  files = _files(path, 'tables', 'json')
  tables = {n: read_table(p) for n, p in files.items() if n in PARTS}
  trainings = read_trainings(path)
  name = os.path.basename(os.path.abspath(path))
  found = Workdir(
    os.path.abspath(path),
    name,
    label_of(tables, trainings) or name,
    tables,
    read_people(files['people']) if 'people' in files else None,
    trainings,
    [s for p in _files(path, 'scores', 'json').values() if (s := read_score(p))],
    {n: read_figure(p) for n, p in _files(path, 'figures', 'png').items()},
    {n: read_figure(p) for n, p in _files(path, 'user_study', 'png').items()},
    read_seconds(path),
  )
  if not (found.tables or found.people or found.trainings or found.figures or found.study):
    raise UserError(f'{path} holds no results: name the --workdir of other programs')
  return found


def read_table(path: str) -> Tabled:
  """The numbers of a program of tables."""
  found = read_json(path)
  names = PARTS[os.path.splitext(os.path.basename(path))[0]]
  with damage(path):
    return Tabled(
      read_source(found), {name: results.read_table(found['parts'][name]) for name in names}
    )


def read_source(found: Mapping[str, Any]) -> Source:
  """How the results in a file were made."""
  runs = {
    str(name): {**run, 'step': int(run['step']), 'category': list(run['category'])}
    for name, run in found['runs'].items()
  }
  return Source([str(x) for x in found['argv']], str(found['data']), runs)


def read_people(path: str) -> People:
  """The numbers of experiments.paper.people."""
  found = read_json(path)
  with damage(path):
    return People(read_source(found), summary.to_markdown(found))


def read_trainings(path: str) -> list[Training]:
  """All trainings with a log, in the order of the protocol."""
  folders = sorted(glob.glob(os.path.join(glob.escape(path), 'runs', '*')))
  named = [folder for folder in folders if os.path.basename(folder).count('_') >= 2]
  found = [t for folder in named if (t := read_training(folder))]
  known = [*protocol.TRAININGS]
  return sorted(found, key=lambda t: known.index(t.training) if t.training in known else len(known))


def read_training(folder: str) -> Training | None:
  """A training's settings and its log; None if it has logged nothing yet."""
  config_path, log_path = (os.path.join(folder, n) for n in ('config.json', 'log.jsonl'))
  name = os.path.basename(folder)
  if not (os.path.exists(config_path) and os.path.exists(log_path)):
    return None
  config = read_json(config_path)
  with damage(config_path):
    batch = int(config['batch_size'])
    epoch = config['models'] // batch if batch > 0 else 0  # steps
    if not epoch:
      raise ValueError(config)
    differences.describe([Run(folder, config, 0)])  # raises on another form
  text = read_bytes(log_path).decode(errors='replace')
  training, scope, seed = [*name.rsplit('_', 2), '', ''][:3]
  with damage(log_path):
    # The last line may be incomplete while the training is running.
    lines = [json.loads(x) for x in text.splitlines(keepends=True) if x.endswith('\n')]
    lines = [(x, int(x['step'])) for x in lines]
    steps = max((step for _, step in lines), default=0)
    logged, validation = [], []
    for x, n in lines:
      known = validation if 'validation' in x else logged
      values = x.get('validation', {k: v for k, v in x.items() if k not in ('step', 'epoch')})
      known.append((n * batch, {k: float(v) for k, v in values.items()}))
  return Training(
    *(name, training, scope, seed, config),
    *(steps, steps / epoch, steps * batch, logged, validation),
  )


def read_score(path: str) -> Score | None:
  """The networks of a method; None if it was not evaluated on test models.

  The name of the file begins with the method.
  """
  name = os.path.basename(path)
  methods = [m for m in protocol.METHODS if name.startswith(f'{m}_')]
  if not methods:
    return None
  found = read_json(path)
  with damage(path):
    if found['split'] != 'test':
      return None
    return Score(
      max(methods, key=len),
      str(found['data']),
      found['shape'] or '',
      found['color'] or '',
      float(found['threshold']),
      float(found['alpha']),
      {n: str(m['category']) for n, m in found['networks']['by_model'].items()},
      dict(found['options']['runs']),
    )


def read_figure(path: str) -> Figure:
  """A picture and the JSON file beside it."""
  stem = os.path.splitext(path)[0]
  png = read_bytes(path)
  with damage(path):
    Image.open(io.BytesIO(png)).load()
  facts = read_json(f'{stem}.json') if os.path.exists(f'{stem}.json') else {}
  with damage(f'{stem}.json'):
    return Figure(os.path.basename(stem), png, dict(facts))


def span(values: Sequence[float]) -> str:
  """The lowest and the highest of some numbers in words, or the number if they are the same."""
  if not values:
    return 'unknown'
  low, high = min(values), max(values)
  return f'{low:,}' if low == high else f'{low:,} to {high:,}'


def label_of(tables: Mapping[str, Tabled], trainings: Sequence[Training]) -> str:
  """The networks of the tables or, without tables, those that have been trained."""
  if tables:
    used = [*next(iter(tables.values())).source.runs.values()]
  else:
    used = [t.config for t in trainings]
  names = sorted({c for x in used if len(x['category']) == 1 for c in x['category']})
  seeds = {str(x.get('seed')) for x in used}
  sources = {s: None for t in trainings for s in t.config.get('source', [])}
  parts = {
    'one network for all categories': any(len(x['category']) != 1 for x in used),
    f'a network a category ({", ".join(names)})': bool(names),
    f'{len(seeds)} seeds': len(seeds) > 1,
    "also by the authors' recipe": any(t.config.get('recipe') == 'release' for t in trainings),
    f'trained only on {" and ".join(SOURCES.get(s, s) for s in sources)}': bool(sources),
  }
  return ', '.join(part for part, holds in parts.items() if holds)


def _distinct(name: str, taken: Sequence[str]) -> str:
  """The name, with a number behind it if it is taken."""
  numbered = (f'{name}-{n}' for n in itertools.count(2))
  return next(x for x in itertools.chain([name], numbered) if x not in taken)


def _files(path: str, folder: str, suffix: str) -> dict[str, str]:
  found = sorted(glob.glob(os.path.join(glob.escape(path), folder, f'*.{suffix}')))
  return {os.path.splitext(os.path.basename(p))[0]: p for p in found}
