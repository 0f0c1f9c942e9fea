"""Curves of IoU over thresholds: numbers, picture, and no val no figure."""

import json

import numpy as np
import pytest
import synthetic
import workdirs
from PIL import Image

from cvn.errors import UserError
from experiments.lib.runs import Run
from experiments.paper.figures import threshold as program


def test_curves_of_both_losses(tmp_path, monkeypatch):
  made = synthetic.make_dataset(
    tmp_path / 'data', 3, splits=('train', 'val'), image_size=32, grid_size=16
  )
  asked = []
  monkeypatch.setattr(
    program.protocol, 'train', lambda plan, name, *_: Run(name, workdirs.CONFIG, 4)
  )
  monkeypatch.setattr(program.scoring, 'load', lambda workdir, *_: workdir)

  def threshold_curve(dataset, rows, shape):
    asked.append((shape, [int(r) for r in rows]))
    return np.array([0.25, 0.5]), np.array([0.125, 0.75])

  monkeypatch.setattr(program.scoring, 'threshold_curve', threshold_curve)
  program.main([f'--data={made.root}', f'--workdir={tmp_path}', '--models=all'])
  assert asked == [('cross_entropy', [1]), ('msfcel', [1])]
  found = json.loads((tmp_path / 'figures' / 'threshold.json').read_text())
  assert found['runs']['msfcel']['epochs'] == 2
  assert found['curves']['all']['msfcel'] == {'thresholds': [0.25, 0.5], 'iou': [0.125, 0.75]}
  with Image.open(tmp_path / 'figures' / 'threshold.png') as picture:
    assert picture.size == (440, 330)


def test_without_a_split_val_there_is_nothing_to_draw(tmp_path):
  made = synthetic.make_dataset(
    tmp_path / 'data', 2, splits=('train', 'test'), image_size=32, grid_size=16
  )
  with pytest.raises(UserError, match='no finished model in the split val of ball'):
    program.main([f'--data={made.root}', f'--workdir={tmp_path}', '--models=all'])
