"""The study of people, on small networks with random parameters."""

import json
import os

import markdown_cells
import numpy as np
import pytest
import synthetic
from absl import flags
from PIL import Image
from test_evaluate import save_network

from cvn.errors import UserError
from cvn.networks import ColorNetwork, ShapeNetwork
from experiments import evaluate
from experiments.lib import protocol, runs, training
from experiments.paper.people import __main__ as program

IMAGE, GRID, AZIMUTHS = 32, 16, (0, 90, 180, 270)


@pytest.fixture(scope='module')
def given(tmp_path_factory):
  """The arguments: a data set of people and eggs, and networks trained on people for an epoch."""
  root = tmp_path_factory.mktemp('people')
  synthetic.make_dataset(
    root / 'data',
    8,
    splits=('train', 'train', 'test', 'test'),
    categories=('human', 'egg'),
    azimuths=AZIMUTHS,
    image_size=IMAGE,
    grid_size=GRID,
  )
  for name, kind, network in (
    ('msfcel', 'shape', ShapeNetwork),
    ('blended', 'color', ColorNetwork),
  ):
    folder = root / 'work' / 'runs' / f'{name}_human_0'
    save_network(str(folder), kind, network(IMAGE, GRID))
    os.rename(folder / 'checkpoints' / '0', folder / 'checkpoints' / '2')
    config = training.configuration(
      network=kind,
      data=root / 'data',
      workdir=folder,
      category='human',
      batch_size=1,
      dtype='float32',
    )
    (folder / 'config.json').write_text(json.dumps({'format': 1, **config}))
  return {'data': root / 'data', 'workdir': root / 'work'}


@pytest.fixture
def commands(monkeypatch):
  """The programs that were run; evaluations do run, within this process."""
  ran = []

  def run_program(folder, name, **named):
    del folder
    ran.append(name)
    assert name == 'experiments.evaluate'
    evaluate.main([f'--{k}={v}' for k, v in named.items()])

  monkeypatch.setattr(runs, 'run_program', run_program)
  return ran


def run(**named):
  program.main(['--quick', '--batch_size=1', *(f'--{k}={v}' for k, v in named.items())])


def test_the_whole_study(given, commands, capsys):
  run(t1=1, people=2, **given)
  *_, means, by_azimuth, _ = markdown_cells.read(capsys.readouterr().out)
  printed = markdown_cells.column(by_azimuth, 'IoU')
  folder = given['workdir']
  with open(folder / 'tables' / 'people.json') as f:
    found = json.load(f)
  with open(folder / 'scores' / 'blended_0.2_human_0_test.json') as f:
    whole = json.load(f)
  report = whole['networks']
  assert found['test_models'] == ['m2', 'm6']  # people for testing
  for azimuth in map(str, AZIMUTHS):
    iou = report['by_view'][azimuth]['iou']
    assert found['by_azimuth'][azimuth]['value'] == pytest.approx(iou)
    assert printed[f'{azimuth}°'].startswith(f'{iou:.3f} ')
  assert found['overall']['value'] == pytest.approx(report['total']['iou'])
  baseline = whole['baselines']['total']['iou']
  assert found['baseline_iou']['value'] == pytest.approx(baseline)
  assert markdown_cells.column(means, 'here')['mean IoU of the mean training shape'].startswith(
    f'{baseline:.3f} '
  )
  assert sum(g['views'] for g in found['by_complexity']) == 8
  assert sum(found['colors']['views_by_complexity']) == 16  # people of all splits, no eggs
  assert found['colors']['t1'] == 1 and found['runs']['msfcel_human_0']['epochs'] == 1
  assert found['runs']['msfcel_human_0']['step'] == 2
  shown = json.loads((folder / 'figures' / 'people_results.json').read_text())
  assert {r['id'] for r in shown['rows']} == {'m2', 'm6'}
  for name in ('azimuth', 'complexity', 'results'):
    pixels = np.asarray(Image.open(folder / 'figures' / f'people_{name}.png').convert('RGB'))
    assert len(np.unique(pixels.reshape(-1, 3), axis=0)) > 20
  before = len(commands)
  run(t1=1, people=2, **given)
  assert len(commands) == before  # all is there


def test_figures_show_the_same_people_for_a_seed(given, commands):
  stem = given['workdir'] / 'figures' / 'people_results'
  found = []
  for seed in (3, 3, 4):
    run(t1=1, people=1, figure_seed=seed, **given)
    found.append(
      (
        stem.with_suffix('.png').read_bytes(),
        json.loads(stem.with_suffix('.json').read_text())['rows'],
      )
    )
  assert found[0] == found[1]
  assert found[0][0] != found[2][0] and found[0][1] != found[2][1]


def test_bad_input_is_named(tmp_path, given):
  with pytest.raises(UserError, match='no colour has t1 = 100000 pixels'):
    run(t1=100000, **given)
  with pytest.raises(UserError, match="no category 'car'"):
    run(category='car', **given)
  for name, value in (('category', 'human,egg'), ('seeds', ''), ('t1', 0), ('t2', -1)):
    with pytest.raises(flags.Error, match=name):
      run(**given | {name: value})
  synthetic.make_dataset(tmp_path / 'few', 1, azimuths=(0, 90), image_size=IMAGE, grid_size=GRID)
  with pytest.raises(UserError, match='no views from 180°, 270°'):
    run(**given | {'data': tmp_path / 'few'})


def test_a_category_without_test_models_is_named(given, monkeypatch):
  monkeypatch.setattr(
    protocol, 'evaluate', lambda *_: {'networks': {'by_model': {'m3': {'category': 'egg'}}}}
  )
  with pytest.raises(UserError, match='no finished human in the split test'):
    run(t1=1, **given)
