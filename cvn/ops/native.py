"""The compiled kernels of kernels/: built once with the machine's C++ compiler, and kept.

They are optional: without a compiler, deconv.py takes matrix products instead, which are several
times slower, and one line says so. CVN_KERNELS=off does the same without a word, and
CXX names another compiler. The library is kept in $XDG_CACHE_HOME/cvn (~/.cache/cvn), under a name
that tells of the source, the compiler, the processor and the version of jaxlib.
"""

import ctypes
import functools
import hashlib
import os
import pathlib
import platform
import shutil
import subprocess
import tempfile

import jax
import jaxlib
from absl import logging

SOURCE = pathlib.Path(__file__).with_name('kernels') / 'kernels.cc'
BLOCKS = pathlib.Path(__file__).parent.with_name('blocks.cc')  # of cvn/environment.py
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
_COMPILERS = ('c++', 'g++', 'clang++')
_FLAGS = ('-std=c++17', '-O3', '-shared', '-fPIC', '-Wno-psabi')


def available() -> bool:
  """Whether `jax.ffi.ffi_call` finds the kernels; the first call builds them where it must."""
  return not missing()


def wins(operation: str, *, mixed: bool) -> bool:
  """Whether the kernels are available and faster than plain operations.

  Args:
    operation: 'deconv', 'conv', 'conv2d' or 'activated'.
    mixed: whether factors of products are bfloat16.
  """
  del operation, mixed
  return available()


def target(name: str) -> str:
  """The FFI target of a kernel of `KERNELS`."""
  return name


@functools.cache
def missing() -> str:
  """Why there are no kernels; nothing if there are."""
  if os.environ.get('CVN_KERNELS', '') == 'off':
    return 'CVN_KERNELS=off'
  try:
    library = ctypes.CDLL(str(build()))
    for name in KERNELS:
      capsule = jax.ffi.pycapsule(getattr(library, name))
      jax.ffi.register_ffi_target(name, capsule, platform='cpu')
  except (OSError, AttributeError, subprocess.SubprocessError) as e:
    logging.warning(
      'cvn: no compiled kernels, so that a CPU trains several times slower (%s)', _reason(e)
    )
    return _reason(e)
  return ''


def build(folder: pathlib.Path | None = None, source: pathlib.Path = SOURCE) -> pathlib.Path:
  """The path of the library; it is compiled where it is not there yet.

  Args:
    folder: where it is kept; None for the user's cache.
    source: what to compile; it may include headers beside it.

  Raises:
    OSError: there is no compiler, or the folder cannot be written.
    subprocess.SubprocessError: it does not compile.
  """
  compiler = _compiler()
  folder = folder or _cache()
  version = subprocess.run([compiler, '--version'], capture_output=True, check=True, timeout=60)
  headers = sorted(source.parent.glob('*.h'))
  told = [f.read_bytes() for f in (source, *headers)]
  told += [version.stdout, _processor().encode(), jaxlib.__version__.encode()]
  path = folder / f'{source.stem}-{hashlib.sha256(b"|".join(told)).hexdigest()[:16]}.so'
  if path.exists():
    return path
  folder.mkdir(parents=True, exist_ok=True)
  handle, temporary = tempfile.mkstemp(suffix='.so', dir=folder)
  os.close(handle)
  try:
    command = [compiler, *_FLAGS, '-isystem', jax.ffi.include_dir(), str(source), '-o', temporary]
    try:
      _compile([*command, '-march=native'])
    except subprocess.CalledProcessError:  # the compiler does not know this processor
      _compile(command)
    os.replace(temporary, path)
  finally:
    pathlib.Path(temporary).unlink(missing_ok=True)
  return path


def _compile(command):
  subprocess.run(command, capture_output=True, check=True, timeout=600)


def _compiler() -> str:
  wanted = [os.environ['CXX']] if os.environ.get('CXX') else _COMPILERS
  found = next((path for path in map(shutil.which, wanted) if path), None)
  if found is None:
    raise FileNotFoundError(f'no C++ compiler: {" or ".join(wanted)}')
  return found


def _cache() -> pathlib.Path:
  home = os.environ.get('XDG_CACHE_HOME') or os.path.expanduser('~/.cache')
  return pathlib.Path(home) / 'cvn'


def _processor() -> str:
  """What -march=native depends on."""
  try:
    with open('/proc/cpuinfo') as f:
      lines = {line for line in f if line.startswith(('model name', 'flags', 'Features'))}
  except OSError:
    lines = {platform.processor()}
  return ''.join(sorted(lines)) + platform.machine()


def _reason(e: BaseException) -> str:
  """One line about what went wrong."""
  told = getattr(e, 'stderr', None)
  text = told.decode(errors='replace').strip() if told else str(e)
  return next((line for line in text.splitlines() if 'error' in line), text.split('\n')[0])
