"""The report's sections: what was found in the folders, in the order of the paper."""

import datetime
from collections.abc import Sequence

from experiments.report import facts, making, models, plots, setting
from experiments.report.blocks import (
  Block,
  Cell,
  Items,
  Missing,
  Picture,
  Report,
  Section,
  Table,
  Text,
)
from experiments.report.results import Figure, People, Workdir
from experiments.report.setting import heading, missing, outdated
from experiments.report.tables import ablation_table, estimate_cell, methods_table

TITLE = 'Colourful 3D reconstruction from a single picture: the paper’s experiments, run again'
FIGURES = {
  'intermediate': 'Intermediate results',
  'random': 'Randomly selected results',
  'nearest': 'Sampling from the nearest foreground',
  'flow': 'Flow of a symmetric object',
  'loss': 'Training in float32, in mixed precision, and with surface heads',
}
CHART = 760  # CSS pixels that a chart of another program is wide at most
DIAMONDS = 'Whiskers: one standard error over test models. Diamonds: the paper’s numbers.'


def make_report(workdirs: Sequence[Workdir], *, per_category: int, seed: int) -> Report:
  """The report of what is there.

  Args:
    workdirs: what was read.
    per_category: models to turn, of each category.
    seed: of their choice.

  Raises:
    UserError: a data set or a network is damaged.
  """
  data = {}
  for url in dict.fromkeys(u for w in workdirs for u in facts.data_of(w)):
    opened = facts.open_data(url)
    if opened:
      data[url] = opened
  sections = [
    Section('glance', 'At a glance', _glance(workdirs)),
    Section('models', 'Models to turn', _models(workdirs, data, per_category, seed)),
    Section('protocol', 'What was run', _protocol(workdirs, data)),
    Section('shapes', 'Table 1: shapes', _shapes(workdirs)),
    Section('colours', 'Tables 2 and 3: surface colours', _colours(workdirs)),
    Section('best', 'Beyond the paper: the recipe best', _ablation(workdirs)),
    Section('structure', 'One network or two', _structure(workdirs)),
    Section('people', 'Articulated objects', _people(workdirs)),
    Section('figures', 'Pictures', _figures(workdirs)),
    Section('study', 'What people prefer', _study(workdirs)),
    Section('training', 'Training', making.training(workdirs)),
    Section('repeat', 'How to repeat it', making.repeat(workdirs, data)),
    Section('versions', 'Seeds, versions, machine', making.versions(workdirs, seed)),
    Section('data', 'Data, licences, credits', making.licences(data)),
  ]
  made = f'Made on {datetime.date.today():%d %B %Y} by `python -m experiments.report`.'
  kept = [s for s in sections if s.blocks]
  return Report(TITLE, setting.abstract(workdirs, data), made, kept)


def _glance(workdirs) -> list[Block]:
  measures = {
    ('iou', 'val'): 'IoU: Ours (MSFCEL), minus',
    ('psnr', 'psnr_rgb'): 'PSNR RGB, dB: Ours (α = 0.2), minus',
  }
  panels = {
    title: {
      w.label: w.tables[name].parts[part].comparisons
      for w in workdirs
      if name in w.tables and w.tables[name].parts[part].comparisons
    }
    for (name, part), title in measures.items()
  }
  panels = {title: found for title, found in panels.items() if found}
  if not panels:
    return [missing('Tables 1 to 3', 'experiments.paper.iou')]
  caption = (
    'The paper’s method against the others, model by model: right of the line it is better.'
    ' Whiskers: one standard error over test models; ticks: single seeds. For the IoU, every'
    ' method’s threshold of occupancy is chosen on val.'
  )
  return [plots.differences(panels, 'glance', caption)]


