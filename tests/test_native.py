"""Finding, building and loading the kernels, doing without them, spreading them over devices."""

import os
import re
import shutil
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.sharding import AxisType, NamedSharding, PartitionSpec

from cvn import layers
from cvn.ops import compile as compiling
from cvn.ops import conv2d, deconv, native, normalization, timings
from cvn.ops.timings import Times

HAS_COMPILER = native.available()
needs_compiler = pytest.mark.skipif(not HAS_COMPILER, reason='no C++ compiler here')

CHOOSE = """
import pathlib, sys
from cvn.ops import native
native.SHIPPED = pathlib.Path(sys.argv[1])
found = native.library()
print(found and found.origin)
"""

# Nine kernels that do nothing, built for another version of XLA's interface.
OTHER_INTERFACE = """
#include "xla/ffi/api/c_api.h"
#undef XLA_FFI_API_MAJOR
#define XLA_FFI_API_MAJOR 99
#include "xla/ffi/api/ffi.h"
static xla::ffi::Error Nothing() { return xla::ffi::Error::Success(); }
extern "C" const char* cvn_instruction_set() { return "none"; }
"""


def write_compiler(path, script):
  """A command that is called as a compiler is: OUT in the script is its output file."""
  find = 'for last; do [ "$before" = -o ] && OUT="$last"; before="$last"; done'
  path.write_text(f'#!/bin/sh\n{find}\n[ "$1" = --version ] && exit\n{script}\n')
  path.chmod(0o755)
  return str(path)


@pytest.fixture(scope='module')
def built():
  """This machine's compiled library and the result of its trial, both in the user's cache."""
  library = native.build()
  timings.find(library, library.parent)
  return library


@pytest.fixture
def home(tmp_path, built):
  """A folder for XDG_CACHE_HOME whose cache is filled."""
  folder = tmp_path / 'home' / 'cvn'
  folder.mkdir(parents=True)
  for path in (built, *built.parent.glob('trial-*.json')):
    shutil.copy(path, folder)
  return folder.parent


def choose(home, shipped='none', **variables):
  """(where a new process takes its kernels from, the lines that it prints about them)."""
  kept = {k: v for k, v in os.environ.items() if k not in ('CVN_KERNELS', 'CVN_TARGET')}
  done = subprocess.run(
    [sys.executable, '-c', CHOOSE, str(shipped)],
    env=kept | {'XDG_CACHE_HOME': str(home), **variables},
    capture_output=True, text=True, timeout=600,
  )  # fmt: skip
  assert done.returncode == 0, done.stderr
  return done.stdout.strip(), done.stderr.splitlines()


@needs_compiler
def test_the_library_is_compiled_where_nothing_else_is_named_or_shipped(home):
  assert choose(home) == ('compiled', [])


@needs_compiler
def test_a_library_may_be_named(home, tmp_path, built):
  path = shutil.copy(built, tmp_path / 'mine.so')
  assert choose(home, CVN_KERNELS=str(path)) == ('named', [])


@needs_compiler
@pytest.mark.parametrize(
  ('name', 'reason'),
  [('on', "'on' is neither 'off' nor a file"), ('text.so', 'invalid ELF header')],
)
def test_a_name_that_is_no_library_is_passed_over(home, tmp_path, name, reason):
  (tmp_path / 'text.so').write_text('this is no library, and longer than a header of one' * 9)
  value = str(tmp_path / name) if name.endswith('.so') else name
  origin, (line,) = choose(home, CVN_KERNELS=value)
  assert origin == 'compiled' and 'CVN_KERNELS is passed over' in line and reason in line


@pytest.fixture
def shipped(tmp_path):
  """A function that puts a file where a wheel has a library for this processor."""
  names = compiling.usable_targets()
  if not names:
    pytest.skip('no wheel has kernels for this processor')

  def ship(path):
    folder = tmp_path / 'shipped'
    folder.mkdir()
    shutil.copy(path, folder / f'kernels-{names[0]}.so')
    return folder

  return ship


@needs_compiler
def test_a_shipped_library_comes_before_compiling(home, shipped, built):
  assert choose(home, shipped(built), CXX='no-such-compiler') == ('shipped', [])


@needs_compiler
def test_a_target_is_compiled_for_and_what_is_shipped_passed_over(home, tmp_path, shipped, built):
  log = tmp_path / 'log'
  compiler = write_compiler(tmp_path / 'cc', f'echo "$@" >> {log}; cp {built} "$OUT"')
  found = choose(home, shipped(built), CXX=compiler, CVN_TARGET='haswell')
  assert found == ('compiled', []) and log.read_text().split()[-1] == '-march=haswell'


