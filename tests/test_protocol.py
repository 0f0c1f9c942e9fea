"""What the paper's methods ask of the training and evaluation programs, and what is reused."""

import json
import os

import numpy as np
import pytest
import synthetic
from absl import flags

from cvn.errors import UserError
from cvn.networks import NETWORKS
from experiments import protocol


def parse(*arguments):
  f = flags.FlagValues()
  protocol.define_flags(f)
  f(['program', *arguments])
  return f


@pytest.fixture
def commands(monkeypatch):
  """What would be run; it leaves what the real programs leave: 4 batches an epoch."""
  ran = []

  def run_program(folder, program, **named):
    del folder
    ran.append((program, named))
    if program == 'experiments.train':
      os.makedirs(os.path.join(named['workdir'], 'checkpoints', str(4 * named['epochs'])))
      config = {'format': 1, 'models': 50, 'batch_size': 12}
      with open(os.path.join(named['workdir'], 'config.json'), 'w') as out:
        json.dump(config, out)
    else:
      os.makedirs(os.path.dirname(named['json']), exist_ok=True)
      with open(named['json'], 'w') as out:
        options = {k: named[k] == 'true' for k in ('flip', 'carve')}
        alpha = 0.6 if named['alpha'] == 'val' else named['alpha']
        report = {'threshold': 0.3, 'alpha': alpha}
        json.dump(report | options, out)

  monkeypatch.setattr(protocol, 'run_program', run_program)
  return ran


def test_every_method_has_its_trainings_and_every_training_a_network():
  for method in protocol.METHODS.values():
    assert method.shape in protocol.TRAININGS
    assert not method.color or method.color in protocol.TRAININGS
  assert all(t['network'] in NETWORKS for t in protocol.TRAININGS.values())


def test_the_defaults_are_the_papers(tmp_path, commands):
  protocol.train(parse('--data=D', f'--workdir={tmp_path}'), 'cross_entropy', 'car', '3')
  ((program, named),) = commands
  assert program == 'experiments.train'
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


def test_what_is_there_is_reused_and_more_epochs_go_on(tmp_path, commands):
  arguments = '--data=D', f'--workdir={tmp_path}', '--epochs=2', '--models=all'
  for _ in range(2):
    protocol.evaluate(parse(*arguments), 'blended_0.4', protocol.ALL, '0')
  assert [p for p, _ in commands] == ['experiments.train'] * 2 + ['experiments.evaluate']
  assert commands[-1][1]['alpha'] == 0.4
  protocol.evaluate(parse(*arguments), 'regression', protocol.ALL, '0')
  assert [p for p, _ in commands[3:]] == ['experiments.train', 'experiments.evaluate']
  protocol.train(parse(*arguments, '--epochs=3'), 'blended', protocol.ALL, '0')
  assert commands[-1][1]['epochs'] == 3
  # The network is newer than its report now.
  late = os.path.getmtime(tmp_path / 'scores' / 'blended_0.4_all_0_test.json') + 5
  os.utime(tmp_path / 'runs' / 'blended_all_0' / 'checkpoints', (late, late))
  count = len(commands)
  protocol.evaluate(parse(*arguments), 'blended_0.4', protocol.ALL, '0')
  assert [p for p, _ in commands[count:]] == ['experiments.evaluate']
  # A report of other options at test time is none of this method.
  path = tmp_path / 'scores' / 'blended_0.4_all_0_test.json'
  path.write_text(json.dumps(json.loads(path.read_text()) | {'carve': True}))
  protocol.evaluate(parse(*arguments), 'blended_0.4', protocol.ALL, '0')
  assert [p for p, _ in commands[count:]] == ['experiments.evaluate'] * 2


def test_the_joint_baseline_always_has_its_threshold_chosen(tmp_path, commands):
  f = parse('--data=D', f'--workdir={tmp_path}', '--quick', '--source=mine')
  protocol.evaluate(f, 'r2n2', 'car', '0')
  protocol.evaluate(f, 'msfcel', 'car', '0')
  protocol.evaluate(f, 'msfcel', 'car', '0', threshold='val')
  asked = [named for program, named in commands if program == 'experiments.evaluate']
  assert [a.get('threshold') for a in asked] == ['val', None, 'val']
  assert len({a['json'] for a in asked}) == 3
  assert {a['source'] for a in asked} == {'mine'}
  assert {n['epochs'] for p, n in commands if p == 'experiments.train'} == {1}


def test_alpha_is_chosen_on_val_where_a_method_leaves_it_open(tmp_path, commands):
  f = parse('--data=D', f'--workdir={tmp_path}')
  assert protocol.evaluate(f, 'best', 'car', '0')['alpha'] == 0.6
  asked = [named for program, named in commands if program == 'experiments.evaluate']
  names = ('split', 'alpha', 'threshold', 'flip', 'carve')
  assert [tuple(a[n] for n in names) for a in asked] == [('test', 'val', 'val', 'true', 'true')]
  protocol.evaluate(f, 'best', 'car', '0')
  assert len(commands) == 2 + 1


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
  monkeypatch.setattr(protocol, 'train', lambda f, training, category, seed: training)
  monkeypatch.setattr(protocol, 'evaluate', lambda *_: {'threshold': 0.25, 'alpha': 0.6})
  monkeypatch.setattr(
    protocol.scoring, 'load', lambda workdir, kinds, _: protocol.scoring.Network(workdir, kinds)
  )
  score = np.linspace(0, 1, 2 * 16**3, dtype=np.float32).reshape(2, 16, 16, 16)
  color = np.random.default_rng(0).random((2, 16, 16, 16, 3))
  monkeypatch.setattr(protocol.methods, 'score', lambda kind, *_, **__: score)
  told = []

  def colors(kind, variables, views, **options):
    told.append((kind, options))
    return color

  monkeypatch.setattr(protocol.methods, 'colors', colors)
  f = parse(f'--data={made.root}', f'--workdir={tmp_path}')
  predict = protocol.make_predictor(f, 'blended_0.6', 'all', '0')
  first, second = predict(np.zeros((2, 32, 32, 4), np.float32))
  np.testing.assert_array_equal(first.occupancy, score[0] >= 0.25)
  np.testing.assert_array_equal(second.color, color[1])
  assert told == [('blended', {'alpha': 0.6, 'threshold': 0.25, 'flip': False, 'grid_size': 16})]
