"""Settings of the process that make the programs faster. They apply them; nothing needs them.

Memory: a training step frees gigabytes that the next one asks for again. By default the C library
gives them back to the system each time, which then has to map and clear every page anew. Here it
keeps them. Whoever sets GLIBC_TUNABLES has decided otherwise, and so is left alone.

Compiled programs: JAX keeps them in $XDG_CACHE_HOME/cvn/jax (~/.cache/cvn/jax), so that the first
step of the next run takes seconds. JAX_COMPILATION_CACHE_DIR names another folder, and
JAX_ENABLE_COMPILATION_CACHE=false does without.
"""

import ctypes
import os
import pathlib
import platform

import jax

# Parameters of mallopt, from the C library's malloc.h.
_M_TRIM_THRESHOLD = -1
_M_MMAP_MAX = -4
_M_ARENA_MAX = -8


def prepare() -> None:
  """Applies all settings to this process; to be called before its first computation."""
  if 'GLIBC_TUNABLES' not in os.environ:
    keep_memory()
  if jax.config.jax_compilation_cache_dir is None:
    keep_programs(_cache() / 'jax')


def keep_memory() -> bool:
  """Makes the C library keep what is freed; returns whether it does (GNU's C library only)."""
  if libc() != 'glibc':
    return False
  mallopt = ctypes.CDLL(None).mallopt
  # No block is mapped by itself, which would be unmapped when it is freed; the heap's end is never
  # given back; and all threads share that heap, since the others cannot hold large blocks.
  settings = ((_M_MMAP_MAX, 0), (_M_TRIM_THRESHOLD, -1), (_M_ARENA_MAX, 1))
  return all(mallopt(parameter, value) == 1 for parameter, value in settings)


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