@needs_compiler
@pytest.mark.parametrize('fault', ['text', 'lacks kernels', 'other interface'])
def test_a_shipped_library_that_does_not_work_is_passed_over(home, tmp_path, shipped, fault):
  source, path = tmp_path / 'source.cc', tmp_path / 'made.so'
  if fault == 'text':
    path.write_text('no library')
    reason = 'file too short'
  else:
    declared = [
      f'XLA_FFI_DEFINE_HANDLER_SYMBOL({n}, Nothing, xla::ffi::Ffi::Bind());' for n in native.KERNELS
    ]
    other = fault == 'other interface'
    source.write_text('\n'.join([OTHER_INTERFACE, *declared]) if other else 'int nothing;')
    compiling.compile_library(source, path, include=[jax.ffi.include_dir()], options=('-O0',))
    reason = 'API version' if other else 'undefined symbol'
  origin, (line,) = choose(home, shipped(path))
  assert origin == 'compiled' and 'shipped kernels are not used' in line and reason in line


@needs_compiler
@pytest.mark.parametrize(
  ('script', 'reason'),
  [
    ('echo nonsense > "$OUT"', 'file too short'),
    ('true', 'wrote no library'),
    ('echo "x.cc: error: broken" >&2; exit 1', 'x.cc: error: broken'),
  ],
)
def test_a_compiler_that_fails_leaves_plain_products(tmp_path, script, reason):
  origin, (line,) = choose(tmp_path / 'home', CXX=write_compiler(tmp_path / 'cc', script))
  assert origin == 'None' and 'no compiled kernels' in line and reason in line


@needs_compiler
def test_a_target_that_the_compiler_does_not_know_leaves_plain_products(tmp_path):
  origin, (line,) = choose(tmp_path / 'home', CVN_TARGET='no-such-processor')
  assert origin == 'None' and 'no-such-processor' in line


@needs_compiler
def test_without_a_cache_kernels_are_compiled_for_the_process(tmp_path, built):
  (tmp_path / 'home').mkdir()
  (tmp_path / 'home' / 'cvn').write_text('a file where the folder is due')
  (tmp_path / 'tmp').mkdir()
  compiler = write_compiler(tmp_path / 'cc', f'cp {built} "$OUT"')
  origin, lines = choose(tmp_path / 'home', CXX=compiler, TMPDIR=str(tmp_path / 'tmp'))
  assert origin == 'compiled' and 'for this process alone' in lines[0]
  assert all('plain products are used where' in line for line in lines[1:])  # of this machine
  assert os.listdir(tmp_path / 'tmp') == []


def test_processes_that_start_together_compile_once(tmp_path):
  log = tmp_path / 'log'
  compiler = write_compiler(tmp_path / 'cc', f'echo >> {log}; sleep 1; echo done > "$OUT"')
  code = 'import sys; from cvn.ops import native; print(native.build().read_text())'
  environment = os.environ | {'CXX': compiler, 'XDG_CACHE_HOME': str(tmp_path)}
  processes = [
    subprocess.Popen(
      [sys.executable, '-c', code], env=environment, stdout=subprocess.PIPE, text=True
    )
    for _ in range(3)
  ]
  assert [p.communicate()[0].strip() for p in processes] == ['done'] * 3
  assert len(log.read_text().splitlines()) == 1
  assert sorted(os.listdir(tmp_path / 'cvn'))[0] == 'build.lock'
  assert len(os.listdir(tmp_path / 'cvn')) == 2


def test_a_kernel_is_used_where_it_wins():
  table = {'conv': {'float32': Times(2.0, 1.0), 'mixed': Times(1.0, 1.0)}}
  library = native.Library(None, 'named', 'none', table, '@1')
  assert not native.wins(library, 'conv', mixed=False)
  assert native.wins(library, 'conv', mixed=True)
  assert native.wins(library, 'deconv', mixed=False)


def test_the_faster_type(monkeypatch):
  both = {'float32': Times(2.0, 3.0), 'mixed': Times(1.0, 3.0)}
  library = native.Library(None, 'named', 'none', {'deconv': both, 'conv': both}, '')
  for found, dtype in ((library, 'mixed'), (None, 'float32')):
    monkeypatch.setattr(native, 'library', lambda found=found: found)
    assert native.faster_dtype()[0] == dtype
  monkeypatch.setattr(jax, 'default_backend', lambda: 'gpu')
  assert native.faster_dtype() == ('mixed', 'a gpu multiplies bfloat16 faster')


@needs_compiler
def test_a_source_that_does_not_compile_leaves_nothing(tmp_path):
  source = tmp_path / 'kernels.cc'
  source.write_text('this is no C++')
  with pytest.raises(subprocess.CalledProcessError):
    native.build(folder=tmp_path / 'cache', source=source)
  assert os.listdir(tmp_path / 'cache') == ['build.lock']


