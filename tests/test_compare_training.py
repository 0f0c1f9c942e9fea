"""The comparison of ways to train: what it runs, what it reads, what it shows."""

import json
import os
import shutil

import leavings
import numpy as np
import pytest
from absl import flags
from PIL import Image

from cvn.errors import UserError
from experiments import compare_training as program
from experiments.lib import evaluation


def parse(*arguments):
  values = flags.FlagValues()
  program.define_flags(values)
  values(['compare', *arguments])
  return values


@pytest.fixture
def commands(monkeypatch):
  """What would be run; it leaves the files that the real programs leave."""
  ran = []

  def run_program(folder, name, **named):
    del folder
    ran.append((name, named))
    if name == 'experiments.train':
      loss = 0.5 if named.get('dtype') == 'mixed' else 0.25
      leavings.leave_run(**named)
      with open(os.path.join(named['workdir'], 'log.jsonl'), 'w') as f:
        for epoch in range(1, named['epochs'] + 1):
          f.write(json.dumps({'step': epoch, 'epoch': epoch, 'loss': loss / epoch}) + '\n')
        f.write(json.dumps({'step': epoch, 'epoch': epoch, 'validation': {'loss': 0.75}}) + '\n')
    else:
      total = {'iou': 0.125, 'psnr_rgb': 20.0, 'psnr_ycbcr': None}
      with open(named['json'], 'w') as f:
        json.dump({'networks': {'total': total}, 'options': evaluation.options(**named)}, f)

  monkeypatch.setattr(program.runs, 'run_program', run_program)
  return ran


@pytest.fixture(scope='module')
def data(tmp_path_factory):
  return f'--data={leavings.make_data(tmp_path_factory.mktemp("data") / "A")}'


def test_trains_each_network_in_each_way_from_the_same_seed(data, tmp_path, commands, capsys):
  program.run(parse(data, '--batch_size=2', f'--workdir={tmp_path}', '--seeds=3', '--epochs=2'))
  trained = [named for name, named in commands if name == 'experiments.train']
  assert [(t['network'], t.get('dtype'), t.get('heads')) for t in trained] == [
    ('shape', 'float32', None),
    ('shape', 'mixed', None),
    ('color', 'float32', None),
    ('color', 'mixed', None),
    ('color', 'float32', 'surface'),
  ]
  assert {(t['seed'], t['epochs'], t['data']) for t in trained} == {
    ('3', 2, data.removeprefix('--data='))
  }
  assert len({t['workdir'] for t in trained}) == 5
  told = capsys.readouterr().out
  assert '| shape | mixed | 3 | 0.2500 | 0.7500 | IoU 0.125 |' in told
  assert '| color | surface | 3 | 0.1250 | 0.7500 | PSNR RGB 20.00, PSNR YCbCr none |' in told
  pixels = np.asarray(Image.open(tmp_path / 'loss.png').convert('RGB'))
  assert len(np.unique(pixels.reshape(-1, 3), axis=0)) > 10


def test_what_is_evaluated_is_not_evaluated_again_until_it_is_trained_further(
  data, tmp_path, commands
):
  arguments = data, '--batch_size=2', f'--workdir={tmp_path}', '--network=shape', '--variant=mixed'

  def evaluations():
    program.run(parse(*arguments))
    return sum(name == 'experiments.evaluate' for name, _ in commands)

  assert (evaluations(), evaluations()) == (1, 1)
  arguments += ('--epochs=13',)
  shutil.rmtree(tmp_path / 'shape_mixed_0' / 'checkpoints')
  assert evaluations() == 2


def test_a_used_workdir_of_other_flags_is_an_error(data, tmp_path, commands):
  arguments = data, f'--workdir={tmp_path}', '--network=shape', '--variant=mixed'
  program.run(parse(*arguments, '--batch_size=2'))
  for changed in (
    '--batch_size=3',
    '--batch_size=2 --learning_rate=1',
    '--batch_size=2 --epochs=1',
  ):
    with pytest.raises(UserError, match='shape_mixed_0 was '):
      program.run(parse(*arguments, *changed.split()))
  assert len(commands) == 2


def test_quick_is_one_epoch(data, tmp_path, commands):
  program.run(parse(data, '--batch_size=2', f'--workdir={tmp_path}', '--quick', '--network=color'))
  assert {named['epochs'] for name, named in commands if name == 'experiments.train'} == {1}
