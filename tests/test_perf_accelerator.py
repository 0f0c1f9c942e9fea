"""The benchmark of an accelerator prints and keeps what it measured."""

import json
import math
from concurrent.futures import Future

import jax
import pytest
from absl import flags

from cvn.errors import UserError
from experiments.perf import accelerator
from experiments.perf.accelerator import Combination, Program

MACHINE = {
  'processor': 'Abacus',
  'cores': 16,
  'devices': '1 x GPU 9',
  'compiled kernels': None,
  'versions': {'jax': '1.2'},
  'settings': {},
}
PROFILE = [{'operation': 'fusion.1', 'kernel': 'fusion_1', 'seconds': 0.002, 'calls': 1.0}]


class Peer:
  """PyTorch's process, at half of our speed; a batch of 256 is too large for it."""

  def __init__(self):
    self.calls = []

  def submit(self, function, *arguments, batch_size=0, **options):
    self.calls.append((function.__name__, *arguments, batch_size, options))
    future = Future()
    if batch_size == 256:
      future.set_exception(RuntimeError('CUDA out of memory\nmore'))
    else:
      future.set_result('PyTorch 9' if not arguments else [9.0, 0.2, 0.2])
    return future


@pytest.fixture(autouse=True)
def measured(monkeypatch):
  program = Program(None, 12.0, 6 << 30, 1e12, 'HloModule m')
  monkeypatch.setattr(accelerator, 'compile_step', lambda combination: program)
  monkeypatch.setattr(accelerator, 'time_steps', lambda *_: [0.1, 0.1])
  monkeypatch.setattr(accelerator, 'profile_steps', lambda *_: PROFILE)
  monkeypatch.setattr(accelerator.measuring, 'describe_machine', lambda: dict(MACHINE))


def measure(sizes, peer=None, **options):
  defaults = {'steps': 2, 'profile': 0, 'end': math.inf, 'path': None, 'programs': None}
  return accelerator.measure_all(sizes, peer, **defaults | options)


def test_figures_of_each_combination_with_pytorch_in_turn(capsys, tmp_path):
  peer, path = Peer(), tmp_path / 'found.json'
  sizes = [[Combination('shape', 60, 'tf32'), Combination('color', 60, 'mixed')]]
  found = measure(sizes, peer, path=str(path), programs=str(tmp_path), profile=1)
  out = capsys.readouterr().out
  assert out.startswith('Abacus, 16 cores; 1 x GPU 9;') and '\nPyTorch 9\n' in out
  assert 'shape, batch 60, tf32: 600.00 (600.00 to 600.00) images/s, 100.00 ms a step' in out
  assert '6.00 GiB, compiled in 12.0 s; PyTorch 300.00 (300.00 to 300.00), ours is 2.00' in out
  assert '2.000 ms  1.0 x fusion.1' in out
  assert json.loads(path.read_text()) == found
  assert [f['kind'] for f in found['training']] == ['shape', 'color']
  assert (tmp_path / 'shape-60-tf32.txt').read_text() == 'HloModule m'
  assert peer.calls[1:] == [
    *[('time_peer', 'shape', 60, {'steps': 2, 'dtype': 'float32', 'tf32': True})] * 2,
    *[('time_peer', 'color', 60, {'steps': 2, 'dtype': 'bfloat16', 'tf32': True})] * 2,
  ]
  assert accelerator.format_results(found['training']).splitlines()[2:] == [
    '| shape | 60 | tf32 | 600 | 300 | 2.00 | 6.0 | 102 |',
    '| color | 60 | mixed | 600 | 300 | 2.00 | 6.0 | 102 |',
  ]


def test_what_does_not_fit_is_told_and_the_rest_goes_on(capsys, monkeypatch):
  def too_large(step, kind, *_):
    if kind == 'color':
      raise jax.errors.JaxRuntimeError('RESOURCE_EXHAUSTED: 99 GB\nmore')
    return [0.1]

  monkeypatch.setattr(accelerator, 'time_steps', too_large)
  found = measure([[Combination(k, 256, 'mixed') for k in ('color', 'shape')]], Peer())
  out = capsys.readouterr().out
  assert 'color, batch 256, mixed: RESOURCE_EXHAUSTED: 99 GB\n' in out
  assert 'shape, batch 256, mixed: PyTorch: CUDA out of memory\n' in out
  assert [(f['kind'], f['peer']) for f in found['training']] == [('shape', [])]
  assert '| shape | 256 | mixed | 2560 | 0 |  |' in accelerator.format_results(found['training'])


def test_time_is_up(capsys):
  found = measure([[Combination('shape', 60, 'mixed')]], end=0)
  assert found['training'] == []
  assert 'shape, batch 60, mixed: left out, time is up' in capsys.readouterr().out


def test_pytorch_is_missing(monkeypatch):
  peer = Peer()
  failed = Future()
  failed.set_exception(ModuleNotFoundError("No module named 'torch'"))
  monkeypatch.setattr(peer, 'submit', lambda *_, **__: failed)
  with pytest.raises(UserError, match=r"No module named 'torch': install it .* --nopeer"):
    measure([[Combination('shape', 60, 'mixed')]], peer)


@pytest.mark.parametrize('argument', ['--batch_size=1', '--batch_size=a', '--dtype=f16'])
def test_wrong_flags(argument):
  f = flags.FlagValues()
  accelerator.define_flags(f)
  with pytest.raises(flags.IllegalFlagValueError):
    f(['accelerator', argument])


@pytest.mark.slow
def test_for_real(monkeypatch, capsys):
  monkeypatch.undo()
  found = measure([[Combination('shape', 2, 'tf32')]], steps=1, profile=3)
  (training,) = found['training']
  assert training['memory'] > 1 << 26 and len(training['seconds']) == accelerator.ROUNDS
