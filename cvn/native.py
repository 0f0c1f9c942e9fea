"""The compiled kernels of kernels/: built once with the machine's C++ compiler, and kept.

Nothing needs them: where there is no compiler, cvn/deconv.py takes matrix products instead, which
are several times slower, and one line says so. CVN_KERNELS=off does the same without a word, and
CXX names another compiler. The library is kept in $XDG_CACHE_HOME/cvn (~/.cache/cvn), under a name
that tells of the source, the compiler, the processor and the version of jaxlib.
"""

import ctypes
import functools
import hashlib
import itertools
import os
import pathlib
import platform
import shutil
import subprocess
import tempfile
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import jaxlib
from absl import logging
from jax.experimental.custom_partitioning import custom_partitioning
from jax.sharding import NamedSharding, PartitionSpec

SOURCE = pathlib.Path(__file__).with_name('kernels') / 'kernels.cc'
BLOCKS = pathlib.Path(__file__).with_name('blocks.cc')  # of cvn/environment.py
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


@functools.cache
def available() -> bool:
  """Whether `jax.ffi.ffi_call` finds the kernels; the first call builds them where it must."""
  if os.environ.get('CVN_KERNELS', '') == 'off':
    return False
  try:
    library = ctypes.CDLL(str(build()))
    for name in KERNELS:
      capsule = jax.ffi.pycapsule(getattr(library, name))
      jax.ffi.register_ffi_target(name, capsule, platform='cpu')
  except (OSError, AttributeError, subprocess.SubprocessError) as e:
    logging.warning(
      'cvn: no compiled kernels, so that a CPU trains several times slower (%s)', _reason(e)
    )
    return False
  return True


def call(
  name: str,
  results: Sequence[jax.ShapeDtypeStruct],
  *arrays: jax.Array,
  volumes: Sequence[int] = (0,),
  in_place: int | None = None,
  **attributes,
) -> Sequence[jax.Array]:
  """Calls a kernel; it is there on a CPU, where `available`.

  Where a batch is spread over devices, each calls it for its own samples.

  Args:
    name: one of `KERNELS`.
    results: their shapes and types; the first axis is the batch's.
    *arrays: what it takes.
    volumes: which of them have the batch as first axis, the first among them; all devices need the
      others whole.
    in_place: which of them the first result may overwrite, where nothing else needs it.
    **attributes: numpy integers.
  """

  aliases = {} if in_place is None else {in_place: 0}

  def run(*arrays):
    local = [jax.ShapeDtypeStruct((len(arrays[0]), *r.shape[1:]), r.dtype) for r in results]
    return tuple(jax.ffi.ffi_call(name, local, input_output_aliases=aliases)(*arrays, **attributes))

  if jax.device_count() == 1:  # the partitioner's callbacks would miss the compilation cache
    return run(*arrays)

  def partition(mesh, arguments, _):
    spec = arguments[0].sharding.spec
    batch = NamedSharding(mesh, PartitionSpec(spec[0] if len(spec) else None))
    whole = NamedSharding(mesh, PartitionSpec())
    shardings = [batch if i in volumes else whole for i in range(len(arrays))]
    return mesh, run, (batch,) * len(results), tuple(shardings)

  spread = custom_partitioning(run)
  spread.def_partition(partition, sharding_rule=_rule(arrays, results, volumes))
  return spread(*arrays)


def sum_samples(x: jax.Array) -> jax.Array:
  """x.sum(0), as a product: the compiler's own sum over the first axis is slow."""
  return (jnp.ones((1, len(x))) @ x.reshape(len(x), -1)).reshape(x.shape[1:])


def _rule(arrays, results, volumes) -> str:
  """How axes of arguments and results go together, for the partitioner: only the batch's do."""
  names = itertools.count()

  def axes(array, has_batch):
    found = [f'a{next(names)}' for _ in array.shape]
    return ' '.join((['batch', *found[1:]] if has_batch else found) or [''])

  left = ', '.join(axes(a, i in volumes) for i, a in enumerate(arrays))
  return f'{left} -> {", ".join(axes(r, True) for r in results)}'


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
