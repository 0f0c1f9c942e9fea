"""What experiments.train and experiments.evaluate leave, without networks: folders and reports."""

import json
import os
import shutil

import synthetic

from cvn import data, dataset
from experiments.lib import evaluation, runs, training


def make_data(path, *, split='train'):
  """Ten models to train on, two each to validate and test; `split` is the last one's."""
  return synthetic.make_dataset(
    path,
    14,
    splits=('train', 'train', 'train', 'train', 'val', 'test', split),
    categories=('car', 'chair'),
    azimuths=(0, 90),
    image_size=32,
    grid_size=16,
  ).root


def leave_run(**named):
  """Leaves what experiments.train leaves: configuration, and checkpoint of the last epoch."""
  config = {'format': 1, **training.configuration(**named)}
  step = runs.steps_per_epoch(config) * named['epochs']
  checkpoints = os.path.join(named['workdir'], 'checkpoints')
  shutil.rmtree(checkpoints, ignore_errors=True)  # of fewer epochs
  os.makedirs(os.path.join(checkpoints, str(step)))
  with open(os.path.join(named['workdir'], 'config.json'), 'w') as f:
    json.dump(config, f)


def leave_scores(number=0.5, **named):
  """Leaves what experiments.evaluate leaves: its options, and the same number for all views."""
  options = evaluation.options(**named)
  opened = dataset.open_dataset(named['data'])
  where = {'categories': options['category'], 'sources': options['source']}
  rows = data.select_rows(opened, options['split'], **where)
  by_model = {
    m.id: {'category': m.category, 'source': m.source}
    | {k: [number] * 2 for k in ('iou', 'psnr_rgb', 'psnr_ycbcr')}
    for m in (opened.manifest.models[row] for row in rows)
  }
  alpha = 0.6 if options['alpha'] == 'val' else float(options['alpha'])
  report = {k: named.get(k) for k in ('data', 'split', 'shape', 'color')}
  report |= {'options': options, 'alpha': alpha, 'threshold': 0.3}
  report |= {who: {'by_model': by_model} for who in ('networks', 'baselines')}
  os.makedirs(os.path.dirname(named['json']), exist_ok=True)
  with open(named['json'], 'w') as f:
    json.dump(report, f)


def without_programs(monkeypatch) -> list:
  """Makes programs leave what they would; returns the list that (name, flags) are added to."""
  ran = []

  def run_program(folder, program, **named):
    del folder
    ran.append((program.removeprefix('experiments.'), named))
    (leave_run if program == 'experiments.train' else leave_scores)(**named)

  monkeypatch.setattr(runs, 'run_program', run_program)
  return ran
