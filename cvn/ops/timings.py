"""How fast a library's kernels are on this processor, measured once and kept.

trial.py measures in a process of its own. The result is a JSON file in the user's cache, under a
name that depends on the library, the processor, jaxlib, trial.py and the plain products. A library
that crashes the trial or computes wrong values is refused, and that is kept too. A trial that does
not end is not kept, and neither are kernels that lose on a busy machine: other programs may be why.
"""

import json
import os
import pathlib
import signal
import subprocess
import sys
from typing import NamedTuple

import jaxlib
from absl import logging

from cvn import files
from cvn.errors import UserError
from cvn.ops import compile as compiling

TIMEOUT = 180  # s; a trial takes about 10
_MEASURED = [pathlib.Path(__file__).with_name(name) for name in ('trial.py', 'matmul.py')]
_PACKAGES = pathlib.Path(__file__).parents[2]
# These end a process that the library, and nobody else, has brought down.
_FATAL = {'SIGILL', 'SIGSEGV', 'SIGBUS', 'SIGFPE', 'SIGABRT', 'SIGTRAP'}
_DTYPES = ('float32', 'mixed')


class Times(NamedTuple):
  """Seconds for the value and all gradients of a layer; each the shortest of a few."""

  kernels: float
  plain: float


Timings = dict[str, dict[str, Times]]  # of operations, in 'float32' and 'mixed'


def find(library: pathlib.Path, folder: pathlib.Path) -> Timings:
  """The timings of a library; measures them if the folder has none.

  One line tells which kernels lose, when they are measured.

  Raises:
    RuntimeError: the library is refused.
    OSError: it cannot be read, or the trial cannot run.
  """
  told = [path.read_bytes() for path in (library, *_MEASURED)]
  told += [compiling.describe_processor().encode(), jaxlib.__version__.encode()]
  stored = folder / f'trial-{compiling.digest(*told)}.json'
  with files.locked(folder / 'trial.lock'):  # trials at the same time would disturb each other
    try:
      found, new = _parse(stored.read_bytes()), False
    except (OSError, ValueError):
      found, new = _run(library), True
      if 'refused' in found or not _is_busy() or not describe_losers(_to_timings(found)):
        _store(stored, found)
  if 'refused' in found:
    again = f'; remove {stored} for another trial' if stored.exists() else ''
    raise RuntimeError(f'{library.name}: {found["refused"]}{again}')
  timings = _to_timings(found)
  losers = describe_losers(timings)
  if losers:
    logging.log(logging.WARNING if new else logging.INFO, 'cvn: %s', losers)
  return timings


def describe_losers(timings: Timings) -> str:
  """One line about the kernels that are slower than plain products; '' if none is."""
  lost = [
    f'{operation} in {dtype} ({1e3 * t.kernels:.1f} ms, plain {1e3 * t.plain:.1f} ms)'
    for operation, by_dtype in timings.items()
    for dtype, t in by_dtype.items()
    if not wins(t)
  ]
  if not lost:
    return ''
  return f'plain products are used where they are faster than kernels: {", ".join(lost)}'


def wins(times: Times) -> bool:
  """Whether the kernels are at least as fast as the plain product."""
  return times.kernels <= times.plain


def choose_dtype(timings: Timings) -> tuple[str, str]:
  """The faster of 'float32' and 'mixed' for the networks, and why.

  It is 'mixed' if that is at least a twentieth faster: otherwise float32 is as fast and more exact.
  """
  totals = {d: 1e3 * sum(min(by_dtype[d]) for by_dtype in timings.values()) for d in _DTYPES}
  chosen = 'mixed' if totals['mixed'] < 0.95 * totals['float32'] else 'float32'
  listed = ', '.join(f'{totals[d]:.1f} ms in {d}' for d in _DTYPES)
  return chosen, f'small layers take {listed} on this processor'


def _is_busy():
  """Whether more programs compute than there are processors."""
  return hasattr(os, 'getloadavg') and os.getloadavg()[0] > 1.5 * (os.cpu_count() or 1)


def _run(library):
  """What the trial prints, or why the library is refused.

  Raises:
    OSError: the trial cannot run.
    RuntimeError: it ended for another reason than the library.
  """
  environment = {k: v for k, v in os.environ.items() if not k.startswith('JAX_')}
  path = os.pathsep.join(filter(None, [str(_PACKAGES), environment.get('PYTHONPATH')]))
  # The trial names its library itself: it must not look for one, and so begin another trial.
  environment |= {'PYTHONPATH': path, 'JAX_PLATFORMS': 'cpu', 'CVN_KERNELS': 'off'}
  environment['JAX_TRACEBACK_FILTERING'] = 'off'  # or an error would not be the last line
  command = [sys.executable, '-m', 'cvn.ops.trial', str(library)]
  try:
    done = subprocess.run(command, env=environment, capture_output=True, timeout=TIMEOUT)
  except subprocess.TimeoutExpired as e:  # which may be the fault of other programs: not kept
    raise RuntimeError(f'{library.name}: its trial did not end in {TIMEOUT} s') from e
  if done.returncode < 0:
    name = signal.Signals(-done.returncode).name
    if name in _FATAL:
      return {'refused': f'its trial ended with {name}'}
    raise RuntimeError(f'{library.name}: its trial was killed by {name}')
  try:
    return _parse(done.stdout.splitlines()[-1])
  except (IndexError, ValueError) as e:
    last = (done.stderr.decode(errors='replace').strip() or 'no output').splitlines()[-1]
    raise RuntimeError(f'{library.name}: its trial failed: {last}') from e


def _parse(text):
  """A result of trial.py.

  Raises:
    ValueError: it is none.
  """
  found = json.loads(text)
  if isinstance(found, dict) and isinstance(found.get('refused'), str):
    return found
  try:
    _to_timings(found)
  except (TypeError, KeyError, AttributeError) as e:
    raise ValueError('not a result of a trial') from e
  return found


def _to_timings(found) -> Timings:
  return {
    operation: {dtype: Times(*map(float, by_dtype[dtype])) for dtype in _DTYPES}
    for operation, by_dtype in found['seconds'].items()
  }


def _store(path, found):
  """Keeps the result, if the folder can be written."""
  try:
    with files.atomic_write(str(path)) as temporary, open(temporary, 'w') as f:
      json.dump(found, f, indent=1)
  except UserError as e:
    logging.warning('cvn: the speed of the kernels will be measured again (%s)', e)
