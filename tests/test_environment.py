"""Process settings: what they do is seen from outside, in a process of its own."""

import os
import resource
import subprocess
import sys

import jax
import pytest

from cvn import environment

# Page faults of touching 64 MiB that were freed just before, in this thread and in another one.
FAULTS = """
import resource, threading
from cvn import environment
environment.prepare()

def faults():
  for _ in range(3):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    b'x' * (1 << 26)
  print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)

faults()
thread = threading.Thread(target=faults)
thread.start()
thread.join()
"""
PAGES = (1 << 26) // resource.getpagesize()


def run(code, **variables):
  """What a program prints."""
  ours = ('LD_PRELOAD', 'GLIBC_', 'MALLOC_')
  inherited = {k: v for k, v in os.environ.items() if not k.startswith(ours)}
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


@pytest.mark.skipif(environment.libc() != 'glibc', reason='only the GNU C library is set')
def test_freed_memory_is_used_again_without_page_faults():
  kept = [int(n) for n in run(FAULTS).split()]
  assert len(kept) == 2 and max(kept) < PAGES / 100
  given_back = [int(n) for n in run(FAULTS, GLIBC_TUNABLES='glibc.malloc.hugetlb=0').split()]
  assert min(given_back) > PAGES / 2


def test_the_users_own_settings_and_another_c_library_are_left_alone(monkeypatch):
  for name in [v for v in os.environ if v.startswith(('LD_PRELOAD', 'GLIBC_', 'MALLOC_'))]:
    monkeypatch.delenv(name)
  monkeypatch.setattr(environment.ctypes, 'CDLL', lambda _: pytest.fail('settings changed'))
  with monkeypatch.context() as m:
    m.setattr(environment, 'libc', lambda: '')
    assert not environment.keep_memory()
  for name in ('LD_PRELOAD', 'GLIBC_TUNABLES', 'MALLOC_ARENA_MAX'):
    with monkeypatch.context() as m:
      m.setenv(name, '')
      assert not environment.keep_memory()


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


@pytest.mark.parametrize('platform', ['cuda', 'nonsense'])
def test_a_platform_without_a_device_is_one_line(platform):
  command = [sys.executable, '-m', 'experiments.evaluate', '--data=/nowhere', '--shape=/nowhere']
  environ = {**os.environ, 'JAX_PLATFORMS': platform, 'CUDA_VISIBLE_DEVICES': ''}
  done = subprocess.run(command, env=environ, capture_output=True, text=True)
  if 'manifest.json' in done.stderr:
    pytest.skip(f'this machine has a {platform} device')
  assert done.returncode == 1 and done.stdout == ''
  assert (
    done.stderr.startswith(f'error: JAX_PLATFORMS={platform} ') and done.stderr.count('\n') == 1
  )
