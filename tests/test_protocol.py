"""What the paper's methods ask of the training and evaluation programs, and what is reused."""

import leavings
import numpy as np
import pytest
import synthetic

from cvn.errors import UserError
from cvn.infer import Network, Reconstruction
from experiments.lib import cli, protocol
from experiments.lib.runs import Run


def parse(*arguments):
  return protocol.read_flags(cli.parse(protocol.define_flags, arguments))


@pytest.fixture
def data(tmp_path):
  return f'--data={leavings.make_data(tmp_path / "data")}'


@pytest.fixture
def commands(monkeypatch):
  return leavings.without_programs(monkeypatch)


def test_the_defaults_are_the_papers(data, tmp_path, commands):
  protocol.train(parse(data, f'--workdir={tmp_path}'), 'cross_entropy', 'car', '3')
  ((program, named),) = commands
  assert program == 'train'
  assert named['workdir'] == str(tmp_path / 'runs' / 'cross_entropy_car_3')
  chosen = {k: named[k] for k in ('network', 'shape_loss', 'category', 'epochs', 'batch_size')}
  assert chosen == {
    'network': 'shape',
    'shape_loss': 'cross_entropy',
    'category': 'car',
    'epochs': 500,
    'batch_size': 60,
  }
  assert 'learning_rate' not in named


def test_a_faster_way_to_train_is_a_training_of_its_own(data, tmp_path, commands):
  arguments = data, f'--workdir={tmp_path}', '--batch_size=2', '--models=all', '--epochs=2'
  for method in ('blended_0.2', 'blended_mixed', 'blended_surface'):
    protocol.evaluate(parse(*arguments), method, protocol.ALL, '0')
  trained = {
    n['workdir'].rpartition('/')[2]: (n['dtype'], n.get('heads'))
    for p, n in commands
    if p == 'train'
  }
  assert trained == {
    'msfcel_all_0': ('float32', None),
    'blended_all_0': ('float32', None),
    'blended_mixed_all_0': ('mixed', None),
    'blended_surface_all_0': ('float32', 'surface'),
  }


def test_methods_share_networks(data, tmp_path, commands):
  arguments = data, f'--workdir={tmp_path}', '--epochs=2', '--models=all', '--batch_size=2'
  protocol.evaluate(parse(*arguments), 'blended_0.4', protocol.ALL, '0')
  assert [p for p, _ in commands] == ['train', 'train', 'evaluate']
  assert commands[-1][1]['alpha'] == 0.4
  protocol.evaluate(parse(*arguments), 'regression', protocol.ALL, '0')
  assert [p for p, _ in commands[3:]] == ['train', 'evaluate']


def test_the_joint_baseline_always_has_its_threshold_chosen(data, tmp_path, commands):
  f = parse(data, f'--workdir={tmp_path}', '--quick', '--source=synthetic')
  protocol.evaluate(f, 'r2n2', 'car', '0')
  protocol.evaluate(f, 'msfcel', 'car', '0')
  protocol.evaluate(f, 'msfcel', 'car', '0', threshold='val')
  asked = [named for program, named in commands if program == 'evaluate']
  assert [a.get('threshold') for a in asked] == ['val', None, 'val']
  assert len({a['json'] for a in asked}) == 3
  assert {a['source'] for a in asked} == {'synthetic'}
  assert {n['epochs'] for p, n in commands if p == 'train'} == {1}


def test_alpha_is_chosen_on_val_where_a_method_leaves_it_open(data, tmp_path, commands):
  f = parse(data, f'--workdir={tmp_path}')
  assert protocol.evaluate(f, 'best', 'car', '0')['alpha'] == 0.6
  asked = [named for program, named in commands if program == 'evaluate']
  names = ('split', 'alpha', 'threshold', 'flip', 'carve')
  assert [tuple(a[n] for n in names) for a in asked] == [('test', 'val', 'val', 'true', 'true')]
  protocol.evaluate(f, 'best', 'car', '0')
  assert len(commands) == 2 + 1


def test_harder_measures_have_a_file_of_their_own(data, tmp_path, commands):
  f = parse(data, f'--workdir={tmp_path}')
  for measures in (False, True):
    protocol.evaluate(f, 'best', 'car', '0', measures=measures)
  asked = [named for program, named in commands if program == 'evaluate']
  assert [(a.get('retrieval'), a.get('pictures')) for a in asked] == [
    (None, None),
    ('true', 'true'),
  ]
  assert asked[1]['json'] == asked[0]['json'].replace('.json', '_measures.json')


def test_categories_come_in_the_papers_order(tmp_path):
  made = synthetic.make_dataset(
    tmp_path / 'data', 3, categories=('zebra', 'chair', 'car'), image_size=32, grid_size=16
  )
  data = f'--data={made.root}'
  assert protocol.categories(parse(data, '--workdir=W')) == ['car', 'chair', 'zebra']
  assert protocol.categories(parse(data, '--workdir=W', '--category=zebra')) == ['zebra']
  with pytest.raises(UserError, match="no category 'dog'"):
    protocol.categories(parse(data, '--workdir=W', '--category=dog'))


def test_a_predictor_makes_what_is_evaluated(tmp_path, monkeypatch):
  made = synthetic.make_dataset(tmp_path / 'data', 2, image_size=32, grid_size=16)
  monkeypatch.setattr(protocol, 'train', lambda plan, training, *_: Run(training, {}, 0))
  monkeypatch.setattr(protocol, 'evaluate', lambda *_: {'threshold': 0.25, 'alpha': 0.6})
  monkeypatch.setattr(protocol.scoring, 'load', lambda workdir, *_: Network(workdir, None, {}))
  told = []

  def reconstruct(views, **options):
    told.append(options)
    return Reconstruction(*[np.arange(len(views))] * 7)

  monkeypatch.setattr(protocol.infer, 'reconstruct', reconstruct)
  plan = parse(f'--data={made.root}', f'--workdir={tmp_path}')
  for method, color in (('blended_0.6', 'blended'), ('best', 'blended_best')):
    results = protocol.make_predictor(plan, method, 'all', '0')(np.zeros((2, 32, 32, 4)))
    assert [r.occupancy for r in results] == [0, 1]
    options, best = told.pop(), method == 'best'
    assert options.pop('color').kind == color
    assert options.pop('shape').kind == ('msfcel_best' if best else 'msfcel')
    assert options == {
      'alpha': 0.6,
      'threshold': 0.25,
      'flip': best,
      'carve': best,
      'azimuths': made.manifest.azimuths,
    }


def test_one_network_for_shape_and_colour_is_loaded_once(tmp_path, monkeypatch):
  made = synthetic.make_dataset(tmp_path / 'data', 2, image_size=32, grid_size=16)
  monkeypatch.setattr(protocol, 'train', lambda plan, training, *_: Run(training, {}, 0))
  monkeypatch.setattr(protocol, 'evaluate', lambda *_: {'threshold': 0.25, 'alpha': 0.6})
  monkeypatch.setattr(protocol.scoring, 'load', lambda workdir, *_: Network(workdir, None, {}))
  monkeypatch.setattr(
    protocol.infer, 'reconstruct', lambda views, *, shape, color, **_: [shape, color]
  )
  monkeypatch.setattr(protocol.infer, 'split', lambda found: found)
  plan = parse(f'--data={made.root}', f'--workdir={tmp_path}')
  shape, color = protocol.make_predictor(plan, 'unified', 'all', '0')(None)
  assert shape is color
