"""Miniature --workdir folders as the programs of tables and figures leave them; no networks."""

import json
import types

import numpy as np
from PIL import Image

from cvn import figures
from experiments import people_analysis, people_report, protocol, tables
from experiments.tables import AVERAGE, Row, Scores

AZIMUTHS = (0, 90, 180, 270)
SETTINGS = {
  'data': 'DATA',
  'models': 'all',
  'epochs': 8,
  'batch_size': 2,
  'learning_rate': 0.001,
  'dtype': 'mixed',
  'seeds': ['0'],
  'fresh_statistics': 20,
  'train_source': [],
  'source': [],
  'threshold': 'paper',
  'quick': False,
}


def settings(**changes):
  """What `tables.describe` says of the flags."""
  found = {n: types.SimpleNamespace(value=v) for n, v in (SETTINGS | changes).items()}
  return tables.describe(found)


def row(method, base, published=None, *, seeds=1):
  """A method with the numbers base, base + 0.1 (cars) and base + 0.2 (a chair), by every seed."""
  cars = Scores(('a', 'b'), np.array([[base, base + 0.1]] * seeds))
  chairs = Scores(('c',), np.array([[base + 0.2]] * seeds))
  title = protocol.METHODS[method].title if method in protocol.METHODS else method
  return Row(title, {'car': cars, 'chair': chairs}, published or {})


def write_json(path, value):
  path.parent.mkdir(parents=True, exist_ok=True)
  path.write_text(json.dumps(value))


def write_tables(folder, *, seeds=1, **changes):
  """Tables 1 to 3, the ablation and the structure analysis."""
  common = settings(seeds=[str(n) for n in range(seeds)], **changes)
  paper = {'car': 0.395, 'chair': 0.18, AVERAGE: 0.298}

  def part(rows, form='.3f'):
    return {
      'rows': tables.to_json(rows),
      'comparisons': [tables.compare(rows[0], r, form) for r in rows[1:]],
    }

  shapes = [
    row('msfcel', 0.3, paper, seeds=seeds),
    row('cross_entropy', 0.25, {**paper, AVERAGE: 0.4}, seeds=seeds),
  ]
  write_json(folder / 'tables/iou.json', common | {'paper': part(shapes), 'val': part(shapes)})
  colors = [row('blended_0.2', 16), row('flow', 15)]
  psnr = {m: part(colors, '.2f') for m in ('psnr_rgb', 'psnr_ycbcr')}
  write_json(folder / 'tables/psnr.json', common | psnr)
  steps = tables.to_json([row('paper', 0.2), row('plus_threshold', 0.25)])
  line = tables.compare(row('best', 0.25), row('paper', 0.2), '.3f')
  both = {m: steps for m in ('iou', 'psnr_rgb')}
  ablation = {'comparisons': dict.fromkeys(both, line), 'val': both, 'test': both}
  write_json(folder / 'tables/ablation.json', common | ablation)
  rows = tables.to_json(shapes)
  structure = {m: {'rows': rows, 'comparison': line} for m in ('iou', 'psnr_rgb')}
  write_json(folder / 'tables/structure.json', common | structure)


def write_people(folder):
  """The analysis of two people, and one of its pictures."""
  complexity = np.array([[3, 4, 5, 6], [7, 8, 9, 10]])
  iou = np.array([[0.1, 0.2, 0.1, 0.2], [0.2, 0.3, 0.2, 0.3]])
  study = people_report.Study(
    category='human',
    networks=['msfcel_human_0: 1 epochs'],
    thresholds=[0.8],
    models=['p', 'q'],
    scores={'iou': iou, 'psnr_rgb': 10 + iou, 'psnr_ycbcr': 14 + iou},
    baseline=iou / 2,
    colors=people_analysis.Colors(complexity, 90, 80, 0.9, 16, 50, 5),
    tested=complexity,
    analysis=people_analysis.analyze(AZIMUTHS, iou, complexity),
  )
  write_json(
    folder / 'tables/people.json', settings(models='category') | people_report.to_json(study)
  )
  write_figure(folder / 'figures/people_azimuth.png')


def write_training(folder, name='msfcel_all_0', **changes):
  """A training of 2 epochs: 4 steps of 2 views, a loss that falls."""
  config = {'network': 'shape', 'recipe': 'paper', 'batch_size': 2, 'models': 4, 'seed': 0}
  config |= {'category': [], 'dtype': 'mixed', 'learning_rate': 0.001, 'fresh_statistics': 20}
  write_json(folder / 'runs' / name / 'config.json', config | {'data': 'DATA'} | changes)
  lines = [{'step': n, 'epoch': n / 2, 'loss': 1 / n} for n in (1, 2, 3, 4)]
  lines.append({'step': 4, 'epoch': 2, 'validation': {'loss': 0.5, 'iou': 0.125}})
  log = folder / 'runs' / name / 'log.jsonl'
  log.write_text(''.join(json.dumps(x) + '\n' for x in lines))


def write_figure(path, caption=''):
  """A red picture, with the caption drawn below it where there is one."""
  image = np.full((6, 300, 3), (200, 0, 0), np.uint8)
  if caption:
    image = figures.stack([image, figures.draw_text(caption, 300)])
    write_json(path.with_suffix('.json'), settings() | {'caption': caption, 'figure_seed': 7})
  path.parent.mkdir(parents=True, exist_ok=True)
  Image.fromarray(image).save(path)


def write_all(folder, **changes):
  """Everything but networks and their evaluations; returns the folder."""
  write_tables(folder, **changes)
  write_people(folder)
  write_training(folder)
  write_training(folder, 'blended_all_0', network='color')
  write_figure(folder / 'figures/random.png', 'Drawn at random, <b>not</b> chosen: seed 7.')
  write_figure(folder / 'user_study/standin.png')
  command = 'python -m experiments.train --workdir=/home/someone/work/runs/msfcel_all_0 --seed=0'
  write_json(folder / 'seconds.json', {command: 90.0})
  return folder
