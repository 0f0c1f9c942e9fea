"""The build backend: setuptools, with compiled kernels in the wheels for Linux.

A wheel carries a library for each instruction set of its machine (cvn/ops/compile.py) in
cvn/ops/shipped/, so that it needs no compiler where it is installed. $CXX names the compiler, and
the wheel is for the machine that the compiler compiles for: CXX=aarch64-linux-gnu-g++ makes one for
aarch64. Without a compiler, or on another system, the wheel is for any machine, and the kernels are
compiled on first use. Editable installs and sdists compile nothing.
"""

import base64
import csv
import hashlib
import importlib.util
import io
import os
import pathlib
import platform
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

from setuptools import build_meta
from setuptools.build_meta import *  # noqa: F403

# A library works with the version of XLA's interface that its headers have and with later ones.
# These are the headers of the oldest jaxlib that the project supports.
HEADERS = 'jaxlib==0.10.0; python_version < "3.15"'
INTERFACE = (0, 3)
SOURCE = pathlib.Path('cvn', 'ops', 'kernels', 'kernels.cc')
SHIPPED = 'cvn/ops/shipped'
# The C++ library is linked statically: other machines may have older ones than the compiler's.
# Only what is used of it is kept; the rest would need a later glibc.
OPTIONS = ('-O3', '-static-libstdc++', '-Wl,--exclude-libs,ALL', '-Wl,--gc-sections', '-s')


def get_requires_for_build_wheel(config_settings=None) -> list[str]:
  """What has to be installed to build a wheel (PEP 517)."""
  return [*build_meta.get_requires_for_build_wheel(config_settings), HEADERS]


def get_requires_for_build_editable(config_settings=None) -> list[str]:
  """What has to be installed for an editable install (PEP 660)."""
  return build_meta.get_requires_for_build_editable(config_settings)


def build_wheel(wheel_directory, config_settings=None, metadata_directory=None) -> str:
  """Writes a wheel and returns its name (PEP 517)."""
  with tempfile.TemporaryDirectory() as folder:
    # Nothing of an earlier build may get into this one.
    settings = {**(config_settings or {}), '--global-option': ['build', f'--build-base={folder}']}
    pure = pathlib.Path(folder, build_meta.build_wheel(folder, settings, metadata_directory))
    machine, libraries = compile_kernels(pathlib.Path(folder, 'shipped'))
    if not libraries:
      shutil.copy(pure, wheel_directory)
      return pure.name
    tag = f'manylinux_2_{glibc_minor(libraries)}_{machine}'
    wheel = pathlib.Path(wheel_directory, pure.name.replace('none-any', f'none-{tag}'))
    add_libraries(pure, wheel, libraries, tag=tag)
  return wheel.name


def compile_kernels(folder: pathlib.Path) -> tuple[str, list[pathlib.Path]]:
  """Compiles the kernels for each instruction set of the machine that the compiler compiles for.

  One line says what could not be compiled, and why.

  Args:
    folder: where the libraries go.

  Returns:
    The machine's name and the libraries.
  """
  compiling = _compiling()
  failures = (OSError, subprocess.SubprocessError)
  try:
    compiler = compiling.find_compiler()
    machine = target_machine(compiler)
    include = [find_headers()]
  except failures as e:
    _warn('the wheel carries no kernels', compiling.reason(e))
    return platform.machine(), []

  def compile_one(target):
    output = folder / f'kernels-{target}.so'
    try:
      compiling.compile_library(
        SOURCE, output, target=target, compiler=compiler, include=include, options=OPTIONS
      )
    except failures as e:
      _warn(f'the wheel carries no kernels for {target}', compiling.reason(e))
      return None
    return output

  targets = [t for t in compiling.TARGETS if (t == 'aarch64') == (machine == 'aarch64')]
  with ThreadPoolExecutor(os.cpu_count()) as threads:
    return machine, list(filter(None, threads.map(compile_one, targets)))


def target_machine(compiler: str) -> str:
  """The machine that a compiler compiles for: 'x86_64' or 'aarch64'.

  Raises:
    OSError: it is another one, or not Linux with the GNU C library.
    subprocess.SubprocessError: the compiler does not work.
  """
  command = [*shlex.split(compiler), '-dumpmachine']
  done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
  machine, *system = done.stdout.strip().split('-')
  if machine not in ('x86_64', 'aarch64') or system[-2:] != ['linux', 'gnu']:
    raise OSError(f'{compiler} compiles for {done.stdout.strip()}')
  return machine


def find_headers() -> pathlib.Path:
  """The folder of the headers of XLA's interface that jaxlib brings.

  Raises:
    OSError: there are none, or they are of a later version than the project supports.
  """
  spec = importlib.util.find_spec('jaxlib')
  if spec is None:
    raise FileNotFoundError(f'the headers of {HEADERS} are missing')
  folder = pathlib.Path(spec.submodule_search_locations[0], 'include')
  text = (folder / 'xla/ffi/api/c_api.h').read_text()
  parts = re.findall(r'#define XLA_FFI_API_(?:MAJOR|MINOR) (\d+)', text)
  if tuple(map(int, parts)) > INTERFACE:
    raise OSError(f'headers of a later jaxlib are installed than {HEADERS}')
  return folder


def glibc_minor(libraries: Sequence[pathlib.Path]) -> int:
  """The N of the oldest glibc, 2.N, that these libraries run with; at least 17.

  Wheels for Linux name no older one: pip has no name for it that both machines have.
  """
  found = (re.findall(rb'\0GLIBC_2\.(\d+)', library.read_bytes()) for library in libraries)
  return max(17, *(int(minor) for minors in found for minor in minors))


def add_libraries(
  old: pathlib.Path, new: pathlib.Path, libraries: Sequence[pathlib.Path], *, tag: str
) -> None:
  """Writes a wheel for one platform: a wheel for any, and libraries.

  Args:
    old: the wheel for any platform.
    new: the wheel to write.
    libraries: what goes into cvn/ops/shipped/.
    tag: the platform's.
  """
  with zipfile.ZipFile(old) as f:
    entries = [(info, f.read(info)) for info in f.infolist()]
  for library in libraries:
    info = zipfile.ZipInfo(f'{SHIPPED}/{library.name}')
    info.external_attr = 0o100755 << 16
    info.compress_type = zipfile.ZIP_DEFLATED
    entries.insert(0, (info, library.read_bytes()))
  rows = []
  with zipfile.ZipFile(new, 'w') as f:
    for info, data in entries:
      if info.filename.endswith('.dist-info/RECORD'):
        rows.append((info.filename, '', ''))
        text = io.StringIO()
        csv.writer(text, lineterminator='\n').writerows(rows)
        data = text.getvalue().encode()
      elif info.filename.endswith('.dist-info/WHEEL'):
        data = data.replace(b'none-any', b'none-' + tag.encode())
        data = data.replace(b'Purelib: true', b'Purelib: false')
      digest = base64.urlsafe_b64encode(hashlib.sha256(data).digest()).rstrip(b'=').decode()
      rows.append((info.filename, f'sha256={digest}', len(data)))
      f.writestr(info, data)


def _compiling():
  """The module cvn/ops/compile.py; the package around it would import JAX."""
  spec = importlib.util.spec_from_file_location('compile', SOURCE.parent.with_name('compile.py'))
  module = importlib.util.module_from_spec(spec)
  spec.loader.exec_module(module)
  return module


def _warn(what, reason):
  print(f'cvn: {what}, which are compiled on first use instead ({reason})', file=sys.stderr)
