"""Trials are run once, kept, and believed; a library that fails its trial is refused."""

import json
import logging
import os
import sys
from concurrent.futures import ThreadPoolExecutor

import pytest

from cvn.ops import compile as compiling
from cvn.ops import native, timings
from cvn.ops.timings import Times

GOOD = {
  'seconds': {
    'deconv': {'float32': [0.003, 0.009], 'mixed': [0.002, 0.009]},
    'conv': {'float32': [0.002, 0.001], 'mixed': [0.001, 0.004]},
  }
}


@pytest.fixture
def library(tmp_path):
  path = tmp_path / 'kernels.so'
  path.write_text('a library')
  return path


@pytest.fixture
def trial(tmp_path, monkeypatch):
  """Puts a shell script in the place of the trial; returns how often it was run."""
  monkeypatch.setattr(os, 'getloadavg', lambda: (0.0, 0.0, 0.0))
  log = tmp_path / 'runs'

  def put(script):
    path = tmp_path / 'python'
    path.write_text(f'#!/bin/sh\necho "$@ $CVN_KERNELS $JAX_PLATFORMS" >> {log}\n{script}\n')
    path.chmod(0o755)
    monkeypatch.setattr(sys, 'executable', str(path))
    return lambda: len(log.read_text().splitlines())

  return put


def test_a_trial_is_run_once_and_kept(tmp_path, library, trial, caplog):
  runs = trial(f"echo noise; echo '{json.dumps(GOOD)}'")
  caplog.set_level(logging.INFO, 'absl')
  first = timings.find(library, tmp_path / 'cache')
  assert first['deconv'] == {'float32': Times(0.003, 0.009), 'mixed': Times(0.002, 0.009)}
  assert timings.find(library, tmp_path / 'cache') == first and runs() == 1
  called = (tmp_path / 'runs').read_text()
  assert called == f'-m cvn.ops.trial {library} off cpu\n'
  told = [(r.levelname, r.getMessage()) for r in caplog.records]
  line = 'cvn: plain products are used where they are faster than kernels: conv in float32'
  line += ' (2.0 ms, plain 1.0 ms)'
  assert told == [('WARNING', line), ('INFO', line)]
  library.write_text('another library')
  timings.find(library, tmp_path / 'cache')
  assert runs() == 2


@pytest.mark.parametrize(('lost', 'runs_twice'), [(0.001, True), (0.003, False)])
def test_kernels_that_lose_on_a_busy_machine_are_tried_again(
  tmp_path, library, trial, monkeypatch, lost, runs_twice
):
  times = {'seconds': {'conv': {'float32': [0.002, lost], 'mixed': [0.001, 0.004]}}}
  runs = trial(f"echo '{json.dumps(times)}'")
  monkeypatch.setattr(os, 'getloadavg', lambda: (100.0 * os.cpu_count(), 0.0, 0.0))
  first, second = (timings.find(library, tmp_path / 'cache') for _ in range(2))
  assert first == second and first['conv']['float32'] == Times(0.002, lost)
  assert runs() == 1 + runs_twice


def test_processes_that_start_together_run_one_trial(tmp_path, library, trial):
  runs = trial(f"sleep 0.3; echo '{json.dumps(GOOD)}'")
  with ThreadPoolExecutor(3) as executor:
    list(executor.map(lambda _: timings.find(library, tmp_path / 'cache'), range(3)))
  assert runs() == 1


