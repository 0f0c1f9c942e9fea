"""Limits of time and memory for work on what strangers send."""

import ctypes
import os
import threading
import time
import traceback
from collections.abc import Callable
from concurrent.futures import Future

from cvn.errors import UserError

try:
  import resource
except ImportError:  # no limits of memory where the system has none
  resource = None

PATIENCE = 10  # times as long by the clock as work may compute: the machine may be busy or stopped
GRACE = 30.0  # seconds that code has for noticing that its time is over
EXIT_STATUS = 75  # of a process that did not notice


class _TimeIsOver(BaseException):
  """Raised within work that took too long. No `Exception`: few readers of files catch it."""


def call_within(seconds: float, function: Callable, *args, grace: float = GRACE):
  """Calls a function, and gives it up when it takes too long.

  Time counts while this process computes: on a busy machine, work gets as much as on an idle one.
  Work that waits for something else is given up after `PATIENCE` times as long.

  It runs in a thread of its own, in which an exception is raised when time is over. Python code
  notices at once. Native code does when it returns; if that takes more than `grace` seconds, the
  whole process ends with `EXIT_STATUS`, because nothing less can stop it.

  Args:
    seconds: the limit, in seconds of processor time and by the clock.
    function: what to call.
    *args: its arguments.
    grace: seconds.

  Returns:
    What the function returns.

  Raises:
    UserError: it took too long; and what the function raises.
  """
  future: Future = Future()

  def work():
    try:
      future.set_result(function(*args))
    except BaseException as e:
      traceback.clear_frames(e.__traceback__)  # or all that it had in hand would live on with it
      future.set_exception(e)

  thread = threading.Thread(target=work, daemon=True)
  clock, computed = time.monotonic(), time.process_time()
  thread.start()
  thread.join(seconds)
  while thread.is_alive() and time.monotonic() - clock < PATIENCE * seconds:
    left = seconds - (time.process_time() - computed)
    if left <= 0:
      break
    thread.join(max(left, 0.05))
  if thread.is_alive():
    for _ in range(max(1, round(grace))):  # again and again: some code catches everything
      ctypes.pythonapi.PyThreadState_SetAsyncExc(
        ctypes.c_ulong(thread.ident), ctypes.py_object(_TimeIsOver)
      )
      thread.join(1.0)
      if not thread.is_alive():
        break
    else:
      os._exit(EXIT_STATUS)
    raise UserError(f'it took more than {seconds:g} s')
  return future.result()


def limit_memory(size: int) -> None:
  """From now on this process cannot have more than `size` bytes of data: MemoryError is raised.

  Shared libraries and files that are mapped do not count. Systems other than Linux may not heed it.
  It is for processes that work for others: nothing in this one is spared.
  """
  if resource is None:
    return
  _, hard = resource.getrlimit(resource.RLIMIT_DATA)
  soft = size if hard == resource.RLIM_INFINITY else min(size, hard)
  resource.setrlimit(resource.RLIMIT_DATA, (soft, hard))
