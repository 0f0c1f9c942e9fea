"""The library of compiled kernels (kernels/): found or built, and registered with JAX.

It is optional. The first of these that works is taken, and each failure gives one line:

  CVN_KERNELS=off    no library; plain products serve, which are several times slower
  CVN_KERNELS=PATH   this library
  shipped            shipped/kernels-TARGET.so, if the package was installed from a wheel that has
                     one for this processor
  compiled           built on first use by the C++ compiler ($CXX, or the first that is found)
  none               plain products

A library that its trial refuses (timings.py) does not work. CVN_TARGET names the instruction set to
compile for instead of this processor's own (compile.py); shipped libraries are then passed over.
What is compiled is kept in $XDG_CACHE_HOME/cvn (~/.cache/cvn), under a name that depends on the
source, the compiler, the target and jaxlib.
"""

import atexit
import ctypes
import functools
import os
import pathlib
import shlex
import shutil
import subprocess
import tempfile
from typing import NamedTuple

import jax
import jaxlib
from absl import logging

from cvn import files
from cvn.ops import compile as compiling
from cvn.ops import timings

SOURCE = pathlib.Path(__file__).with_name('kernels') / 'kernels.cc'
SHIPPED = pathlib.Path(__file__).with_name('shipped')
KERNELS = (
  'cvn_deconv',
  'cvn_deconv_gradient',
  'cvn_conv',
  'cvn_conv_gradient',
  'cvn_activated',
  'cvn_activated_gradient',
  'cvn_conv2d',
  'cvn_conv2d_input_gradient',
  'cvn_conv2d_kernel_gradient',
)


class Library(NamedTuple):
  """Kernels that are loaded and registered with JAX."""

  path: pathlib.Path
  origin: str  # 'named', 'shipped' or 'compiled'
  instruction_set: str  # what it was compiled for, as it says itself
  timings: timings.Timings  # on this processor
  suffix: str  # of the names that its kernels are registered under


def library() -> Library | None:
  """This process's library, None if there is none; the first call builds it if it must."""
  return _choose()[0]


def available() -> bool:
  """Whether this process has compiled kernels."""
  return library() is not None


def missing() -> str:
  """Why this process has no compiled kernels; nothing if it has some."""
  return _choose()[1]


def wins(library: Library, operation: str, *, mixed: bool) -> bool:
  """Whether a kernel is at least as fast as the plain product on this processor.

  Args:
    library: whose kernel it is; one whose timings are empty wins everywhere.
    operation: 'deconv', 'conv', 'conv2d' or 'activated', with the gradients.
    mixed: whether volumes, or the factors of conv2d, are bfloat16.
  """
  times = library.timings.get(operation, {}).get('mixed' if mixed else 'float32')
  return times is None or timings.wins(times)


def faster_dtype() -> tuple[str, str]:
  """The faster of 'float32' and 'mixed' for the networks' volumes on this machine, and why."""
  if jax.default_backend() != 'cpu':
    return 'mixed', f'a {jax.default_backend()} multiplies bfloat16 faster'
  found = library()
  if found is None:
    return 'float32', 'there are no compiled kernels, and plain products multiply float32'
  return timings.choose_dtype(found.timings)


def load(path: pathlib.Path, *, suffix: str | None = None) -> Library:
  """Loads a library and registers its kernels with JAX, without a trial.

  Several may be loaded, each with a suffix of its own.

  Args:
    path: of the library.
    suffix: of the FFI target names; None for one that depends on the library's content.

  Raises:
    OSError: the file cannot be loaded.
    AttributeError: it lacks a function.
    RuntimeError: its kernels are for another version of XLA's interface.
  """
  loaded = ctypes.CDLL(str(path))
  functions = {name: getattr(loaded, name) for name in KERNELS}
  loaded.cvn_instruction_set.restype = ctypes.c_char_p
  instruction_set = loaded.cvn_instruction_set().decode()
  suffix = f'@{compiling.digest(path.read_bytes())}' if suffix is None else suffix
  for name, function in functions.items():
    capsule = jax.ffi.pycapsule(function)
    jax.ffi.register_ffi_target(name + suffix, capsule, platform='cpu')
  return Library(path, 'named', instruction_set, {}, suffix)


