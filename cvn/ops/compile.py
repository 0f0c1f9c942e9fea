"""Compiling a C++ library for an instruction set, and which sets this processor has.

This module needs the standard library alone: it also runs where a wheel is built, without JAX.
"""

import contextlib
import hashlib
import os
import pathlib
import platform
import shlex
import shutil
import subprocess
import tempfile
from collections.abc import Iterable, Sequence

# Instruction sets that wheels carry kernels for, and the compiler's flags. That of Sapphire Rapids
# names only what the kernels use, so that newer processors and virtual machines have it too.
_V4 = '-march=x86-64-v4'
_BF16 = ('-mavx512bf16', '-mavx512vnni')
TARGETS: dict[str, tuple[str, ...]] = {
  'x86-64-v3': ('-march=x86-64-v3',),
  'x86-64-v4': (_V4,),
  'x86-64-v4-bf16': (_V4, *_BF16, '-DCVN_LANES=8'),  # chiefly Zen 4, see kernels/simd.h
  'sapphirerapids': (_V4, *_BF16, '-mamx-tile', '-mamx-bf16', '-mtune=sapphirerapids'),
  'aarch64': ('-march=armv8-a',),
}
NATIVE = 'native'  # the target of the processor that compiles

# What /proc/cpuinfo calls the instructions of a target, the best target last.
_V3_FEATURES = 'sse4_1 sse4_2 ssse3 popcnt cx16 avx avx2 bmi1 bmi2 f16c fma abm movbe xsave'
_V4_FEATURES = f'{_V3_FEATURES} avx512f avx512bw avx512cd avx512dq avx512vl'
_BF16_FEATURES = f'{_V4_FEATURES} avx512_bf16 avx512_vnni'
_X86_FEATURES = {
  'x86-64-v3': _V3_FEATURES,
  'x86-64-v4': _V4_FEATURES,
  'x86-64-v4-bf16': _BF16_FEATURES,
  'sapphirerapids': f'{_BF16_FEATURES} amx_tile amx_bf16',
}
_MACHINES = {'amd64': 'x86_64', 'arm64': 'aarch64'}  # other names of the same machine

_COMPILERS = ('c++', 'g++', 'clang++')
_FLAGS = ('-std=c++17', '-shared', '-fPIC', '-Wno-psabi')
_TIMEOUT = 600  # s


def target_flags(target: str) -> tuple[str, ...]:
  """The compiler's flags for a target: a key of `TARGETS`, `NATIVE` or another value of -march."""
  return TARGETS.get(target, (f'-march={target}',))


def usable_targets(
  *, machine: str | None = None, features: Iterable[str] | None = None
) -> list[str]:
  """The keys of `TARGETS` that a processor can run, the best first.

  Args:
    machine: 'x86_64' or 'aarch64'; None for this one.
    features: names of its instructions, as /proc/cpuinfo has them; None for this processor's.
  """
  machine = (machine or platform.machine()).lower()
  if _MACHINES.get(machine, machine) == 'aarch64':
    return ['aarch64']
  if _MACHINES.get(machine, machine) != 'x86_64':
    return []
  has = set(cpu_features() if features is None else features)
  found = [name for name, needed in _X86_FEATURES.items() if has.issuperset(needed.split())]
  return found[::-1]


def cpu_features() -> set[str]:
  """Names of this processor's instructions; empty where the system does not list them."""
  listed = (line for line in _cpu_lines() if line.startswith(('flags', 'Features')))
  return set(next(listed, ':').split(':', 1)[1].split())


def describe_processor() -> str:
  """Everything that compiling for `NATIVE` depends on."""
  names = ('model name', 'flags', 'Features', 'CPU implementer', 'CPU part')
  lines = {line for line in _cpu_lines() if line.startswith(names)}
  return ''.join(sorted(lines or {platform.processor()})) + platform.machine()


def processor_name() -> str:
  """The processor's name for people, as far as the system tells it."""
  names = (line.split(':', 1)[1].strip() for line in _cpu_lines() if line.startswith('model name'))
  return next(names, '') or platform.processor() or platform.machine()


def find_compiler() -> str:
  """The command of the C++ compiler: $CXX, or the first that is installed.

  Raises:
    FileNotFoundError: there is none.
  """
  wanted, found = os.environ.get('CXX', '').strip(), None
  if not wanted:
    found = next(filter(shutil.which, _COMPILERS), None)
  elif shutil.which(wanted):
    found = shlex.quote(wanted)  # one name, even if it has spaces
  else:
    with contextlib.suppress(ValueError):  # quotes without an end
      found = wanted if shutil.which(shlex.split(wanted)[0]) else None
  if found is None:
    raise FileNotFoundError(f'no C++ compiler: {wanted or " or ".join(_COMPILERS)}')
  return found


def compile_library(
  source: pathlib.Path,
  output: pathlib.Path,
  *,
  target: str = NATIVE,
  compiler: str | None = None,
  include: Sequence[str | os.PathLike] = (),
  options: Sequence[str] = ('-O3',),
) -> None:
  """Compiles a shared library, which appears under its name once it is whole.

  Args:
    source: a C++ file; it may include headers beside it.
    output: the library.
    target: the instruction set: a key of `TARGETS`, `NATIVE` or another value of -march. A compiler
      that does not know the processor of `NATIVE` takes its default.
    compiler: the command; None for that of `find_compiler`.
    include: folders of other headers.
    options: more of the compiler's flags.

  Raises:
    OSError: there is no compiler, the folder cannot be written, or no library came out.
    subprocess.SubprocessError: the source does not compile, or not in ten minutes.
  """
  command = [*shlex.split(compiler or find_compiler()), *_FLAGS, *options]
  for folder in include:
    command += ['-isystem', str(folder)]
  output.parent.mkdir(parents=True, exist_ok=True)
  handle, temporary = tempfile.mkstemp(prefix='.', suffix='.so', dir=output.parent)
  os.close(handle)
  try:
    command += [str(source), '-o', temporary]
    try:
      _run([*command, *target_flags(target)])
    except subprocess.CalledProcessError:
      if target != NATIVE:
        raise
      _run(command)
    if not os.path.getsize(temporary):
      raise OSError(f'{command[0]} wrote no library')
    os.chmod(temporary, 0o755)
    os.replace(temporary, output)
  finally:
    pathlib.Path(temporary).unlink(missing_ok=True)


def reason(e: BaseException) -> str:
  """One line about what went wrong."""
  if isinstance(e, subprocess.TimeoutExpired):
    return f'{e.cmd[0]} did not end in {e.timeout:g} s'
  told = getattr(e, 'stderr', None)
  text = (told.decode(errors='replace') if told else str(e)).strip() or type(e).__name__
  return next((line for line in text.splitlines() if 'error' in line), text.split('\n')[0])


def digest(*parts: bytes) -> str:
  """16 characters that tell these parts from others."""
  return hashlib.sha256(b'|'.join(parts)).hexdigest()[:16]


def _run(command):
  subprocess.run(command, capture_output=True, check=True, timeout=_TIMEOUT)


def _cpu_lines():
  try:
    with open('/proc/cpuinfo') as f:
      return f.readlines()
  except OSError:
    return []
