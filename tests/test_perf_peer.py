"""The commands that run PyTorch, and what is read from their output."""

import sys

import pytest

from cvn.errors import UserError
from experiments.perf import peer
from experiments.perf.peer import Setting


def python(code):
  return [sys.executable, '-c', code]


def test_mixed_precision_is_compared_with_both_types():
  assert peer.list_settings('float32', ['default']) == [Setting('float32', 'default')]
  assert peer.list_settings('mixed', ['default', 'compile']) == [
    Setting('float32', 'default'),
    Setting('float32', 'compile'),
    Setting('bfloat16', 'default'),
    Setting('bfloat16', 'compile'),
  ]


def test_a_setting_becomes_flags():
  setting = Setting('bfloat16', 'channels_last+compile')
  first, program, *rest = peer.make_command('py', setting, network='shape', batch_size=12, steps=3)
  assert first == 'py' and program.endswith('torch_peer.py')
  assert rest == [
    *('--network=shape', '--batch_size=12', '--steps=3', '--dtype=bfloat16'),
    *('--channels_last', '--compile'),
  ]


def test_a_gpu_is_compared_with_a_gpu_that_may_round_as_ours():
  options = {'network': 'shape', 'batch_size': 12, 'steps': 3, 'platform': 'gpu'}
  command = peer.make_command('py', Setting('float32', 'default'), **options)
  assert command[-2:] == ['--device=cuda', '--tf32']


def test_the_last_figure_counts():
  code = "print('PyTorch 9'); print('first: 1.25 images/s'); print('8.50 images/s')"
  assert peer.run(python(code)) == peer.Trial(8.5, 'PyTorch 9')


def test_time_is_up():
  assert peer.run(python('import time; time.sleep(60)'), timeout=0.2) is None


@pytest.mark.parametrize(
  'code, message',
  [
    ("print('fast')", r"no figure such as '8.5 images/s' \(fast\)"),
    ('', r'no figure .* \(no output\)'),
    ("print('0 images/s')", 'no figure'),
    ("import sys; sys.exit('no memory')", r'status 1 \(no memory\)'),
  ],
)
def test_no_figure(code, message):
  with pytest.raises(UserError, match=message):
    peer.run(python(code))


def test_an_interpreter_that_does_not_exist():
  with pytest.raises(UserError, match='--peer_python cannot be run'):
    peer.run(['./no-such-program'])
