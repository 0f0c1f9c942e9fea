"""Process settings: what they do is seen from outside, in a process of its own."""

import os
import resource
import subprocess
import sys

import jax
import pytest

from cvn import environment
from cvn.ops import native

# Page faults of touching 64 MiB that were freed just before.
FAULTS = """
import resource
from cvn import environment
environment.prepare()
for _ in range(3):
  before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
  b'x' * (1 << 26)
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""
PAGES = (1 << 26) // resource.getpagesize()


def run(code, **variables):
  """What a program prints."""
  inherited = {k: v for k, v in os.environ.items() if k != 'LD_PRELOAD'}
  done = subprocess.run(
    [sys.executable, '-c', code],
    env={**inherited, **variables},
    capture_output=True,
    text=True,
    check=True,
  )
  return done.stdout.strip()


@pytest.fixture
def cache_folder():
  """JAX's setting, put back as it was."""
  before = jax.config.jax_compilation_cache_dir
  yield before
  jax.config.update('jax_compilation_cache_dir', before)


@pytest.mark.skipif(
  environment.libc() != 'glibc' or not native.available(), reason='needs GNU C library and compiler'
)
def test_freed_memory_is_used_again_without_page_faults():
  assert int(run(FAULTS)) < PAGES / 100
  assert int(run(FAULTS, LD_PRELOAD='', GLIBC_TUNABLES='glibc.malloc.hugetlb=0')) > PAGES / 2


def test_a_program_starts_again_once_and_keeps_its_arguments_and_status(tmp_path):
  program = tmp_path / 'program.py'
  program.write_text(
    'import os, sys\n'
    'from cvn import environment\n'
    'print("start", flush=True)\n'
    'environment.prepare()\n'
    'print(sys.argv[1:], "LD_PRELOAD" in os.environ)\n'
    'raise SystemExit(3)\n'
  )
  inherited = {k: v for k, v in os.environ.items() if k != 'LD_PRELOAD'}
  done = subprocess.run(
    [sys.executable, str(program), '--name=a b', 'é'],
    env=inherited, capture_output=True, text=True,
  )  # fmt: skip
  again = native.available() and sys.platform == 'linux' and environment.libc() == 'glibc'
  lines = ['start'] * (1 + again) + [f"['--name=a b', 'é'] {again}"]
  assert (done.returncode, done.stdout.splitlines()) == (3, lines), done.stderr


def test_another_c_library_is_left_alone(monkeypatch):
  monkeypatch.delenv('LD_PRELOAD', raising=False)
  monkeypatch.setattr(environment, 'libc', lambda: '')
  monkeypatch.setattr(os, 'execv', lambda *_: pytest.fail('started again'))
  environment.keep_memory()


def test_folder_is_made_and_an_unwritable_one_left_out(tmp_path, cache_folder):
  assert environment.keep_programs(tmp_path / 'a' / 'b')
  assert jax.config.jax_compilation_cache_dir == str(tmp_path / 'a' / 'b')
  jax.config.update('jax_compilation_cache_dir', cache_folder)
  (tmp_path / 'file').write_text('')
  assert not environment.keep_programs(tmp_path / 'file')
  assert jax.config.jax_compilation_cache_dir == cache_folder


def test_default_folder_follows_the_users_setting(tmp_path, monkeypatch, cache_folder):
  monkeypatch.setenv('LD_PRELOAD', '')
  monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path))
  jax.config.update('jax_compilation_cache_dir', None)
  environment.prepare()
  assert jax.config.jax_compilation_cache_dir == str(tmp_path / 'cvn' / 'jax')
  jax.config.update('jax_compilation_cache_dir', 'chosen')
  environment.prepare()
  assert jax.config.jax_compilation_cache_dir == 'chosen'
