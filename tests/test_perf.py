"""The benchmark measures what its flags name and prints it; the measurements are faked."""

import json
import os

import pytest
from absl import flags

from cvn.errors import UserError
from experiments.perf import __main__ as benchmark
from experiments.perf import layers, limits, measuring, peer

MACHINE = {
  'processor': 'Abacus',
  'cores': 2,
  'platform': 'cpu',
  'devices': '1 x cpu',
  'compiled kernels': 'AVX2 (compiled)',
  'versions': {'jax': '1.2'},
  'settings': {'MALLOC_X': '1'},
}
PEAKS = layers.Peaks(1e9, 2e9, 1e9)
ROW = layers.Row(
  'a',
  (2, 3),
  'float32',
  layers.Cost(1000, 100, 1e-6, 2e-6),
  layers.Cost(2000, 200, 2e-6, 4e-6),
)


@pytest.fixture
def calls(monkeypatch):
  """What was measured, in order; PyTorch runs at a quarter of our speed at best."""
  calls = []
  answers = {
    'describe_machine': lambda: MACHINE,
    'time_steps': lambda kind, size, mixed, steps: measuring.Steps(
      9.0 / len(calls), (0.5,) * steps, 3 << 30, None
    ),
    'time_layers': lambda kind, size, mixed: (PEAKS, [ROW]),
    'time_data': lambda kind, size, mixed, steps, path: measuring.DataTimes(0.5, 0.51, 5 << 30),
    'time_inference': lambda repeats: (0.08,) * repeats,
    'time_reference': lambda kind: measuring.Steps(9.0, (8.0,), 1 << 30, None),
  }

  def alone(function, *args, programs=None):
    calls.append((function.__name__, *args))
    return answers[function.__name__](*args)

  def run_peer(command, *, timeout=None):
    calls.append(('peer', *command[2:], bool(timeout)))
    if '--dtype=bfloat16' in command:
      return None
    return peer.Trial(6.0 if '--channels_last' in command else 3.0, 'PyTorch 9')

  monkeypatch.setattr(measuring, 'alone', alone)
  monkeypatch.setattr(peer, 'run', run_peer)
  return calls


def run(*arguments):
  f = flags.FlagValues()
  benchmark.define_flags(f)
  f(['benchmark', *arguments])
  benchmark.run(f)


def test_prints_what_it_measured(calls, capsys):
  run('--network=shape', '--dtype=mixed', '--steps=3', '--data=set')
  out = capsys.readouterr().out
  assert out.startswith(
    'Abacus, 2 cores; 1 x cpu; kernels for AVX2 (compiled); jax 1.2; MALLOC_X=1\n'
  )
  assert 'shape, batch 12, mixed: 24.00 (24.00 to 24.00) images/s, first step 4.5 s' in out
  assert '(3.0 s with compiled programs in the cache), peak memory 3.00 GiB' in out
  assert (
    '0.510 s a step on set, 0.500 s on one batch of it over and over (+2.0%), peak memory 5.00 GiB'
    in out
  )
  assert 'Peaks: 1 GFLOP/s float32, 2 bfloat16, 1.0 GB/s' in out
  assert '| a | 3 |' in out
  assert calls[1:] == [
    *[('time_steps', 'shape', 12, True, 3)] * 2,
    ('time_data', 'shape', 12, True, 3, 'set'),
    ('time_layers', 'shape', 12, True),
  ]


def test_every_combination_is_measured(calls, capsys):
  run('--batch_size=2,4', '--nolayers', '--reference')
  steps = {c[1:4] for c in calls if c[0] == 'time_steps'}
  assert steps == {(k, b, m) for k in ('shape', 'color') for b in (2, 4) for m in (False, True)}
  assert [c for c in calls if c[0] == 'time_reference'] == [
    ('time_reference', 'shape'),
    ('time_reference', 'color'),
  ]
  out = capsys.readouterr().out
  assert 'one picture, both networks, warm: 80.00 (80.00 to 80.00) ms' in out
  assert "shape, XLA's convolutions, batch 2, float32: 0.25 images/s (one step)" in out
  assert ('time_layers', 'shape', 2, False) not in calls


