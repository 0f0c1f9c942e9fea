"""The report's sections: what was found in the folders, in the order of the paper."""

import datetime
from collections.abc import Mapping, Sequence

from experiments.lib import tables
from experiments.lib.page import Block, Picture
from experiments.report import models, plots, setting
from experiments.report.read import Figure, Workdir
from experiments.report.setting import PROGRAMS, Data, heading, missing, outdated

TITLE = 'Colourful 3D reconstruction from a single picture: the paper’s experiments, run again'
FIGURES = {
  'intermediate': 'Intermediate results',
  'random': 'Random results',
  'nearest': 'Sampling from the nearest foreground',
  'flow': 'Flow of a symmetric object',
  'threshold': 'IoU by the occupancy threshold',
}
PEOPLE = {  # titles and widths in CSS pixels
  'azimuth': ('Mean IoU by the azimuth of the input view, 95 % band over models', 760),
  'complexity': ('Mean IoU by the colour complexity of the input view', 507),
  'results': ('Reconstructions of random test models', 0),
}
CHART = 760  # width of the user study's chart in CSS pixels
DIAMONDS = 'Whiskers: one standard error over test models. Diamonds: the paper’s numbers.'
LEGEND = (
  'In brackets behind a category: its test models. A number is the mean over models and all their'
  ' views, ± one standard error over models; “avg.” is the mean of the categories, ± the standard'
  ' deviation over seeds if there are several. The best of each column is bold.'
)


def make_report(workdirs: Sequence[Workdir], *, per_category: int, seed: int) -> list[Block]:
  """The report on some folders.

  Args:
    workdirs: of `read.read_workdirs`.
    per_category: models to turn of each category.
    seed: of their choice.

  Raises:
    UserError: a data set or a network is damaged.
  """
  data = setting.open_all(workdirs)
  sections = {
    'At a glance': _glance(workdirs),
    'Models to turn': _models(workdirs, data, per_category, seed),
    'What was run': setting.protocol_blocks(workdirs, data),
    'Table 1: shapes': _shapes(workdirs),
    'Tables 2 and 3: surface colours': _colours(workdirs),
    'Beyond the paper: the recipe best': _ablation(workdirs),
    'Harder measures, and what memory alone reaches': _measures(workdirs),
    'One network or two': _structure(workdirs),
    'Articulated objects': _people(workdirs),
    'Pictures': _figures(workdirs),
    'What people prefer': _study(workdirs),
    'Training': setting.trainings(workdirs),
    'How to repeat it': setting.repeat(workdirs, data),
    'Seeds, versions, machine': setting.versions(workdirs, seed),
    'Data, licences, credits': setting.licences(data),
  }
  made = f'*Made on {datetime.date.today():%d %B %Y} by* `python -m experiments.report`'
  blocks = [f'# {TITLE}', made, *setting.abstract(workdirs, data)]
  for title, found in sections.items():
    blocks += [f'## {title}', *found] if found else []
  return blocks


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
    return [missing('Tables 1 to 3', PROGRAMS['iou'])]
  caption = (
    'The paper’s method against the others, model by model: right of the line it is better.'
    ' Whiskers: one standard error over test models; ticks: single seeds. For the IoU, the'
    ' occupancy threshold of every method is chosen on val.'
  )
  return [plots.differences(panels, 'glance', caption)]


def _models(workdirs, data: Mapping[str, Data], per_category: int, seed: int) -> list[Block]:
  if not per_category:
    return []
  found = []
  for w in workdirs:
    for url in (u for u in setting.data_of(w) if u in data):
      options = {'per_category': per_category, 'seed': seed, 'name': f'models_{w.key}'}
      if examples := models.make_examples(w, data[url].dataset, **options):
        found += [*heading(workdirs, w), *examples]
  if not found:
    return [missing('Colour networks beside their data set', PROGRAMS['psnr'])]
  return [
    'Held-out objects: the view that the networks are given, their reconstructions, and the truth.'
    ' Drag to turn; once turned, scroll to come closer. The models of a row turn together.',
    *found,
  ]


def _shapes(workdirs) -> list[Block]:
  titles = {
    'paper': 'Mean IoU, occupied if p > 0.8 as in the authors’ program (R2N2: chosen on val)',
    'val': 'Mean IoU, threshold chosen on val for every method',
  }
  panels = {'p > 0.8': 'paper', 'threshold chosen on val': 'val'}
  return _methods(workdirs, 'iou', titles, panels, 'mean IoU', 'Table 1')


def _colours(workdirs) -> list[Block]:
  titles = {
    'psnr_rgb': 'Mean surface PSNR, RGB, dB',
    'psnr_ycbcr': 'Mean surface PSNR, YCbCr, dB',
  }
  panels = {'RGB': 'psnr_rgb', 'YCbCr': 'psnr_ycbcr'}
  return _methods(workdirs, 'psnr', titles, panels, 'surface PSNR, dB', 'Tables 2 and 3')


