"""Building and loading the kernels, doing without them, and spreading them over devices."""

import os
import re
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.sharding import AxisType, NamedSharding, PartitionSpec

from cvn import layers
from cvn.ops import conv2d, deconv, native, normalization

HAS_COMPILER = native.available()


@pytest.mark.skipif(not HAS_COMPILER, reason='no C++ compiler here')
def test_build_compiles_once_and_leaves_nothing_else(tmp_path, monkeypatch):
  runs = []
  compile_once = native._compile

  def counted(command):
    runs.append(command)
    # Without optimisation: quick, and enough to be a library.
    compile_once([c for c in command if c != '-O3'])

  monkeypatch.setattr(native, '_compile', counted)
  path = native.build(tmp_path / 'cache')
  assert native.build(tmp_path / 'cache') == path and len(runs) == 1
  assert os.listdir(tmp_path / 'cache') == [path.name]


def test_a_source_that_does_not_compile_leaves_nothing(tmp_path):
  if not HAS_COMPILER:
    pytest.skip('no C++ compiler here')
  source = tmp_path / 'kernels.cc'
  source.write_text('this is no C++')
  with pytest.raises(subprocess.CalledProcessError):
    native.build(tmp_path / 'cache', source)
  assert not os.listdir(tmp_path / 'cache')


def run_python(tmp_path, **environment):
  """Takes a gradient in a process of its own; what it prints."""
  code = (
    'import jax, jax.numpy as jnp; from cvn import layers; from cvn.ops import deconv, native;'
    'x, gain, offset, activation = layers.volume_of(jnp.ones((1, 2, 2, 2, 3)));'
    'f = jax.grad(lambda k: (deconv.deconv(x, gain, offset, k, activation)[0] ** 2).sum());'
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


@pytest.mark.skipif(not HAS_COMPILER, reason='no C++ compiler here')
def test_a_cache_that_cannot_be_written_is_no_failure(tmp_path):
  (tmp_path / 'cvn').write_text('a file where the folder is due')
  done = run_python(tmp_path)
  assert done.returncode == 0 and done.stdout.startswith('False '), done.stderr
  assert len(done.stderr.splitlines()) == 1


@pytest.mark.skipif(not HAS_COMPILER, reason='no C++ compiler here')
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
      def normal(y, sums, scale, offset):
        moments = normalization.moments(sums, y)
        return y, *normalization.coefficients(*moments, scale, offset)

      x = conv2d.conv2d(conv2d.conv2d(images, w[4]), w[5])
      x, *coefficients, identity = layers.volume_of(x.reshape(-1, 2, 2, 2, 16))
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
    'hits.clear(); run = jax.jit(lambda x: layers.finish(layers.volume_of(x))).lower(x).compile();'
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
