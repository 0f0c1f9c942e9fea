"""The report on how its numbers were made: data, protocol, trainings, commands, versions."""

import importlib.metadata
import math
import os
import platform
import re
import shlex
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from cvn import checkpoint
from cvn.dataset import SPLITS, Dataset, Model, open_dataset, read_json, surface_counts, to_url
from cvn.ops import compile as compiling
from experiments.lib import differences, markdown, stages
from experiments.lib.differences import PAPER, PAPER_VIEWS
from experiments.lib.markdown import NONE, escape
from experiments.lib.page import Block
from experiments.lib.runs import Run
from experiments.report import plots
from experiments.report.read import SOURCES, Source, Workdir, span

# The program of each table or figure, by the name of its file.
PROGRAMS = {
  **{
    n: f'experiments.paper.{n}'
    for n in ('iou', 'psnr', 'ablation', 'measures', 'structure', 'people')
  },
  **{
    n: f'experiments.paper.figures.{n}'
    for n in ('intermediate', 'random', 'nearest', 'flow', 'threshold')
  },
}
PACKAGES = (
  *('cvn', 'jax', 'jaxlib', 'flax', 'optax', 'orbax-checkpoint', 'grain', 'tensorstore', 'numpy'),
  *('scipy', 'scikit-image', 'mitsuba', 'trimesh', 'pillow', 'matplotlib'),
)


class Data(NamedTuple):
  """A data set and its finished models."""

  name: str
  dataset: Dataset
  finished: list[Model]


def open_all(workdirs: Sequence[Workdir]) -> dict[str, Data]:
  """The data sets of all results that are still in their places, by URL.

  Raises:
    UserError: one is damaged.
  """
  urls = dict.fromkeys(u for w in workdirs for u in data_of(w))
  return {u: open_data(u) for u in urls if read_json(u, 'manifest.json') is not None}


def data_of(w: Workdir) -> list[str]:
  """The URLs of the data sets of a folder's results."""
  found = [s.data for s in w.scores] + [t.source.data for t in w.tables.values()]
  found += [w.people.source.data] if w.people else []
  found += [t.config['data'] for t in w.trainings if 'data' in t.config]
  return list(dict.fromkeys(to_url(d) for d in found))


def open_data(url: str) -> Data:
  """A data set."""
  dataset = open_dataset(url)
  finished = np.flatnonzero(surface_counts(dataset) > 0)
  return Data(
    os.path.basename(url.rstrip('/')), dataset, [dataset.manifest.models[n] for n in finished]
  )


def heading(workdirs: Sequence[Workdir], w: Workdir) -> list[Block]:
  """The folder of the next blocks, if there are several folders."""
  return [f'### {escape(w.label[0].upper() + w.label[1:])}'] if len(workdirs) > 1 else []


def missing(what: str, program: str, flags: str = '--data=DATA --workdir=WORKDIR') -> Block:
  """Stands in for results that have not been made yet."""
  return f'> *{escape(what)}: not made yet.* `python -m {program} {flags}`'


def outdated(w: Workdir, source: Source) -> list[Block]:
  """A warning if networks have changed since results were made with them."""
  lines = []
  for t in w.trainings:
    known = source.runs.get(t.name)
    config = {k: v for k, v in t.config.items() if k not in checkpoint.NOT_COMPARED}
    if known and (known['step'] != t.steps or not known.items() >= config.items()):
      lines.append(
        f'Made with {t.name} at step {known["step"]:,}; it has been trained to step {t.steps:,}'
        ' since. Run the command again to update the numbers.'
      )
  return [markdown.items(lines)] if lines else []


def abstract(workdirs: Sequence[Workdir], data: Mapping[str, Data]) -> list[Block]:
  """What was run, and its limits, in a few sentences."""
  trainings = [t for w in workdirs for t in w.trainings]
  sets = [_sources(d.finished) for d in data.values() if d.finished]
  said = (
    f'{len(trainings)} trainings of the networks of Im2Avatar (Sun, Liu, Wang and Sarma, 2018)'
    + (f' on {"; ".join(sets)}' if sets else '')
    + ', evaluated on held-out models by the paper’s measures: mean IoU of shapes and surface PSNR'
    ' of colours. Every number below was printed by a command that is listed at the end.'
  )
  sources = {m.source for d in data.values() for m in d.dataset.manifest.models}
  limits = []
  if sources and not sources & {'shapenet', 'im2avatar_release'}:
    limits.append('the models are not ShapeNet’s')
  seen = [t.samples for t in trainings]
  if seen and max(seen) < PAPER_VIEWS[0]:
    limits.append(
      f'a network has seen {span(seen)} views, the paper’s networks {PAPER_VIEWS[0]:,} to'
      f' {PAPER_VIEWS[1]:,}'
    )
  if not limits:
    return [escape(said)]
  warning = (
    f'This is not the paper’s protocol: {"; and ".join(limits)}. The numbers compare the methods'
    ' with each other under one small budget; they do not measure what the method can reach. The'
    ' paper’s numbers stand beside them for the order of the methods, not for their height.'
  )
  return [escape(said), escape(warning)]


