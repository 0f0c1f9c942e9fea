"""Miniature --workdir folders as the programs of tables and figures leave them; no networks."""

import json

import numpy as np
from PIL import Image

from experiments.lib import protocol, results, runs, scoring, stages
from experiments.lib.results import AVERAGE, Row, Scores, Table
from experiments.lib.runs import Run
from experiments.paper.people import analysis as people_analysis
from experiments.paper.people import summary as people_summary

AZIMUTHS = (0, 90, 180, 270)
CONFIG = {  # of a run, as experiments.train stores it
  'format': 1,
  'data': 'DATA',
  'data_digest': '0123456789abcdef',
  'models': 4,
  'counts': {'car (synthetic)': 2, 'chair (synthetic)': 2},
  'network': 'shape',
  'dtype': 'mixed',
  'heads': 'dense',
  'category': [],
  'source': [],
  'batch_size': 2,
  'fresh_statistics': 20,
  'seed': 0,
  'recipe': 'paper',
  'learning_rate': 0.001,
}


def source(program='paper.iou', *, data='DATA', seeds=1, **changes):
  """How a program made its results: command, data set, runs."""
  argv = ['python', '-m', f'experiments.{program}', f'--data={data}', '--workdir=/x/work']
  used = [Run(f'msfcel_all_{n}', CONFIG | {'seed': n} | changes, 4) for n in range(seeds)]
  return {'argv': argv, 'data': data, 'runs': runs.to_json(used)}


def row(method, base, published=None, *, seeds=1):
  """A method with the numbers base, base + 0.1 (cars) and base + 0.2 (a chair), by every seed."""
  cars = Scores(('a', 'b'), np.array([[base, base + 0.1]] * seeds))
  chairs = Scores(('c',), np.array([[base + 0.2]] * seeds))
  title = protocol.METHODS[method].title if method in protocol.METHODS else method
  return Row(title, {'car': cars, 'chair': chairs}, published or {})


def write_json(path, value):
  path.parent.mkdir(parents=True, exist_ok=True)
  path.write_text(json.dumps(stages.plain(value)))


def write_tables(folder, *, seeds=1, **changes):
  """Tables 1 to 3, the ablation and the structure analysis."""
  paper = {'car': 0.395, 'chair': 0.18, AVERAGE: 0.298}

  def write(name, **parts):
    origin = source(f'paper.{name}', seeds=seeds, **changes)
    write_json(folder / f'tables/{name}.json', origin | {'parts': parts})

  def table(*rows):
    return results.tabulate({r.title: r for r in rows}, rows[0].title)

  shapes = table(
    row('msfcel', 0.3, paper, seeds=seeds),
    row('cross_entropy', 0.25, {**paper, AVERAGE: 0.4}, seeds=seeds),
  )
  write('iou', paper=shapes, val=shapes)
  colors = table(row('blended_0.2', 16), row('flow', 15))
  write('psnr', psnr_rgb=colors, psnr_ycbcr=colors)
  last = results.compare(row('best', 0.25), row('paper', 0.2))
  steps = [results.summarize(row('paper', 0.2)), results.summarize(row('plus_threshold', 0.25))]
  names = [f'{split} {metric}' for split in ('val', 'test') for metric in ('iou', 'psnr_rgb')]
  write('ablation', **dict.fromkeys(names, Table(steps, [last])))
  harder = table(row('best', 0.25), row('outline', 0.2))
  write('measures', **dict.fromkeys(scoring.METRICS, harder))
  write('structure', iou=shapes, psnr_rgb=shapes)


def write_people(folder):
  """The analysis of two people, and one of its pictures."""
  complexity = np.array([[3, 4, 5, 6], [7, 8, 9, 10]])
  iou = np.array([[0.1, 0.2, 0.1, 0.2], [0.2, 0.3, 0.2, 0.3]])
  study = people_summary.Study(
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
  origin = source('paper.people', category=['human'])
  write_json(folder / 'tables/people.json', origin | people_summary.to_json(study))
  write_figure(folder / 'figures/people_azimuth.png')


def write_training(folder, name='msfcel_all_0', **changes):
  """A training of 2 epochs: 4 steps of 2 views, a loss that falls."""
  write_json(folder / 'runs' / name / 'config.json', CONFIG | changes)
  lines = [{'step': n, 'epoch': n / 2, 'loss': 1 / n} for n in (1, 2, 3, 4)]
  lines.append({'step': 4, 'epoch': 2, 'validation': {'loss': 0.5, 'iou': 0.125}})
  log = folder / 'runs' / name / 'log.jsonl'
  log.write_text(''.join(json.dumps(x) + '\n' for x in lines))


def write_figure(path, caption='', program='paper.figures.random'):
  """A red picture, with its caption beside it where there is one."""
  image = np.full((6, 300, 3), (200, 0, 0), np.uint8)
  if caption:
    write_json(path.with_suffix('.json'), source(program) | {'caption': caption, 'figure_seed': 7})
  path.parent.mkdir(parents=True, exist_ok=True)
  Image.fromarray(image).save(path)


def write_all(folder, **changes):
  """Everything but networks and their evaluations; returns the folder."""
  write_tables(folder, **changes)
  write_people(folder)
  write_training(folder)
  write_training(folder, 'blended_all_0', network='color')
  write_figure(folder / 'figures/random.png', 'Drawn at random, <b>not</b> chosen: seed 7.')
  write_figure(folder / 'user_study/preferences.png', 'Two subjects.', 'study.chart')
  command = 'python -m experiments.train --workdir=/home/someone/work/runs/msfcel_all_0 --seed=0'
  write_json(folder / 'seconds.json', {command: 90.0})
  return folder
