"""A user study without networks: each method "reconstructs" a box of a colour of its own."""

import numpy as np
import synthetic
import workdirs

from cvn.grid import ColoredVoxels
from experiments.lib import protocol
from experiments.lib.runs import Run
from experiments.study import __main__ as user_study
from experiments.study import turntables

COLORS = {'blended_0.2': (0.9, 0.2, 0.2), 'regression': (0.2, 0.9, 0.2), 'flow': (0.2, 0.2, 0.9)}
SIZE = 48  # pixels of drawings
FRAMES = 16  # of a turn, in two lines
GRID = 16


def make_box(method: str) -> ColoredVoxels:
  """[16, 16, 16] voxels."""
  box = ColoredVoxels(np.zeros((GRID,) * 3, bool), np.zeros((GRID,) * 3 + (3,)))
  box.occupancy[4:12, 3:13, 4:12] = True
  box.color[:] = COLORS[method]
  return box


def make_data(tmp_path):
  """Test models: 3 chairs and 2 balls; 1 chair to train on."""
  return synthetic.make_dataset(
    tmp_path / 'data',
    6,
    splits=('test', 'test', 'test', 'test', 'train', 'test'),
    categories=('chair', 'ball', 'chair', 'ball', 'chair', 'chair'),
    image_size=32,
    grid_size=GRID,
  )


def run(tmp_path, *more: str) -> None:
  """Runs experiments.study."""
  user_study.main([f'--data={tmp_path / "data"}', f'--workdir={tmp_path / "work"}', *more])


def without_networks(monkeypatch) -> list:
  """Makes predictors of boxes; returns the list that (method, trained on, seed) are added to."""
  asked = []

  def make_predictor(plan, method, category, seed):
    asked.append((method, category, seed))
    return lambda views: [make_box(method)] * len(views)

  def train(plan, training, category, seed):
    del plan, seed
    return Run(f'{training}_{category}_0', workdirs.CONFIG, 4)

  monkeypatch.setattr(protocol, 'make_predictor', make_predictor)
  monkeypatch.setattr(protocol, 'train', train)
  return asked


def make_study(tmp_path, monkeypatch, *more: str) -> str:
  """Runs experiments.study; returns its folder."""
  without_networks(monkeypatch)
  monkeypatch.setattr(turntables, 'FRAMES', FRAMES)  # fewer, to be quick
  make_data(tmp_path)
  folder = tmp_path / 'study'
  run(tmp_path, '--models=all', f'--size={SIZE}', f'--output={folder}', *more)
  return str(folder)
