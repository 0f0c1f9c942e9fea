"""The kernels for aarch64, built by a cross-compiler, pass their tests under qemu-user.

Needs Debian's or Ubuntu's g++-aarch64-linux-gnu and qemu-user; the rest is downloaded once, by
aarch64.sh, into .pytest_cache/aarch64 (about 800 MB).
"""

import os
import pathlib
import platform
import shutil
import subprocess
import sys

import pytest

TESTS = pathlib.Path(__file__).parent
FOLDER = TESTS.parent / '.pytest_cache' / 'aarch64'
COMPILER = 'aarch64-linux-gnu-g++'
TOOLS = (COMPILER, 'qemu-aarch64', 'apt-get', 'dpkg')
MISSING = [tool for tool in TOOLS if not shutil.which(tool)]
# Uses the kernels for aarch64 as they are, without a trial of their speed: that would be qemu's.
RUN = """
import sys, pytest
from cvn.ops import native
library = native.load(native.build(target='aarch64'))
assert library.instruction_set.startswith('NEON')
native._choose = lambda: (library, '')
sys.exit(pytest.main(sys.argv[1:]))
"""

pytestmark = [
  pytest.mark.slow,
  pytest.mark.skipif(platform.machine() == 'aarch64', reason='the other tests are run on aarch64'),
  pytest.mark.skipif(bool(MISSING), reason=f'not installed: {", ".join(MISSING)}'),
]


@pytest.fixture(scope='module')
def python():
  """A Python for aarch64 with JAX."""
  path = FOLDER / 'python'
  if not path.exists():
    command = [TESTS / 'aarch64.sh', FOLDER, sys.executable]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
  return path


@pytest.mark.parametrize(
  'name', ['test_instruction_sets', 'test_conv2d', 'test_deconv', 'test_normalization']
)
def test_kernels(python, name):
  environment = os.environ | {
    'CXX': COMPILER,
    'PYTHONPATH': str(TESTS.parent),
    'XDG_CACHE_HOME': str(FOLDER / 'cache'),
    'JAX_COMPILATION_CACHE_DIR': str(FOLDER / 'cache' / 'jax'),  # that of x86-64 is no use here
  }
  environment['JAX_DISABLE_MOST_OPTIMIZATIONS'] = 'true'  # XLA's compiler is what is slow here
  command = [python, '-c', RUN, '-q', '-p', 'no:cacheprovider', TESTS / f'{name}.py']
  done = subprocess.run(
    command, cwd=TESTS.parent, env=environment, capture_output=True, text=True, timeout=3600
  )
  assert done.returncode == 0, done.stdout[-5000:] + done.stderr[-5000:]
  assert ' passed' in done.stdout.splitlines()[-1] and ' skipped' not in done.stdout