def run_python(tmp_path, **environment):
  """Takes a gradient in a process of its own; what it prints."""
  code = (
    'import jax, jax.numpy as jnp; from cvn import layers; from cvn.ops import deconv, native;'
    'x, scale, shift, activation = layers.as_pending(jnp.ones((1, 2, 2, 2, 3)));'
    'f = jax.grad(lambda k: (deconv.deconv(x, scale, shift, k, activation)[0] ** 2).sum());'
    'print(native.available(), float(f(jnp.ones((3, 3, 3, 3, 2))).sum()))'
  )
  environment = os.environ | {'XDG_CACHE_HOME': str(tmp_path)} | environment
  return subprocess.run(
    [sys.executable, '-c', code], env=environment, capture_output=True, text=True, timeout=300
  )


def test_without_a_compiler_one_line_says_so_and_all_works(tmp_path):
  done = run_python(tmp_path, CXX='no-such-compiler')
  off = run_python(tmp_path, CVN_KERNELS='off')
  assert done.returncode == off.returncode == 0, done.stderr
  assert done.stdout == off.stdout and done.stdout.startswith('False ')
  lines = done.stderr.splitlines()
  assert len(lines) == 1 and 'no C++ compiler: no-such-compiler' in lines[0]
  assert not off.stderr


@needs_compiler
def test_devices_take_their_own_samples():
  """A step over four devices gives what one gives, and sends no volume from one to another."""
  rng = np.random.default_rng(0)
  x = rng.standard_normal((8, 8, 8, 4), dtype=np.float32)
  weights = [
    rng.standard_normal(shape, dtype=np.float32)
    for shape in ((3, 3, 3, 16, 16), (3, 3, 3, 16, 1), (16,), (16,), (3, 3, 4, 16), (3, 3, 16, 32))
  ]

  @jax.jit
  def step(images, weights):
    def loss(w):
      def normal(y, sums, scale, shift):
        moments = normalization.moments(sums, y.size // y.shape[-1])
        return y, *normalization.coefficients(*moments, scale, shift)

      x = conv2d.conv2d(conv2d.conv2d(images, w[4]), w[5])
      x, *coefficients, identity = layers.as_pending(x.reshape(-1, 2, 2, 2, 16))
      y = normal(*deconv.deconv(x, *coefficients, w[0], identity), w[2], w[3])
      y = normal(*deconv.conv(*y, w[1], normalization.ELU), w[2][:1], w[3][:1])
      return jnp.sum(normalization.activate(*y, normalization.SIGMOID) ** 2)

    return jax.value_and_grad(loss)(weights)

  mesh = jax.make_mesh((4,), ('batch',), axis_types=(AxisType.Auto,))
  parts, whole = (NamedSharding(mesh, PartitionSpec(*s)) for s in (['batch'], []))
  spread = jax.device_put(x, parts), jax.device_put(weights, whole)
  for a, b in zip(jax.tree.leaves(step(*spread)), jax.tree.leaves(step(x, weights)), strict=True):
    np.testing.assert_allclose(a, b, rtol=1e-5, atol=1e-5 * float(jnp.abs(b).max()))
  program = step.lower(*spread).compile().as_text()
  assert set(re.findall('cvn_[a-z0-9_]+', program)) == set(native.KERNELS)
  assert 'all-reduce' in program and 'all-gather' not in program


@pytest.mark.skipif(not HAS_COMPILER, reason='no C++ compiler here')
def test_the_cache_of_compiled_programs_knows_those_of_several_devices(tmp_path):
  code = (
    'import jax, jax.numpy as jnp; from jax.sharding import *; from cvn import layers;'
    'hits = []; jax.monitoring.register_event_listener(lambda name, **_: hits.append(name));'
    "mesh = jax.make_mesh((2,), ('batch',), (AxisType.Auto,));"
    'x = jax.device_put(jnp.ones((4, 1, 1, 1, 2)), NamedSharding(mesh, PartitionSpec("batch")));'
    'hits.clear();'
    'run = jax.jit(lambda x: layers.materialize(layers.as_pending(x))).lower(x).compile();'
    'assert "cvn_activated" in run.as_text() and "all-gather" not in run.as_text();'
    'print(hits.count("/jax/compilation_cache/cache_hits"))'
  )
  environment = os.environ | {
    'JAX_NUM_CPU_DEVICES': '2',
    'JAX_COMPILATION_CACHE_DIR': str(tmp_path),
    'JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS': '0',
    'JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES': '-1',
  }
  command = [sys.executable, '-c', code]
  first, second = (
    subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300)
    for _ in range(2)
  )
  assert first.returncode == second.returncode == 0, first.stderr + second.stderr
  assert int(first.stdout) == 0 and int(second.stdout) > 0
