"""The report's sections on the protocol: deviations from the paper's, and the commands."""

import os
import shlex
from collections.abc import Iterable, Sequence

from cvn import checkpoint
from cvn.dataset import to_url
from experiments.lib import differences
from experiments.lib.differences import PAPER, PAPER_VIEWS
from experiments.lib.runs import Run
from experiments.lib.stages import argv, read_json
from experiments.report.blocks import Block, Cell, Heading, Items, Missing, Table
from experiments.report.facts import Data, finished_in, shorten
from experiments.report.results import SOURCES, Source, Workdir, span

# The program of each table or figure, by the name of what it leaves.
PROGRAMS = {
  'iou': 'experiments.paper.iou',
  'psnr': 'experiments.paper.psnr',
  'ablation': 'experiments.paper.ablation',
  'structure': 'experiments.paper.structure',
  'people': 'experiments.paper.people',
  'intermediate': 'experiments.paper.figures.intermediate',
  'random': 'experiments.paper.figures.random',
  'nearest': 'experiments.paper.figures.nearest',
  'flow': 'experiments.paper.figures.flow',
  'loss': 'experiments.compare_training',
}


def heading(workdirs: Sequence[Workdir], w: Workdir) -> list[Block]:
  """Which folder the next blocks are of, where there are several."""
  return [Heading(w.label[0].upper() + w.label[1:])] if len(workdirs) > 1 else []


def missing(what: str, program: str) -> Missing:
  """In the place of what a program has not made yet."""
  return Missing(f'{what}: not made yet.', f'python -m {program} --data=DATA --workdir=WORKDIR')


def outdated(w: Workdir, source: Source) -> list[Block]:
  """A warning where networks are no longer those that results were made of."""
  lines = []
  for t in w.trainings:
    told = source.runs.get(t.name)
    if told and (told['step'] != t.steps or not told.items() >= _compared(t.config).items()):
      lines.append(
        f'Made of {t.name} at step {told["step"]:,}; it has been trained to step {t.steps:,} since.'
        ' The same command again makes the numbers of now.'
      )
  return [Items(lines)] if lines else []


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
  """The programs whose results these are, as they were called, in an order that works."""
  found = [_collection(folder) for folder in dict.fromkeys(map(parent, data.values()))]
  for w in workdirs:
    told = {name: t.source.argv for name, t in w.tables.items()}
    told |= {'people': w.people.source.argv} if w.people else {}
    found += [told[name] for name in (*PROGRAMS, *told) if name in told]
    found += [f.facts.get('argv', []) for f in (*w.figures.values(), *w.study.values())]
  found.append(argv())
  lines = dict.fromkeys(shlex.join(map(str, words)) for words in found if words)
  return [shorten(x, folders(workdirs, data)) for x in lines]


def _collection(folder: str) -> list[str]:
  """The command that made the data sets of a folder; empty where another one did."""
  path = os.path.join(folder, 'collection.json')
  return read_json(path)['argv'] if os.path.exists(path) else []


def folders(workdirs: Iterable[Workdir], data: dict[str, Data]) -> list[str]:
  """Places that commands name."""
  places = [os.path.abspath(w.path) for w in workdirs]
  return places + [parent(d) for d in data.values()]


def parent(data: Data) -> str:
  """The folder that holds a data set, and those that were made with it."""
  return os.path.dirname(data.dataset.root.removeprefix('file://').rstrip('/'))


def _protocol(w: Workdir, data: dict[str, Data]) -> dict[str, str]:
  configs = [t.config for t in w.trainings]
  own = [d for u, d in data.items() if u in {to_url(c.get('data', '')) for c in configs}]
  judged = {name: category for s in w.scores for name, category in s.models.items()}
  return differences.describe([Run(t.name, t.config, t.steps) for t in w.trainings]) | {
    'data': '; '.join(_sources(_all(d)) for d in own) or 'not there',
    'networks': w.label,
    'models to train on': span([c['models'] for c in configs]) + ' a network',
    'models to test on': _count(judged.values()) or 'not evaluated yet',
    'epochs': span([round(t.epochs) for t in w.trainings]),
    'views seen by a network': span([t.samples for t in w.trainings]),
    'seeds': ', '.join(dict.fromkeys(t.seed for t in w.trainings)) or 'not told',
  }


def _compared(config):
  return {k: v for k, v in config.items() if k not in checkpoint.NOT_COMPARED}


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
