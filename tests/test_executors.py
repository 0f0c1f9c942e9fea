"""A real Dask cluster of separate processes, and what happens to a data set when one is killed."""

import os
import subprocess
import sys
import time

import pytest
from test_generate import contents, program

from cvn.errors import UserError
from datagen import executors

CHAIRS = ['--source=procedural', '--category=chair', '--limit=6']


def start(*arguments):
  command = [sys.executable, '-m', 'distributed.cli.' + arguments[0], *arguments[1:]]
  return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


@pytest.fixture
def cluster(tmp_path):
  """A scheduler's file and two workers' processes, without nannies that would start them again."""
  where = tmp_path / 'scheduler.json'
  scheduler = start(
    'dask_scheduler', '--host=127.0.0.1', '--port=0', f'--scheduler-file={where}', '--no-dashboard'
  )
  deadline = time.monotonic() + 120
  while not where.exists():
    assert time.monotonic() < deadline
    time.sleep(0.05)
  flags = [f'--scheduler-file={where}', '--nthreads=1', '--no-nanny', '--no-dashboard']
  workers = [start('dask_worker', *flags, f'--local-directory={tmp_path}') for _ in range(2)]
  yield where, workers
  for process in (*workers, scheduler):
    process.kill()
    process.wait()


def wait_for_record(output, deadline):
  while not os.path.isdir(output / 'surface_count' / 'c'):
    assert time.monotonic() < deadline
    time.sleep(0.02)


def test_a_worker_killed_in_the_middle_loses_and_doubles_nothing(cluster, tmp_path):
  scheduler, workers = cluster
  command = [sys.executable, '-m', 'datagen.generate', *CHAIRS, f'--scheduler={scheduler}']
  running = subprocess.Popen(
    [*command, f'--output={tmp_path / "far"}'], stdout=subprocess.PIPE, text=True
  )
  wait_for_record(tmp_path / 'far', time.monotonic() + 120)
  time.sleep(0.3)
  workers[0].kill()
  out, _ = running.communicate(timeout=240)
  assert running.returncode == 0
  assert 'made 6, already there 0, failed 0' in out
  finished = program(*CHAIRS, f'--output={tmp_path / "near"}')
  assert finished.returncode == 0, finished.stderr
  assert contents(tmp_path / 'far') == contents(tmp_path / 'near')


def test_no_scheduler_answers(monkeypatch):
  monkeypatch.setattr(executors, 'CONNECT_TIMEOUT', 1)
  with (
    pytest.raises(UserError, match='no Dask scheduler answers at --scheduler=tcp://127'),
    executors.dask_client('tcp://127.0.0.1:9'),
  ):
    pass


def test_dask_is_not_installed(monkeypatch):
  monkeypatch.setitem(sys.modules, 'distributed', None)
  with (
    pytest.raises(UserError, match='needs Dask: pip install'),
    executors.dask_client('tcp://127.0.0.1:9'),
  ):
    pass
