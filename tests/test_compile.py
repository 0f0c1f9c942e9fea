"""Compiling libraries, and which instruction sets a processor has."""

import ctypes
import os
import platform
import subprocess
import sys

import pytest

from cvn.ops import compile as compiling
from cvn.ops import native

V3 = 'sse4_1 sse4_2 ssse3 popcnt cx16 avx avx2 bmi1 bmi2 f16c fma abm movbe xsave'
V4 = f'{V3} avx512f avx512bw avx512cd avx512dq avx512vl'
BF16 = f'{V4} avx512_bf16 avx512_vnni'
AMX = f'{BF16} amx_tile amx_bf16 amx_int8'
NAMES = ['sapphirerapids', 'x86-64-v4-bf16', 'x86-64-v4', 'x86-64-v3']
HAS_COMPILER = native.available()


@pytest.mark.parametrize(
  ('machine', 'features', 'expected'),
  [
    ('x86_64', 'sse sse2', []),
    ('x86_64', V3.replace('fma', ''), []),
    ('x86_64', V3, NAMES[3:]),
    ('AMD64', V4, NAMES[2:]),
    ('x86_64', BF16, NAMES[1:]),
    ('x86_64', AMX, NAMES),
    ('x86_64', f'{V3} amx_tile amx_bf16', NAMES[3:]),
    ('aarch64', 'fp asimd', ['aarch64']),
    ('arm64', '', ['aarch64']),
    ('riscv64', V3, []),
  ],
)
def test_targets_follow_the_features(machine, features, expected):
  assert compiling.usable_targets(machine=machine, features=features.split()) == expected


def test_this_processor_has_the_features_that_the_system_lists():
  assert compiling.usable_targets() == compiling.usable_targets(features=compiling.cpu_features())
  assert set(compiling.usable_targets()) < {*compiling.TARGETS}
  assert '\n' in compiling.describe_processor() or sys.platform != 'linux'


def test_another_target_is_the_compilers_own_name():
  assert compiling.target_flags('haswell') == ('-march=haswell',)
  assert compiling.target_flags('x86-64-v4-bf16')[0] == '-march=x86-64-v4'


def test_it_needs_the_standard_library_alone(tmp_path):
  """A wheel is built where JAX may be missing."""
  code = f"""
import importlib.util
spec = importlib.util.spec_from_file_location('compiling', {compiling.__file__!r})
module = importlib.util.module_from_spec(spec)
spec.loader.exec_module(module)
print(*module.TARGETS)
"""
  command = [sys.executable, '-I', '-S', '-c', code]
  done = subprocess.run(command, capture_output=True, text=True, check=True)
  assert done.stdout.split() == [*compiling.TARGETS]


@pytest.fixture
def source(tmp_path):
  path = tmp_path / 'source' / 'three.cc'
  path.parent.mkdir()
  path.write_text('extern "C" int three() { return 3; }\n')
  return path


@pytest.mark.skipif(not HAS_COMPILER, reason='no C++ compiler here')
def test_a_library_is_compiled_and_nothing_else_is_left(tmp_path, source):
  output = tmp_path / 'made' / 'three.so'
  compiling.compile_library(source, output, include=[tmp_path])
  assert ctypes.CDLL(str(output)).three() == 3
  assert os.listdir(output.parent) == ['three.so']


@pytest.mark.skipif(not HAS_COMPILER, reason='no C++ compiler here')
@pytest.mark.parametrize('target', ['native', 'no-such-processor'])
def test_what_does_not_compile_leaves_nothing(tmp_path, source, target):
  if target == 'native':
    source.write_text('this is no C++')
  with pytest.raises(subprocess.CalledProcessError) as caught:
    compiling.compile_library(source, tmp_path / 'made' / 'three.so', target=target)
  assert 'error' in compiling.reason(caught.value) and '\n' not in compiling.reason(caught.value)
  assert not os.listdir(tmp_path / 'made')


def write_compiler(path, script):
  """A command that is called as a compiler is; OUT in the script is its output file."""
  path.write_text(
    f'#!/bin/sh\nfor last; do [ "$before" = -o ] && OUT="$last"; before="$last"; done\n{script}'
  )
  path.chmod(0o755)
  return str(path)


def test_a_compiler_that_does_not_know_its_processor_takes_its_default(tmp_path, source):
  script = 'case "$*" in *native*) exit 1;; esac\necho "$@" > "$OUT"\n'
  compiler = write_compiler(tmp_path / 'cc', script)
  compiling.compile_library(source, tmp_path / 'three.so', compiler=compiler)
  assert '-march' not in (tmp_path / 'three.so').read_text()
  options = {'compiler': compiler, 'options': ('-O1',), 'include': ['a', 'b']}
  compiling.compile_library(source, tmp_path / 'three.so', target='haswell', **options)
  told = (tmp_path / 'three.so').read_text()
  assert '-O1 -isystem a -isystem b' in told and told.split()[-1] == '-march=haswell'


@pytest.mark.parametrize(
  ('script', 'error'),
  [('true\n', 'wrote no library'), ('echo "error: broken" >&2\nexit 3\n', 'broken')],
)
def test_a_compiler_that_fails(tmp_path, source, script, error):
  compiler = write_compiler(tmp_path / 'cc', script)
  with pytest.raises((OSError, subprocess.CalledProcessError)) as caught:
    compiling.compile_library(source, tmp_path / 'made' / 'three.so', compiler=compiler)
  assert error in compiling.reason(caught.value)
  assert not os.listdir(tmp_path / 'made')


def test_compilers_are_found(tmp_path, monkeypatch):
  folder = tmp_path / 'a folder'
  folder.mkdir()
  first, second = (write_compiler(folder / name, 'true\n') for name in ('my compiler', 'clang++'))
  monkeypatch.setenv('PATH', str(folder))
  monkeypatch.setenv('CXX', first)
  assert compiling.find_compiler() == f"'{first}'"
  monkeypatch.setenv('CXX', 'clang++ -m64')
  assert compiling.find_compiler() == 'clang++ -m64'
  monkeypatch.delenv('CXX')
  assert compiling.find_compiler() == 'clang++' and second.endswith('clang++')
  for name in ('none', "none 'of", 'none of'):
    monkeypatch.setenv('CXX', name)
    with pytest.raises(FileNotFoundError, match=f'no C.. compiler: {name}'):
      compiling.find_compiler()
  monkeypatch.delenv('CXX')
  monkeypatch.setenv('PATH', '')
  with pytest.raises(FileNotFoundError, match=r'c\+\+ or g\+\+ or clang\+\+'):
    compiling.find_compiler()


def test_a_reason_is_one_line():
  told = subprocess.CalledProcessError(1, 'cc', stderr=b'in file a:\na:1: error: no\nmore\n')
  assert compiling.reason(told) == 'a:1: error: no'
  assert (
    compiling.reason(subprocess.TimeoutExpired(['cc', 'a'], 600.0)) == 'cc did not end in 600 s'
  )
  assert compiling.reason(OSError()) == 'OSError'


def test_the_processor_has_a_name(monkeypatch):
  lines = ['processor\t: 0\n', 'model name\t: Some CPU: fast\n', 'model name\t: Another\n']
  monkeypatch.setattr(compiling, '_cpu_lines', lambda: lines)
  assert compiling.processor_name() == 'Some CPU: fast'
  monkeypatch.setattr(compiling, '_cpu_lines', list)
  assert compiling.processor_name() == (platform.processor() or platform.machine())