def protocol_blocks(workdirs: Sequence[Workdir], data: Mapping[str, Data]) -> list[Block]:
  """The paper's protocol beside those of the folders, and the models of each data set."""
  columns = [_protocol(w, data) for w in workdirs]
  rows = [[k, *map(escape, (PAPER[k], *(c[k] for c in columns)))] for k in PAPER]
  head = ['', 'paper', *(escape(w.label) for w in workdirs)]
  table = f'{markdown.strong("Protocol, here and in the paper")}\n\n{markdown.table(head, rows)}'
  return [table, *map(counts_table, data.values())]


def counts_table(data: Data) -> str:
  """How many finished models of each category there are, by source and split."""
  counts = Counter((m.source, m.split, m.category) for m in data.finished)
  columns = [(s, split) for s in dict.fromkeys(m.source for m in data.finished) for split in SPLITS]
  rows = [
    [escape(c), *(counts[*column, c] for column in columns)]
    for c in sorted({m.category for m in data.finished})
  ]
  rows.append(['all', *(sum(row[n + 1] for row in rows) for n in range(len(columns)))])
  views = len(data.dataset.manifest.azimuths)
  caption = f'Data set “{data.name}”: finished models by source and split, {views} views each'
  head = ['', *(f'{escape(source)}, {split}' for source, split in columns)]
  return markdown.numbers(head, rows, caption=caption)


def trainings(workdirs: Sequence[Workdir]) -> list[Block]:
  """All trainings: curves, and how long they were."""
  found = []
  for w in workdirs:
    if w.trainings:
      caption = 'Loss in training (lines) and on held-out models of the split val (dots).'
      curves = plots.training_curves(w.trainings, f'training_{w.key}', caption)
      found += [*heading(workdirs, w), curves, _trainings_table(w)]
  return found or [missing('Trainings', PROGRAMS['iou'])]


def _trainings_table(w: Workdir) -> str:
  rows = []
  for t in w.trainings:
    last = t.validation[-1][1] if t.validation else {}
    spent = sum(s for line, s in w.seconds.items() if f'/runs/{t.name} ' in f'{line} ')
    cells = [t.config.get('recipe', NONE), t.seed, f'{t.epochs:.3g}', f'{t.steps:,}']
    cells += [f'{t.samples:,}', *(f'{last[k]:.4f}' if k in last else NONE for k in ('loss', 'iou'))]
    rows.append(
      [escape(f'{t.training} ({t.scope})'), *cells, f'{spent / 60:.0f}' if spent else NONE]
    )
  head = ['', 'recipe', 'seed', 'epochs', 'steps', 'views seen', 'loss, val', 'IoU, val', 'minutes']
  return markdown.numbers(head, rows, caption='Trainings; on val after the last epoch')


def repeat(workdirs: Sequence[Workdir], data: Mapping[str, Data]) -> list[Block]:
  """The commands in their order, and the durations that were measured."""
  folders = dict.fromkeys(map(_parent, data.values()))
  ran = {k: v for folder in folders for k, v in stages.read_seconds(folder).items()}
  ran |= {k: v for w in workdirs for k, v in w.seconds.items()}
  blocks: list[Block] = [
    'These programs, in this order. Each trains and evaluates what is missing, and continues where'
    ' it stopped:',
    markdown.commands((line, math.nan) for line in commands(workdirs, folders)),
  ]
  if ran:
    title = f'What they ran: {len(ran)} commands, {sum(ran.values()) / 3600:.1f} hours in all'
    lines = markdown.commands((shorten(line), seconds) for line, seconds in ran.items())
    blocks.append(markdown.fold(title, lines))
  return blocks


