"""Settings of the process that make the programs faster. They apply them; nothing needs them.

Memory: a training step frees gigabytes that the next one asks for again. The C library gives them
back to the system each time, which then has to map and clear every page anew. A small library
(blocks.cc, compiled once like the kernels) keeps large blocks instead, in huge pages; because it
must be loaded before all else, a program that prepares itself starts itself once more under it.
Whoever sets LD_PRELOAD has decided otherwise and is left alone; CVN_KERNELS=off does without, too.

Compiled programs: JAX keeps them in $XDG_CACHE_HOME/cvn/jax (~/.cache/cvn/jax), so that the first
step of the next run takes seconds. JAX_COMPILATION_CACHE_DIR names another folder, and
JAX_ENABLE_COMPILATION_CACHE=false does without.
"""

import os
import pathlib
import platform
import subprocess
import sys

import jax

from cvn.ops import native


def prepare() -> None:
  """Applies all settings to this process, which may start again; call it first of all."""
  keep_memory()
  if jax.config.jax_compilation_cache_dir is None:
    keep_programs(_cache() / 'jax')


def keep_memory() -> None:
  """Starts this program again with large blocks kept, where that is possible and not yet so."""
  off = os.environ.get('CVN_KERNELS') == 'off' or 'LD_PRELOAD' in os.environ
  if off or sys.platform != 'linux' or libc() != 'glibc':
    return
  try:
    library = native.build(source=native.BLOCKS)
  except (OSError, subprocess.SubprocessError):
    return  # the kernels have the same trouble, and tell
  os.environ['LD_PRELOAD'] = str(library)
  os.environ.setdefault('GLIBC_TUNABLES', 'glibc.malloc.hugetlb=1')  # for the smaller ones
  sys.stdout.flush()
  os.execv(sys.executable, [sys.executable, *sys.orig_argv[1:]])


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