def _models(workdirs, data, per_category, seed) -> list[Block]:
  if not per_category:
    return []
  found = []
  for w in workdirs:
    for url in (u for u in facts.data_of(w) if u in data):
      options = {'per_category': per_category, 'seed': seed, 'name': f'models_{w.key}'}
      examples = models.make_examples(w, data[url], **options)
      if examples:
        found += [*heading(workdirs, w), examples]
  if not found:
    return [
      Missing(
        'No networks for colours with their data set are in place. They come with',
        'python -m experiments.paper.psnr --data=DATA --workdir=WORKDIR',
      )
    ]
  return [
    Text(
      'Held-out objects: the picture that the networks are given, what they make of it, and the'
      ' truth. Drag to turn; once turned, scroll to come closer. Models of a line turn together.'
    ),
    *found,
  ]


def _protocol(workdirs, data) -> list[Block]:
  tables = [facts.counts_table(d) for d in data.values()]
  return [setting.differences_table(workdirs, data), *tables]


def _shapes(workdirs) -> list[Block]:
  found = []
  for w in workdirs:
    if 'iou' not in w.tables:
      continue
    parts = w.tables['iou'].parts
    titles = {
      'paper': 'Mean IoU, occupied where p > 0.8 as in the authors’ program (R2N2: chosen on val)',
      'val': 'Mean IoU, threshold chosen on val for every method',
    }
    found += [*heading(workdirs, w), *outdated(w, w.tables['iou'].source)]
    for part, title in titles.items():
      found += methods_table(parts[part], '.3f', title)
    panels = {'p > 0.8': parts['paper'], 'threshold chosen on val': parts['val']}
    found.append(plots.bars(panels, f'iou_{w.key}', 'mean IoU', DIAMONDS))
  return _explained(found, 'Table 1', 'experiments.paper.iou')


def _colours(workdirs) -> list[Block]:
  found = []
  for w in workdirs:
    if 'psnr' not in w.tables:
      continue
    parts = w.tables['psnr'].parts
    found += [*heading(workdirs, w), *outdated(w, w.tables['psnr'].source)]
    for part, title in (('psnr_rgb', 'RGB'), ('psnr_ycbcr', 'YCbCr')):
      found += methods_table(parts[part], '.2f', f'Mean surface PSNR, {title}, dB')
    panels = {'RGB': parts['psnr_rgb'], 'YCbCr': parts['psnr_ycbcr']}
    found.append(plots.bars(panels, f'psnr_{w.key}', 'surface PSNR, dB', DIAMONDS))
  return _explained(found, 'Tables 2 and 3', 'experiments.paper.psnr')


def _explained(found: list[Block], what: str, program: str) -> list[Block]:
  """With how the numbers are to be read, or with how to get some."""
  if not found:
    return [missing(what, program)]
  return [
    Text(
      'In brackets behind a category: its test models. A number is the mean over models and all'
      ' their views, ± one standard error over models; “avg.” is the mean of the categories, ± the'
      ' standard deviation over seeds where there are several. The best of a column is bold.'
    ),
    *found,
  ]


def _ablation(workdirs) -> list[Block]:
  found = []
  for w in workdirs:
    if 'ablation' in w.tables:
      parts = w.tables['ablation'].parts
      caption = 'Each line adds one thing to those above it; means over all models, and gains'
      plot = plots.ablation(
        parts, f'ablation_{w.key}', 'What each step brings; chosen on val, only told on test.'
      )
      known = outdated(w, w.tables['ablation'].source)
      found += [*heading(workdirs, w), *known, *ablation_table(parts, caption), plot]
  return found or [missing('The ablation', 'experiments.paper.ablation')]


def _structure(workdirs) -> list[Block]:
  found = []
  for w in workdirs:
    if 'structure' in w.tables:
      parts = w.tables['structure'].parts
      found += [*heading(workdirs, w), *outdated(w, w.tables['structure'].source)]
      found += methods_table(parts['iou'], '.3f', 'Mean IoU')
      found += methods_table(parts['psnr_rgb'], '.2f', 'Mean surface PSNR, RGB, dB')
    if 'structure' in w.figures:
      found.append(_picture(w, w.figures['structure'], 'Results of both'))
  return found or [missing('The model structure analysis', 'experiments.paper.structure')]


