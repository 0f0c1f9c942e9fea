"""What the other programs left in a --workdir, read and checked for the report.

Everything is optional: what was not made is None or empty. A file that is there and is not what its
program writes ends the report with a line that names it.
"""

import contextlib
import functools
import glob
import io
import itertools
import json
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from PIL import Image

from cvn.errors import UserError
from cvn.evaluation.intervals import Estimate
from experiments.lib import differences, protocol
from experiments.lib.runs import Run
from experiments.lib.stages import read_bytes, read_json
from experiments.lib.tables import Comparison
from experiments.report.results import (
  Figure,
  Line,
  Lines,
  Number,
  People,
  Score,
  Source,
  Tabled,
  Training,
  Workdir,
  label_of,
  span,
)

# The parts of each table that is read.
PARTS: Mapping[str, Sequence[str]] = {
  'iou': ('paper', 'val'),
  'psnr': ('psnr_rgb', 'psnr_ycbcr'),
  'ablation': ('val iou', 'test iou', 'val psnr_rgb', 'test psnr_rgb'),
  'structure': ('iou', 'psnr_rgb'),
}


def read_workdirs(paths: Sequence[str]) -> list[Workdir]:
  """Reads all of some folders, and gives them names that differ.

  Raises:
    UserError: there is no such folder, nothing in it, or a damaged file.
  """
  found: list[Workdir] = []
  for path in paths:
    w = read_workdir(path.rstrip('/'))
    if any(w.path == other.path for other in found):
      raise UserError(f'{path} is named twice in --workdir')
    found.append(w._replace(key=_distinct(w.key, [x.key for x in found])))
  told = [w.label for w in found]
  labels: list[str] = []
  for w in found:
    label = (
      f'{w.label}, {span([round(t.epochs) for t in w.trainings])} epochs'
      if told.count(w.label) > 1
      else w.label
    )
    labels.append(_distinct(label, labels))
  return [w._replace(label=label) for w, label in zip(found, labels, strict=True)]


def read_workdir(path: str) -> Workdir:
  """Reads all of a folder; raises as `read_workdirs`."""
  if not os.path.isdir(path):
    raise UserError(f'{path} is no folder: name what other programs were given as --workdir')
  tables = {n: read_table(p) for n, p in _files(path, 'tables', 'json').items() if n in PARTS}
  people = _files(path, 'tables', 'json').get('people')
  pictures = _files(path, 'figures', 'png')
  pictures |= {n: p for n, p in _files(path, '', 'png').items() if n == 'loss'}
  trainings = read_trainings(path)
  found = Workdir(
    os.path.abspath(path),
    os.path.basename(os.path.abspath(path)),
    label_of(tables, trainings) or os.path.basename(os.path.abspath(path)),
    tables,
    read_people(people) if people else None,
    trainings,
    [s for p in _files(path, 'scores', 'json').values() if (s := read_score(p))],
    {n: read_figure(p) for n, p in pictures.items()},
    {n: read_figure(p) for n, p in _files(path, 'user_study', 'png').items()},
    read_seconds(os.path.join(path, 'seconds.json')),
  )
  if not (found.tables or found.people or found.trainings or found.figures or found.study):
    raise UserError(f'{path} holds no results: name what other programs were given as --workdir')
  return found


def read_table(path: str) -> Tabled:
  """The numbers of experiments.paper.iou, table_psnr, ablation or structure."""
  table = read_json(path)
  name = os.path.splitext(os.path.basename(path))[0]
  with damage(path):
    parts = {part: _lines(functools.reduce(dict.get, part.split(), table)) for part in PARTS[name]}
    return Tabled(read_source(table), parts)


def read_source(found: Mapping[str, Any]) -> Source:
  """What a file of results tells of how they were made."""
  runs = {
    str(name): {**run, 'step': int(run['step']), 'category': list(run['category'])}
    for name, run in found['runs'].items()
  }
  return Source([str(x) for x in found['argv']], str(found['data']), runs)


def read_people(path: str) -> People:
  """The numbers of experiments.people."""
  found = read_json(path)
  with damage(path):
    return People(
      read_source(found),
      str(found['category']),
      [str(n) for n in found['networks']],
      len(found['test_models']),
      {k: _estimate(found[k]) for k in ('iou', 'baseline_iou', 'psnr_rgb', 'psnr_ycbcr')},
      *(_estimate(found[k]) for k in ('sides', 'front_and_back', 'difference')),
      [
        (span([g['lowest'], g['highest']]), g['views'], g['models'], _estimate(g['iou']))
        for g in found['by_complexity']
      ],
      _estimate(found['correlation']),
    )