def _methods(workdirs, name: str, titles, panels, unit: str, what: str) -> list[Block]:
  """Tables of methods and their bars: `titles` and `panels` name parts of the table."""
  found = []
  for w in (w for w in workdirs if name in w.tables):
    table = w.tables[name]
    found += [*heading(workdirs, w), *outdated(w, table.source)]
    form = '.3f' if name == 'iou' else '.2f'
    found += [tables.methods_table(table.parts[p], form, title) for p, title in titles.items()]
    drawn = {title: table.parts[part].lines for title, part in panels.items()}
    found.append(plots.bars(drawn, f'{name}_{w.key}', unit, DIAMONDS))
  return [LEGEND, *found] if found else [missing(what, PROGRAMS[name])]


def _ablation(workdirs) -> list[Block]:
  found = []
  for w in (w for w in workdirs if 'ablation' in w.tables):
    table = w.tables['ablation']
    caption = 'Each line adds one thing to those above it; means over all models, and gains'
    title = 'The gain of each step; chosen on val, only reported on test.'
    found += [*heading(workdirs, w), *outdated(w, table.source)]
    found.append(tables.ablation_table(table.parts, caption))
    found.append(plots.ablation(table.parts, f'ablation_{w.key}', title))
  return found or [missing('The ablation', PROGRAMS['ablation'])]


def _measures(workdirs) -> list[Block]:
  found = []
  for w in (w for w in workdirs if 'measures' in w.tables):
    table = w.tables['measures']
    caption = 'Means over all models and views, ± one standard error over models'
    found += [*heading(workdirs, w), *outdated(w, table.source)]
    found.append(tables.measures_table(table.parts, caption))
  if not found:
    return [missing('Harder measures', PROGRAMS['measures'])]
  explained = (
    'Tolerances of F-scores and Chamfer distances are in sides of the cube; a voxel has 1/64.'
    ' Pictures of results are compared from all azimuths. A looked-up training model is what a'
    ' network could reach that only remembers; the one nearest to the truth bounds it.'
  )
  return [explained, *found]


def _structure(workdirs) -> list[Block]:
  found = []
  for w in workdirs:
    if 'structure' in w.tables:
      table = w.tables['structure']
      found += [*heading(workdirs, w), *outdated(w, table.source)]
      found.append(tables.methods_table(table.parts['iou'], '.3f', 'Mean IoU'))
      caption = 'Mean surface PSNR, RGB, dB'
      found.append(tables.methods_table(table.parts['psnr_rgb'], '.2f', caption))
    if 'structure' in w.figures:
      found.append(_picture(w, w.figures['structure'], 'Results of both'))
  return found or [missing('The model structure analysis', PROGRAMS['structure'])]


def _people(workdirs) -> list[Block]:
  found = []
  for w in workdirs:
    if w.people:
      found += [*heading(workdirs, w), *outdated(w, w.people.source), w.people.text]
      found.append(
        'The paper finds side views better than front and back views, and a high IoU up to some 40'
        ' colours.'
      )
    for name, (title, width) in PEOPLE.items():
      if figure := w.figures.get(f'people_{name}'):
        found.append(_picture(w, figure, title, width))
  return found or [missing('The analysis of people', PROGRAMS['people'])]


def _figures(workdirs) -> list[Block]:
  found = []
  for w in workdirs:
    own = {n: w.figures[n] for n in FIGURES if n in w.figures}
    elsewhere = ('structure', 'people_')
    own |= {n: f for n, f in w.figures.items() if n not in own and not n.startswith(elsewhere)}
    found += heading(workdirs, w) if own else []
    found += [_picture(w, f, FIGURES.get(n, n.replace('_', ' '))) for n, f in own.items()]
  made = {n for w in workdirs for n in w.figures}
  return found + [missing(title, PROGRAMS[n]) for n, title in FIGURES.items() if n not in made]


def _study(workdirs) -> list[Block]:
  found = []
  for w in (w for w in workdirs if 'preferences' in w.study):
    title = 'User study: how often the blended result was preferred'
    found += [*heading(workdirs, w), _picture(w, w.study['preferences'], title, CHART)]
  if found:
    return found
  return [
    missing('The page for subjects', 'experiments.study'),
    missing(
      'The chart of their answers',
      'experiments.study.chart',
      '--results=ANSWERS --study=WORKDIR/user_study',
    ),
  ]


def _picture(w: Workdir, figure: Figure, title: str, width: int = 0) -> Picture:
  """A figure with its caption."""
  caption = f'{title}. {figure.facts.get("caption", "")}'.rstrip()
  return Picture(f'{figure.name}_{w.key}', figure.png, caption, width=width)