def commands(workdirs: Sequence[Workdir], folders: Iterable[str]) -> list[str]:
  """The stored commands of all results, in an order that works.

  Args:
    workdirs: with the results.
    folders: of data sets.
  """
  collections = [os.path.join(folder, 'collection.json') for folder in folders]
  found = [stages.read_json(path)['argv'] for path in collections if os.path.exists(path)]
  for w in workdirs:
    known = {name: t.source.argv for name, t in w.tables.items()}
    known |= {'people': w.people.source.argv} if w.people else {}
    found += [known[name] for name in PROGRAMS if name in known]
    found += [f.facts.get('argv', []) for f in (*w.figures.values(), *w.study.values())]
  found.append(stages.argv())
  return list(dict.fromkeys(shorten(shlex.join(map(str, words))) for words in found if words))


def shorten(line: str) -> str:
  """A command with the last names of absolute paths: the others are of no use elsewhere."""
  return re.sub(r'(?<=[=,])(?:file://)?/[^\s,\'"]*?([^\s,\'"/]+)/?(?=[\s,\'"]|$)', r'\1', line)


def versions(workdirs: Sequence[Workdir], seed: int) -> list[Block]:
  """Seeds, machine and versions."""
  seeds = [
    f'networks, {w.label}: {", ".join(dict.fromkeys(t.seed for t in w.trainings))}'
    for w in workdirs
    if w.trainings
  ]
  for w in workdirs:
    for f in (*w.figures.values(), *w.study.values()):
      for key in ('figure_seed', 'study_seed'):
        if key in f.facts:
          seeds.append(f'choice of models in “{f.name}”: {f.facts[key]}')
  seeds.append(f'choice of models to turn: {seed}')
  system = f'{platform.system()} {platform.machine()}, Python {platform.python_version()}'
  rows = [('machine', f'{compiling.processor_name()}, {os.cpu_count()} cores'), ('system', system)]
  rows += [(package, _version(package)) for package in PACKAGES]
  caption = markdown.strong('Versions and machine of this report')
  table = markdown.table(['', 'version'], [[escape(x) for x in row] for row in rows])
  return ['### Seeds', markdown.items(seeds), f'{caption}\n\n{table}']


def licences(data: Mapping[str, Data]) -> list[Block]:
  """The creators of the models, and the terms of use."""
  if data:
    return [licence_table(d) for d in data.values()]
  return [missing('The data sets', 'experiments.collection', '--output=DATA')]


def licence_table(data: Data) -> str:
  """Models by source and licence, with the names of their creators."""
  creators = defaultdict(Counter)
  for m in data.finished:
    creators[m.source, m.licence or 'not stated'][m.creator or 'not stated'] += 1
  rows = []
  for (source, licence), names in sorted(creators.items()):
    ranked = sorted(names.items(), key=lambda x: (-x[1], x[0].lower()))
    listed = ', '.join(f'{name} ({n})' if n > 1 else name for name, n in ranked)
    rows.append([escape(source), sum(names.values()), escape(licence), escape(listed)])
  caption = f'Data set “{data.name}”: licences and creators as stated by the sources'
  head = ['', 'models', 'licence', 'creators']
  return f'{markdown.strong(caption)}\n\n{markdown.table(head, rows)}'


def _parent(data: Data) -> str:
  """The folder that holds a data set."""
  return os.path.dirname(data.dataset.root.removeprefix('file://').rstrip('/'))


def _protocol(w: Workdir, data: Mapping[str, Data]) -> dict[str, str]:
  configs = [t.config for t in w.trainings]
  own = [d for u, d in data.items() if u in {to_url(c.get('data', '')) for c in configs}]
  judged = {name: category for s in w.scores for name, category in s.models.items()}
  tested = ', '.join(f'{n} {c}' for c, n in Counter(judged.values()).items())
  return differences.describe([Run(t.name, t.config, t.steps) for t in w.trainings]) | {
    'data': '; '.join(_sources(d.finished) for d in own) or 'not there',
    'networks': w.label,
    'models to train on': span([c['models'] for c in configs]) + ' a network',
    'models to test on': tested or 'not evaluated yet',
    'epochs': span([round(t.epochs) for t in w.trainings]),
    'views seen by a network': span([t.samples for t in w.trainings]),
    'seeds': ', '.join(dict.fromkeys(t.seed for t in w.trainings)) or 'unknown',
  }


def _sources(models: Iterable[Model]) -> str:
  counts = Counter(m.source for m in models)
  return ', '.join(f'{n:,} {SOURCES.get(s, f"models of {s}")}' for s, n in counts.items())


def _version(package: str) -> str:
  try:
    return importlib.metadata.version(package)
  except importlib.metadata.PackageNotFoundError:
    return 'not installed'
