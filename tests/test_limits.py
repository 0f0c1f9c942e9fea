"""Work that takes too long or too much ends with a reason, and what called it goes on."""

import gc
import subprocess
import sys
import time
import weakref

import pytest

from cvn.errors import UserError
from datagen import limits

MEBIBYTE = 2**20


def test_work_in_time_returns_its_value():
  assert limits.call_within(60, divmod, 7, 2) == (3, 1)


def test_errors_of_the_work_are_raised():
  with pytest.raises(ZeroDivisionError):
    limits.call_within(60, divmod, 7, 0)


def endless():
  while True:
    pass


def stubborn():
  """Catches everything, once: as readers of files do with `except BaseException`."""
  try:
    endless()
  except BaseException:
    endless()


@pytest.mark.parametrize('work', [endless, stubborn])
def test_endless_work_is_given_up(work):
  with pytest.raises(UserError, match=r'took more than 0\.2 s'):
    limits.call_within(0.2, work)


def test_waiting_for_the_processor_does_not_count():
  """The work computes for less than its limit, but takes longer by the clock."""

  def slow():
    time.sleep(1.0)
    return 'done'

  assert limits.call_within(0.5, slow) == 'done'


def test_work_that_waits_for_good_is_given_up():
  def waiting():
    while True:
      time.sleep(0.01)

  start = time.monotonic()
  with pytest.raises(UserError, match=r'took more than 0\.2 s'):
    limits.call_within(0.2, waiting)
  assert time.monotonic() - start >= 0.2 * limits.PATIENCE


def test_native_work_that_does_not_return_ends_the_process():
  code = (
    'import time; from datagen import limits; limits.call_within(0.1, time.sleep, 600, grace=1)'
  )
  start = time.monotonic()
  finished = subprocess.run([sys.executable, '-c', code], timeout=300)
  assert finished.returncode == limits.EXIT_STATUS
  assert time.monotonic() - start < 300


class Held:
  """What work has in hand."""


def test_failed_work_gives_back_what_it_held_at_once():
  """The next model needs the memory, and a traceback keeps all variables alive."""
  held = []

  def work():
    mine = Held()
    held.append(weakref.ref(mine))
    raise MemoryError

  gc.disable()
  try:
    with pytest.raises(MemoryError):
      limits.call_within(60, work)
    assert held[0]() is None
  finally:
    gc.enable()


@pytest.mark.skipif(not sys.platform.startswith('linux'), reason='only Linux heeds the limit')
def test_memory_is_bounded():
  # In a process of its own: the limit is for good.
  code = f"""
import numpy as np
from datagen import limits
limits.limit_memory({1024 * MEBIBYTE})
np.ones({16 * MEBIBYTE})
try:
  np.ones({1024 * MEBIBYTE})
except MemoryError:
  print('refused')
"""
  finished = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True)
  assert finished.stdout == 'refused\n', finished.stderr
