"""Optional process-level speed-ups: memory that is kept, and a compilation cache.

A training step frees gigabytes that the next step asks for again. By default the GNU C library
returns such blocks to the system, which then has to map and clear every page anew. `keep_memory`
changes the C library's settings within the process: one heap, in huge pages, that never shrinks.
A user who sets LD_PRELOAD, GLIBC_TUNABLES or a variable MALLOC_* has chosen other settings, which
then stay.

JAX keeps compiled programs in $XDG_CACHE_HOME/cvn/jax (~/.cache/cvn/jax), so the first step of the
next run takes seconds. JAX_COMPILATION_CACHE_DIR names another folder, and
JAX_ENABLE_COMPILATION_CACHE=false switches it off.
"""

import ctypes
import os
import pathlib
import platform
import sys

import jax

from cvn.errors import UserError

# Parameters of mallopt (malloc.h) and of madvise.
_TRIM_THRESHOLD, _TOP_PAD, _MMAP_MAX, _ARENA_MAX = -1, -2, -4, -8
_MADV_HUGEPAGE = 14
_HUGE_PAGE = 2 << 20  # bytes
_SMALLEST_HEAP = 256 << 20  # bytes


def prepare() -> None:
  """Applies all settings to this process; call it before the first computation."""
  keep_memory()
  if jax.config.jax_compilation_cache_dir is None:
    keep_programs(_cache() / 'jax')


def check_platforms() -> None:
  """Checks that every platform in JAX_PLATFORMS has a device; initialises JAX's backends.

  Raises:
    UserError: a platform has no device on this machine.
  """
  asked = jax.config.jax_platforms
  if not asked:
    return
  try:
    jax.devices()
  except Exception as e:  # RuntimeError or, for CUDA without a driver, an assertion of JAX's
    why = ' '.join(str(e).split()) or 'no such device'
    raise UserError(
      f'JAX_PLATFORMS={asked} is not available on this machine: unset it, or set it to cpu ({why})'
    ) from e


def keep_memory() -> bool:
  """Makes the C library keep freed memory for the next request; returns whether it does.

  Large blocks come from the heap instead of separate mappings, all threads share one heap, and the
  heap never shrinks. Half of the machine's memory is reserved as address space, so that huge pages
  can be requested; untouched pages take no memory.
  """
  chosen = any(v in ('LD_PRELOAD', 'GLIBC_TUNABLES') or v.startswith('MALLOC_') for v in os.environ)
  if chosen or sys.platform != 'linux' or libc() != 'glibc':
    return False
  c = ctypes.CDLL(None)
  c.malloc.restype, c.malloc.argtypes = ctypes.c_void_p, [ctypes.c_size_t]
  c.free.restype, c.free.argtypes = None, [ctypes.c_void_p]
  c.madvise.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int]
  settings = ((_ARENA_MAX, 1), (_MMAP_MAX, 0), (_TRIM_THRESHOLD, -1), (_TOP_PAD, 64 << 20))
  if not all([c.mallopt(*setting) for setting in settings]):
    return False
  size = os.sysconf('SC_PHYS_PAGES') * os.sysconf('SC_PAGE_SIZE') // 2
  while size >= _SMALLEST_HEAP:
    start = c.malloc(size)
    if start:
      first = -(-start // _HUGE_PAGE) * _HUGE_PAGE
      c.madvise(first, start + size - first, _MADV_HUGEPAGE)  # only advice: it may fail
      c.free(start)
      break
    size //= 2
  return True


def keep_programs(folder: str | os.PathLike) -> bool:
  """Makes JAX keep compiled programs in a folder; returns whether the folder can be written."""
  try:
    os.makedirs(folder, exist_ok=True)
  except OSError:
    return False
  if not os.access(folder, os.W_OK):
    return False
  jax.config.update('jax_compilation_cache_dir', str(folder))
  return True


def libc() -> str:
  """The name of the C library, '' where it is not known."""
  return platform.libc_ver()[0]


def _cache() -> pathlib.Path:
  home = os.environ.get('XDG_CACHE_HOME') or os.path.expanduser('~/.cache')
  return pathlib.Path(home) / 'cvn'