def read_trainings(path: str) -> list[Training]:
  """All that have begun, in the order of the protocol."""
  folders = sorted(glob.glob(_in(path, 'runs', '*')))
  found = [t for folder in folders if (t := read_training(folder))]
  known = [*protocol.TRAININGS]
  return sorted(found, key=lambda t: known.index(t.training) if t.training in known else len(known))


def read_training(folder: str) -> Training | None:
  """A training's settings and its log; None where it has not begun to tell anything."""
  config_path, log_path = (os.path.join(folder, n) for n in ('config.json', 'log.jsonl'))
  name = os.path.basename(folder)
  if not (os.path.exists(config_path) and os.path.exists(log_path) and name.count('_') >= 2):
    return None
  config = read_json(config_path)
  with damage(config_path):
    batch = int(config['batch_size'])
    epoch = config['models'] // batch if batch > 0 else 0  # steps
    if not epoch:
      raise ValueError(config)
    differences.describe([Run(folder, config, 0)])  # raises where it is of another form
  text = read_bytes(log_path).decode(errors='replace')
  training, scope, seed = name.rsplit('_', 2)
  with damage(log_path):
    # The last line is cut where the training is being written or was stopped.
    lines = [json.loads(x) for x in text.splitlines(keepends=True) if x.endswith('\n')]
    lines = [(x, int(x['step'])) for x in lines]
    steps = max((step for _, step in lines), default=0)
    return Training(
      name,
      training,
      scope,
      seed,
      config,
      steps,
      steps / epoch,
      steps * batch,
      [(n * batch, float(x['loss'])) for x, n in lines if 'loss' in x],
      [
        (n * batch, {k: float(v) for k, v in x['validation'].items()})
        for x, n in lines
        if 'validation' in x
      ],
    )


def read_score(path: str) -> Score | None:
  """What a method's networks are; None where it was not judged on test models.

  The file's name begins with the method's.
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
  """A picture and what the JSON file beside it says."""
  stem = os.path.splitext(path)[0]
  png = read_bytes(path)
  with damage(path):
    Image.open(io.BytesIO(png)).load()
  facts = read_json(f'{stem}.json') if os.path.exists(f'{stem}.json') else {}
  with damage(f'{stem}.json'):
    return Figure(os.path.basename(stem), png, dict(facts))


def read_seconds(path: str) -> dict[str, float]:
  """Commands and their seconds; none where nothing was noted."""
  if not os.path.exists(path):
    return {}
  found = read_json(path)
  with damage(path):
    return {str(line): float(seconds) for line, seconds in found.items()}


@contextlib.contextmanager
def damage(path: str) -> Iterator[None]:
  """Turns what reading a file of another form raises into a `UserError` that names it."""
  try:
    yield
  except (AttributeError, IndexError, KeyError, OSError, TypeError, ValueError) as e:
    raise UserError(f'{path} is damaged or of another version: remove it and make it again') from e


def _distinct(name: str, taken: Sequence[str]) -> str:
  """The name, with a number behind it where others have it."""
  numbered = (f'{name}-{n}' for n in itertools.count(2))
  return next(x for x in itertools.chain([name], numbered) if x not in taken)


def _files(path: str, folder: str, suffix: str) -> dict[str, str]:
  found = sorted(glob.glob(_in(path, folder, f'*.{suffix}')))
  return {os.path.splitext(os.path.basename(p))[0]: p for p in found}


def _in(path, *names):
  return os.path.join(glob.escape(path), *names)


def _lines(part) -> Lines:
  return Lines(_rows(part['rows']), [_comparison(c) for c in part['comparisons']])


def _comparison(found) -> Comparison:
  c = Comparison(**found)
  numbers = (c.difference, c.error, c.models, c.median, c.above, *c.seeds)
  if not all(isinstance(x, int | float) for x in numbers):
    raise ValueError(found)
  return c._replace(better=str(c.better), other=str(c.other))


def _rows(rows) -> list[Line]:
  if not rows:
    raise ValueError(rows)
  return [_line(r) for r in rows]


def _line(row) -> Line:
  def number(c):
    mean, error, published = (_float(c[k]) for k in ('mean', 'error', 'published'))
    return Number(mean, error, int(c['models']), published)

  average = row['average']
  return Line(
    str(row['title']),
    {name: number(c) for name, c in row['categories'].items()},
    [_float(x) for x in average['seeds']],
    _float(average['published']),
  )


def _estimate(found) -> Estimate:
  return Estimate(*(_float(found[k]) for k in Estimate._fields))


def _float(x) -> float:
  return math.nan if x is None else float(x)