def _people(workdirs) -> list[Block]:
  found = []
  for w in workdirs:
    if w.people:
      found += [*heading(workdirs, w), *outdated(w, w.people.source), *_analysis(w.people)]
    for name, title, width in (
      ('azimuth', 'Mean IoU by the azimuth of the input view, 95 % band over models', CHART),
      ('complexity', 'Mean IoU by the colour complexity of the input view', CHART * 2 // 3),
      ('results', 'Reconstructions of random test models', 0),
    ):
      if (figure := w.figures.get(f'people_{name}')) is not None:
        found.append(_picture(w, figure, title, width))
  return found or [missing('The analysis of people', 'experiments.paper.people')]


def _analysis(p: People) -> list[Block]:
  forms = {
    'iou': ('mean IoU', '.3f'),
    'baseline_iou': ('mean IoU of the mean training shape', '.3f'),
    'psnr_rgb': ('surface PSNR RGB, dB', '.2f'),
    'psnr_ycbcr': ('surface PSNR YCbCr, dB', '.2f'),
  }
  rows = [(title, [estimate_cell(p.means[k], form)]) for k, (title, form) in forms.items()]
  rows += [
    ('IoU of side views', [estimate_cell(p.sides, '.3f')]),
    ('IoU of front and back views', [estimate_cell(p.front_and_back, '.3f')]),
    ('difference, model by model', [estimate_cell(p.difference, '+.3f')]),
    ('rank correlation of colour complexity and IoU', [estimate_cell(p.correlation, '+.2f')]),
  ]
  groups = [
    (complexity, [Cell(str(views)), Cell(str(models)), estimate_cell(iou, '.3f')])
    for complexity, views, models, iou in p.by_complexity
  ]
  return [
    Text(
      f'{p.models} test models ({p.category}). In brackets: 95 % intervals over models. The paper'
      ' finds side views better than front and back, and a high IoU up to some 40 colours.'
    ),
    Items(p.networks),
    Table('People: shapes and colours', [], ['here'], rows),
    Table('People: IoU by colour complexity', [], ['views', 'of models', 'IoU'], groups),
  ]


def _figures(workdirs) -> list[Block]:
  found = []
  for w in workdirs:
    own = {n: w.figures[n] for n in FIGURES if n in w.figures}
    elsewhere = ('structure', 'people_')
    own |= {n: f for n, f in w.figures.items() if n not in own and not n.startswith(elsewhere)}
    if own:
      found += heading(workdirs, w)
    found += [_picture(w, f, FIGURES.get(n, n.replace('_', ' '))) for n, f in own.items()]
  made = {n for w in workdirs for n in w.figures}
  return found + [
    missing(title, setting.PROGRAMS[n]) for n, title in FIGURES.items() if n not in made
  ]


def _study(workdirs) -> list[Block]:
  found = []
  titles = {
    'preferences': 'User study: how often the blended result was preferred',
    'standin': 'Automatic stand-in for the user study, no person was asked: which result is closer'
    ' to the truth in drawings from 12 azimuths',
  }
  for w in workdirs:
    own = [n for n in titles if n in w.study]
    if own:
      found += heading(workdirs, w)
    for n in own:
      found.append(_picture(w, w.study[n], titles[n], CHART))
  made = {n for w in workdirs for n in w.study}
  if 'preferences' not in made:
    found.append(
      Missing(
        'No person has been asked. The page for subjects is made, and their answers counted, by',
        'python -m experiments.study --data=DATA --workdir=WORKDIR; python -m'
        ' experiments.study.chart --results=ANSWERS --study=WORKDIR/user_study',
      )
    )
  if 'standin' not in made:
    found.append(missing('The automatic stand-in', 'experiments.study.standin'))
  return found


def _picture(w: Workdir, figure: Figure, title: str, width: int = 0) -> Picture:
  """A figure with its caption below it."""
  caption = str(figure.facts.get('caption', ''))
  name = f'{figure.name}_{w.key}'
  return Picture(name, figure.png, f'{title}. {caption}'.rstrip(), width=width)
