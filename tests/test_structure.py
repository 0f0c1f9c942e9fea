"""The unified network against separate ones: the tables, and their picture."""

import json
import os

import markdown_cells
import pytest
from test_figure_random import make_workdir, read_figure, run

from experiments.lib import protocol
from experiments.paper import structure

MODELS = {'m2': 'car', 'm6': 'car', 'm3': 'zebra'}


@pytest.fixture
def given(tmp_path, monkeypatch):
  """Evaluations in which separate networks are better by 0.25 in IoU and worse by 1 dB."""
  made = make_workdir(tmp_path, monkeypatch)

  def evaluate(plan, method, category, seed, **_):
    unified = method == structure.UNIFIED
    training = 'unified' if unified else 'msfcel'
    run = protocol.train(plan, training, category, seed)
    models = {
      name: {
        'category': c,
        'source': 'synthetic',
        'iou': [0.25 if unified else 0.5] * 3,
        'psnr_rgb': [11.0 if unified else 10.0, None, None],
      }
      for name, c in MODELS.items()
      if category in (protocol.ALL, c)
    }
    return {
      **{'data': plan.data, 'split': 'test', 'threshold': 0.5, 'alpha': 0.2},
      **{'networks': {'by_model': models}, 'shape': run.workdir},
      'options': {'runs': {'shape': {'step': run.step, 'config': run.config}}},
    }

  monkeypatch.setattr(protocol, 'evaluate', evaluate)
  return made


@pytest.mark.parametrize('models', ['category', 'all'])
def test_numbers_stand_beside_the_papers(given, capsys, models):
  run(structure, tile=48, per_category=1, models=models, **given)
  iou, compared, *_ = markdown_cells.read(capsys.readouterr().out)
  assert iou[1] == ['Separate networks (proposed)', '0.500 ± 0.000', '0.395', '0.500', '0.500']
  assert iou[2] == ['Unified network', '0.250 ± 0.000', '0.386', '0.250', '0.250']
  assert compared[1][:2] == ['− Unified network', '+0.250 ± 0.000']
  with open(os.path.join(given['workdir'], 'tables', 'structure.json')) as f:
    table = json.load(f)['parts']
  separate, unified = table['iou']['lines']
  (comparison,) = table['psnr_rgb']['comparisons']
  assert (comparison['difference'], comparison['models'], comparison['above']) == (-1, 3, 0)
  assert separate['categories']['car'] == {
    'mean': 0.5,
    'error': 0,
    'models': 2,
    'published': 0.395,
  }
  assert unified['categories']['car']['published'] == 0.386
  assert table['psnr_rgb']['lines'][0]['categories']['car']['published'] is None
  image, facts = read_figure(given, 'structure')
  assert (image < 100).any() and [r['category'] for r in facts['rows']] == ['car', 'zebra']
  folder = f'runs/unified_{"all" if models == "all" else "car"}_0'
  assert facts['networks']['car']['unified'] == folder