def test_the_fastest_setting_of_pytorch_runs_in_turn(calls, capsys):
  run('--network=color', '--dtype=float32', '--nolayers', '--peer_python=py', '--steps=2')
  fixed = ('peer', '--network=color', '--batch_size=12', '--steps=2', '--dtype=float32')
  assert [c for c in calls if c[0] == 'peer'] == [
    (*fixed, True),
    (*fixed, '--channels_last', True),
    *[(*fixed, '--channels_last', False)] * 2,
  ]
  assert [c[0] for c in calls[3:]] == ['time_steps', 'peer'] * 2
  out = capsys.readouterr().out
  assert 'PyTorch 9, float32, channels_last: 6.00 images/s' in out
  assert 'PyTorch 6.00 (6.00 to 6.00) images/s, ours is 4.00 (4.00 to 4.00) times as fast' in out


def test_a_mixed_network_meets_float32_too_and_what_takes_too_long_is_left_out(calls, capsys):
  run('--network=shape', '--dtype=mixed', '--nolayers', '--peer_python=py')
  tried = [c[-1] is True and c for c in calls if c[0] == 'peer' and c[-1] is True]
  assert [next(x for x in c if 'dtype' in str(x)) for c in tried] == [
    *['--dtype=float32'] * 2,
    *['--dtype=bfloat16'] * 2,
  ]
  out = capsys.readouterr().out
  assert f'PyTorch, bfloat16, channels_last: none in {peer.TIMEOUT} s' in out
  assert 'ours is 4.00' in out


def test_no_setting_ends_in_time(calls, monkeypatch):
  monkeypatch.setattr(peer, 'run', lambda *_, **__: None)
  with pytest.raises(UserError, match='no setting of PyTorch ended'):
    run('--network=shape', '--nolayers', '--peer_python=py')


def test_a_limit_holds_for_every_process_and_is_printed(calls, capsys, monkeypatch):
  seen = []
  monkeypatch.setattr(limits, 'find_variables', lambda limit: {'CVN_TARGET': f'{limit}-set'})
  monkeypatch.delenv('CVN_TARGET', raising=False)
  monkeypatch.setattr(
    measuring, 'alone', lambda *_, **__: seen.append(os.environ['CVN_TARGET']) or MACHINE
  )
  monkeypatch.setattr(benchmark, 'measure', lambda *_: seen.append(os.environ['CVN_TARGET']))
  run('--network=shape', '--dtype=float32', '--limit=avx2')
  assert seen == ['avx2-set'] * 2
  assert 'CVN_TARGET' not in os.environ
  assert 'limit: CVN_TARGET=avx2-set' in capsys.readouterr().out


def test_json_holds_everything(calls, tmp_path):
  path = tmp_path / 'found.json'
  run('--network=shape', '--dtype=float32', f'--json={path}', '--peer_python=py', '--data=set')
  found = json.loads(path.read_text())
  assert found['machine'] == MACHINE
  (training,) = found['training']
  assert (training['network'], training['batch size'], training['dtype']) == (
    'shape',
    12,
    'float32',
  )
  assert training['images/s'] == {'median': 24, 'low': 24, 'high': 24}
  assert training['peak memory'] == 3 << 30
  assert found['limit'] == {}
  assert training['peer']['ratio']['median'] == 4
  assert training['peer']['setting'] == 'float32, channels_last'
  assert training['peer']['tried'] == {'float32, default': 3, 'float32, channels_last': 6}
  assert training['data'] == {'synthetic': 0.5, 'real': 0.51, 'peak': 5 << 30}
  assert training['peaks']['bandwidth'] == 1e9
  assert training['layers'][0]['forward']['operations'] == 1000
  assert training['layers'][0]['output'] == [2, 3]


def test_a_file_that_cannot_be_written_is_an_error_before_the_work(calls, tmp_path):
  (tmp_path / 'file').write_text('')
  with pytest.raises(UserError, match='cannot write'):
    run(f'--json={tmp_path / "file" / "found.json"}')
  assert len(calls) == 1


@pytest.mark.parametrize(
  'argument',
  ['--batch_size=0', '--batch_size=a', '--dtype=f16', '--rounds=1', '--peer_options=fast'],
)
def test_wrong_flags(argument):
  with pytest.raises(flags.IllegalFlagValueError):
    run(argument)


@pytest.mark.slow
def test_for_real(capsys, tmp_path):
  python = tmp_path / 'python'  # in place of one that has PyTorch
  python.write_text('#!/bin/sh\necho PyTorch 9\necho 2.0 images/s\n')
  python.chmod(0o755)
  arguments = '--network=shape', '--batch_size=2', '--dtype=float32', '--steps=1'
  run(*arguments, f'--peer_python={python}')
  out = capsys.readouterr().out
  assert 'PyTorch 2.00' in out and '| all layers |' in out