@pytest.mark.parametrize(
  ('script', 'message', 'kept'),
  [
    ('kill -ILL $$', 'its trial ended with SIGILL', True),
    ('kill -KILL $$', 'its trial was killed by SIGKILL', False),
    ('echo \'{"refused": "wrong values"}\'', 'wrong values', True),
    ('echo one; echo "Error: no" >&2; exit 1', 'its trial failed: Error: no', False),
    ('true', 'its trial failed: no output', False),
    ('echo \'{"seconds": {"conv": {"float32": [1]}}}\'', 'its trial failed', False),
    ('echo \'{"seconds": 3}\'', 'its trial failed', False),
    ('echo 3', 'its trial failed', False),
    ('exec sleep 60', 'its trial did not end in 1 s', False),
  ],
)
def test_a_library_is_refused(tmp_path, library, trial, monkeypatch, script, message, kept):
  monkeypatch.setattr(timings, 'TIMEOUT', 1 if 'sleep' in script else 100)
  runs = trial(script)
  for _ in range(2):
    with pytest.raises(RuntimeError, match=f'kernels.so: {message}') as caught:
      timings.find(library, tmp_path / 'cache')
  assert runs() == (1 if kept else 2)
  stored = [n for n in os.listdir(tmp_path / 'cache') if n != 'trial.lock']
  assert len(stored) == kept
  assert (f'remove {tmp_path}/cache/trial-' in str(caught.value)) == kept


def test_damaged_results_are_measured_again(tmp_path, library, trial):
  runs = trial(f"echo '{json.dumps(GOOD)}'")
  found = timings.find(library, tmp_path / 'cache')
  (stored,) = (tmp_path / 'cache').glob('trial-*.json')
  for text in ('', '{"seconds"', '{"seconds": {"conv": 1}}', '[]'):
    stored.write_text(text)
    assert timings.find(library, tmp_path / 'cache') == found
  assert runs() == 5


def test_a_folder_that_cannot_be_written_keeps_nothing(tmp_path, library, trial, caplog):
  runs = trial(f"echo '{json.dumps(GOOD | {'seconds': {}})}'")
  (tmp_path / 'cache').write_text('a file where the folder is due')
  for n in (1, 2):
    assert timings.find(library, tmp_path / 'cache') == {} and runs() == n
  assert [r.getMessage().startswith('cvn: the speed of') for r in caplog.records] == [True] * 2


def test_the_faster_type_counts_what_would_be_used():
  table = {
    'deconv': {'float32': Times(0.003, 0.009), 'mixed': Times(0.0031, 0.009)},
    'conv': {'float32': Times(0.004, 0.002), 'mixed': Times(0.001, 0.004)},
    'conv2d': {'float32': Times(0.001, 0.002), 'mixed': Times(0.001, 0.001)},
  }
  told = 'small layers take 6.0 ms in float32, 5.1 ms in mixed on this processor'
  assert timings.choose_dtype(table) == ('mixed', told)
  table['conv']['mixed'] = Times(0.0018, 0.004)  # 5.9 ms: not worth the digits
  assert timings.choose_dtype(table)[0] == 'float32'


@pytest.mark.skipif(not native.available(), reason='no C++ compiler here')
def test_a_library_that_crashes_hurts_nobody(tmp_path):
  """As one does that has instructions which the processor lacks."""
  source = tmp_path / 'crash.cc'
  source.write_text('__attribute__((constructor)) void Crash() { __builtin_trap(); }\n')
  compiling.compile_library(source, tmp_path / 'kernels.so')
  with pytest.raises(RuntimeError, match='its trial ended with SIG'):
    timings.find(tmp_path / 'kernels.so', tmp_path / 'cache')


@pytest.mark.skipif(not native.available(), reason='no C++ compiler here')
def test_a_library_without_kernels_is_refused(tmp_path):
  source = tmp_path / 'empty.cc'
  source.write_text('int nothing;\n')
  compiling.compile_library(source, tmp_path / 'kernels.so')
  with pytest.raises(RuntimeError, match='undefined symbol: cvn_'):
    timings.find(tmp_path / 'kernels.so', tmp_path / 'cache')


def test_a_real_trial_times_every_operation():
  """Of this process's own library, whose trial is done by now."""
  if not native.available():
    pytest.skip('no C++ compiler here')
  found = native.library().timings
  assert set(found) == {'deconv', 'conv', 'activated', 'conv2d'}
  assert all(
    0 < t < 100 for by_dtype in found.values() for times in by_dtype.values() for t in times
  )