def build(
  *,
  folder: pathlib.Path | None = None,
  source: pathlib.Path = SOURCE,
  target: str = compiling.NATIVE,
  options: tuple[str, ...] = ('-O3',),
) -> pathlib.Path:
  """The path of a compiled library; compiles it if it is not there yet.

  Args:
    folder: where it is kept; None for the user's cache.
    source: what to compile; it may include headers beside it.
    target: the instruction set, as of compile.compile_library.
    options: more of the compiler's flags.

  Raises:
    OSError: there is no compiler, or the folder cannot be written.
    subprocess.SubprocessError: it does not compile.
  """
  compiler = compiling.find_compiler()
  version = subprocess.run(
    [*shlex.split(compiler), '--version'], capture_output=True, check=True, timeout=60
  )
  flags = [*compiling.target_flags(target), *options]
  if target == compiling.NATIVE:
    flags.append(compiling.describe_processor())
  told = [f.read_bytes() for f in (source, *sorted(source.parent.glob('*.h')))]
  told += [version.stdout, ' '.join(flags).encode(), jaxlib.__version__.encode()]
  path = (folder or cache_folder()) / f'{source.stem}-{compiling.digest(*told)}.so'
  with files.locked(path.with_name('build.lock')):
    if not path.exists():
      include = [jax.ffi.include_dir()]
      compiling.compile_library(
        source, path, target=target, compiler=compiler, include=include, options=options
      )
  return path


def cache_folder() -> pathlib.Path:
  """The user's folder for what this package compiles and measures."""
  home = os.environ.get('XDG_CACHE_HOME') or os.path.expanduser('~/.cache')
  return pathlib.Path(home) / 'cvn'


@functools.cache
def _choose() -> tuple[Library | None, str]:
  """The library, or why there is none."""
  if os.environ.get('CVN_KERNELS') == 'off':
    return None, 'CVN_KERNELS=off'
  why = ''
  for origin, find in (('named', _named), ('shipped', _shipped), ('compiled', _compiled)):
    try:
      path = find()
      if path is not None:
        folder = path.parent if origin == 'compiled' else cache_folder()
        times = timings.find(path, folder)
        return load(path, suffix='')._replace(origin=origin, timings=times), ''
    except (OSError, AttributeError, RuntimeError, subprocess.SubprocessError) as e:
      _tell_failure(origin, e)
      why = compiling.reason(e)
  return None, why


def _named() -> pathlib.Path | None:
  name = os.environ.get('CVN_KERNELS')
  if not name:
    return None
  path = pathlib.Path(name)
  if not path.is_file():
    raise FileNotFoundError(f"{name!r} is neither 'off' nor a file")
  return path.resolve()


def _shipped() -> pathlib.Path | None:
  if os.environ.get('CVN_TARGET'):
    return None
  paths = (SHIPPED / f'kernels-{name}.so' for name in compiling.usable_targets())
  return next(filter(pathlib.Path.exists, paths), None)


def _compiled() -> pathlib.Path:
  target = os.environ.get('CVN_TARGET') or compiling.NATIVE
  try:
    return build(target=target)
  except OSError as e:
    if _is_writable(cache_folder()):
      raise
    logging.warning(
      'cvn: kernels are compiled for this process alone (%s): set XDG_CACHE_HOME to a folder that'
      ' can be written',
      compiling.reason(e),
    )
    folder = tempfile.mkdtemp(prefix='cvn-')
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return build(folder=pathlib.Path(folder), target=target)


def _tell_failure(origin, e):
  if origin == 'compiled':
    what = 'no compiled kernels, so that a CPU trains several times slower'
  else:
    what = {'named': 'CVN_KERNELS is passed over', 'shipped': 'shipped kernels are not used'}[
      origin
    ]
  logging.warning('cvn: %s (%s)', what, compiling.reason(e))


def _is_writable(folder):
  try:
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryFile(dir=folder):
      return True
  except OSError:
    return False
