"""Executors for the work: local processes, or the workers of a Dask cluster.

Both have the interface of `concurrent.futures.Executor`, the only one that datagen/pipeline.py
uses.
"""

import contextlib
import logging
import os
import threading
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from multiprocessing import get_context, parent_process
from multiprocessing.connection import wait as wait_for_process

import drjit

from cvn.errors import UserError
from datagen.limits import limit_memory

CONNECT_TIMEOUT = 30  # seconds


def process_executor(workers: int, memory: int) -> Executor:
  """Local processes, each on one core and with at most `memory` bytes.

  They are spawned, not forked: threads of the parent would not survive a fork.
  """
  for name in ('OPENBLAS_NUM_THREADS', 'OMP_NUM_THREADS', 'MKL_NUM_THREADS'):
    os.environ.setdefault(name, '1')  # read by the children as they load their libraries
  return ProcessPoolExecutor(
    workers,
    mp_context=get_context('spawn'),
    initializer=_start_worker,
    initargs=(memory,),
  )


@contextlib.contextmanager
def dask_client(address: str) -> Iterator:
  """A client of a Dask scheduler; its `get_executor` returns executors.

  Args:
    address: an address such as `tcp://10.0.0.1:8786`, or the scheduler's --scheduler-file.

  Raises:
    UserError: Dask is not installed, or no scheduler answers.
  """
  try:
    from distributed import Client
  except ImportError as e:
    raise UserError("--scheduler needs Dask: pip install 'cvn[dask]'") from e
  # A scheduler that goes away is told by an error of ours; Dask would print tracebacks of its own.
  logging.getLogger('distributed').setLevel(logging.CRITICAL)
  where = {'scheduler_file': address} if os.path.isfile(address) else {'address': address}
  try:
    client = Client(**where, timeout=CONNECT_TIMEOUT)
  except (OSError, ValueError) as e:
    raise UserError(f'no Dask scheduler answers at --scheduler={address}') from e
  with client:
    yield client


def _start_worker(memory: int) -> None:
  limit_memory(memory)
  drjit.set_thread_count(1)
  # A terminal sends its interrupt to the whole group of processes. Mitsuba would end its rendering
  # in the middle, and half a view would count as one: the parent alone decides when to stop.
  os.setpgrp()
  threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
  """Ends a worker when its parent is killed; otherwise it would wait for jobs forever."""
  wait_for_process([parent_process().sentinel])
  os._exit(1)
