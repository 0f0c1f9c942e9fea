"""Limits on the time and memory of work on untrusted input."""

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
  """Raised in work that took too long. Not an `Exception`: file readers would catch it."""


def call_within(seconds: float, function: Callable, *args, grace: float = GRACE):
  """Calls a function, and gives up if it takes too long.

  The limit is on processor time, so that a busy machine gets as much work done as an idle one. Work
  that waits for something else is given up after `PATIENCE` times as long.

  The function runs in a thread of its own, in which an exception is raised when time is up. Python
  code stops at once, native code when it returns. If that takes more than `grace` seconds, the
  process exits with `EXIT_STATUS`, because nothing less can stop it.

  Args:
    seconds: the limit, in seconds of processor time and of wall time.
    function: the function to call.
    *args: its arguments.
    grace: seconds to wait for native code.

  Returns:
    The result of the function.

  Raises:
    UserError: it took too long. Exceptions of the function are passed on.
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
  """Limits the data of this process to `size` bytes: beyond that, MemoryError is raised.

  Shared libraries and mapped files do not count. Systems other than Linux may ignore the limit. Use
  it only in worker processes: it cannot be lifted again.
  """
  if resource is None:
    return
  _, hard = resource.getrlimit(resource.RLIMIT_DATA)
  soft = size if hard == resource.RLIM_INFINITY else min(size, hard)
  resource.setrlimit(resource.RLIMIT_DATA, (soft, hard))
