"""Operations and networks under the transformations of JAX, each against the plain loop.

Expected values come from plain JAX operations without the transformation: a loop, a sum that is
written out, a product of a gradient and a direction, or finite differences.
"""

import functools
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.sharding import AxisType, PartitionSpec
from operations import (
  IMPLEMENTATIONS,
  KERNELS,
  OPERATIONS,
  assert_close,
  draw,
  loss,
  make,
  operation,
  plain,
  values,
)

from cvn.networks import ShapeNetwork
from cvn.ops import native

SMALL = {'image_size': 32, 'grid_size': 16}  # the smallest that the networks can have
needs_kernels = pytest.mark.skipif(not native.available(), reason='no compiled kernels here')


def stack(trees):
  return jax.tree.map(lambda *leaves: jnp.stack(leaves), *trees)


def pick(tree, n):
  return jax.tree.map(lambda x: x[n], tree)


def added(tree):
  return jax.tree.map(lambda x: x.sum(0), tree)


def dot(a, b):
  return sum(jax.tree.leaves(jax.tree.map(lambda a, b: jnp.sum(a * b), a, b)))


def differences(gradient, at, direction, step=1e-2):
  """Central ones, along a direction; they err by step^2 times the next derivative."""
  ends = (
    gradient(*jax.tree.map(lambda a, d, s=s: a + s * d, at, direction)) for s in (step, -step)
  )
  return jax.tree.map(lambda a, b: (a - b) / (2 * step), *ends)


def assert_near(got, want, tolerance):
  """In the norm of all arrays together."""
  got, want = (jnp.concatenate([v.ravel() for v in jax.tree.leaves(t)]) for t in (got, want))
  assert jnp.linalg.norm(got - want) < tolerance * jnp.linalg.norm(want)


@pytest.fixture(params=IMPLEMENTATIONS)
def implementation(request):
  return request.param


@pytest.mark.parametrize('name', OPERATIONS)
def test_vmap_scan_and_checkpoint(name, implementation):
  x, p = make(name, 3)
  ensemble = tuple(draw(10 + n, 3, *a.shape) for n, a in enumerate(p))
  both, one = values(name, implementation), plain(name)
  of_slice = functools.partial(loss, operation(name, implementation))

  def mapped(x, p):
    return jnp.sum(jax.vmap(of_slice, (0, None))(x, p))

  def scanned(x, p):
    def step(before, v):
      return before + jax.checkpoint(of_slice)(v, p), None

    return jax.lax.scan(step, 0.0, x)[0]

  @jax.jit
  def run(x, p, ensemble):
    return {
      'batches': jax.vmap(both, (0, None))(x, p),
      'parameters': jax.vmap(both, (None, 0))(x[0], ensemble),
      'both': jax.vmap(both)(x, ensemble),
      'nested': jax.vmap(jax.vmap(both, (None, 0)), (0, None))(x[:2], ensemble),
      'mapped': jax.value_and_grad(mapped, (0, 1))(x, p),
      'scanned': jax.value_and_grad(scanned, (0, 1))(x, p),
    }

  batches = stack([one(v, p) for v in x])
  losses, (dx, dp) = batches[1]
  total = jnp.sum(losses), (dx, added(dp))
  want = {
    'batches': batches,
    'parameters': stack([one(x[0], pick(ensemble, n)) for n in range(3)]),
    'both': stack([one(x[n], pick(ensemble, n)) for n in range(3)]),
    'nested': stack([stack([one(v, pick(ensemble, n)) for n in range(3)]) for v in x[:2]]),
    'mapped': total,
    'scanned': total,
  }
  assert_close(run(x, p, ensemble), want)


@pytest.mark.parametrize('check', [True, False])
@pytest.mark.parametrize('name', KERNELS)
def test_shard_map(name, implementation, check):
  """Two devices, each with half the batch; JAX sums the gradients of parameters."""
  x, p = make(name, 2)
  losses, (dx, dp) = stack([plain(name)(v, p)[1] for v in x])
  mesh = jax.make_mesh((2,), ('batch',), (AxisType.Auto,), devices=jax.devices()[:2])
  specs = PartitionSpec('batch'), PartitionSpec()

  @functools.partial(
    jax.shard_map, mesh=mesh, in_specs=specs, out_specs=PartitionSpec(), check_vma=check
  )
  def total(x, p):
    return jax.lax.psum(loss(operation(name, implementation), x[0], p), 'batch')

  got = jax.jit(jax.value_and_grad(total, (0, 1)))(x, p)
  assert_close(got, (jnp.sum(losses), (dx, added(dp))))


@pytest.mark.parametrize('name', KERNELS)
def test_a_batch_of_any_leading_shape(name, implementation):
  x, p = make(name)
  want = jax.tree.leaves(plain(name)(x, p)[0])
  run = jax.jit(operation(name, implementation))
  got = jax.tree.leaves(run(x.reshape(1, 2, 1, *x.shape[1:]), p))
  assert got[0].shape[:3] == (1, 2, 1)
  assert_close([got[0].reshape(want[0].shape), *got[1:]], want)
  assert_close(jax.tree.leaves(run(x[1], p))[0], want[0][1])


@pytest.mark.parametrize('name', OPERATIONS)
def test_forward_mode_and_second_derivatives(name, implementation):
  x, p = make(name)
  direction = jax.tree.map(lambda a: draw(30, *a.shape), (x, p))
  function = functools.partial(loss, operation(name, implementation))
  derivative = jax.grad(function, (0, 1))

  def of_three(v):
    """Some results as a function of three numbers of the last parameter."""
    last = jnp.concatenate([p[-1].reshape(-1)[:-3], v]).reshape(p[-1].shape)
    results = operation(name, implementation)(x, (*p[:-1], last))
    return jax.tree.leaves(results)[0].ravel()[-40:]

  @jax.jit
  def run(x, p):
    v = p[-1].reshape(-1)[-3:]
    return (
      jax.jvp(function, (x, p), direction),
      (jax.jacfwd(of_three)(v), jax.jacrev(of_three)(v)),
      jax.jvp(derivative, (x, p), direction)[1],
      jax.grad(lambda *a: dot(derivative(*a), direction), (0, 1))(x, p),
    )

  first, jacobians, forward_over_reverse, reverse_over_reverse = run(x, p)
  value, gradient = plain(name)(x, p)[1]
  assert_close(first, (value, dot(gradient, direction)), 1e-4)
  assert_close(*jacobians)
  assert_close(forward_over_reverse, reverse_over_reverse, 1e-4)
  want = differences(lambda *a: plain(name)(*a)[1][1], (x, p), direction)
  assert_near(forward_over_reverse, want, 0.02)


@needs_kernels
def test_the_first_gradient_is_the_kernels_and_no_plain_product_is_made():
  function = functools.partial(loss, operation('deconv', 'auto'))
  text = jax.jit(jax.grad(function, (0, 1))).lower(*make('deconv')).as_text()
  called = re.findall(r'custom_call @([^(]+)', text)
  suffix = native.library().suffix
  assert called == ['cvn_deconv' + suffix, 'cvn_deconv_gradient' + suffix]
  assert 'while' not in text and 'convolution' not in text


@pytest.mark.parametrize('dtype', [jnp.float16, jnp.bfloat16, jnp.float64])
@pytest.mark.parametrize('name', OPERATIONS)
def test_other_floating_types_are_cast_and_get_gradients_of_their_own(name, implementation, dtype):
  """float64 in x64 mode; volumes keep bfloat16."""
  x, p = make(name)
  x = x if dtype == jnp.bfloat16 else x.astype(dtype)
  p = tuple(a.astype(dtype) for a in p)
  want, (value, gradients) = plain(name)(np.float32(x), tuple(map(np.float32, p)))
  gradients = jax.tree.map(lambda g, a: np.asarray(g).astype(a.dtype), gradients, (x, p))
  with jax.enable_x64(dtype == jnp.float64):
    got = jax.jit(values(name, implementation))(x, p)
  assert_close((got[0], got[1][0]), (want, value))
  assert_close(got[1][1], gradients, 2e-5 if dtype == jnp.float64 else 2**-7)


def apply(variables, image, implementation='auto', **options):
  network = ShapeNetwork(**SMALL, implementation=implementation)
  return network.apply(variables, image, **({'train': False} | options))


def network_loss(params, statistics, image, implementation='auto'):
  """With batch statistics, as in training."""
  variables = {'params': params, 'batch_stats': statistics}
  out, _ = apply(variables, image, implementation, train=True, mutable='batch_stats')
  return jnp.mean(jnp.sin(out))


def network_values(variables, image, implementation='auto'):
  """(logits, (loss, its gradient))."""
  gradient = jax.value_and_grad(network_loss)
  arguments = variables['params'], variables['batch_stats'], image, implementation
  return apply(variables, image, implementation), gradient(*arguments)


plain_network = jax.jit(functools.partial(network_values, implementation='xla'))


@pytest.fixture(scope='module')
def variables():
  init = functools.partial(ShapeNetwork(**SMALL).init, train=False)
  return jax.jit(init)(jax.random.key(0), jnp.zeros((1, 32, 32, 3)))


@pytest.fixture(scope='module')
def image():
  """Eight: the statistics of two make the gradient so steep that rounding moves it by 0.4 %."""
  return jax.random.uniform(jax.random.key(1), (8, 32, 32, 3))


def test_an_ensemble_of_networks(variables, image):
  """Inference and gradients of training."""
  networks = [jax.tree.map(lambda a, n=n: a * (1 + 0.1 * n), variables) for n in range(2)]
  logits, training = jax.jit(jax.vmap(network_values, (0, None)))(stack(networks), image)
  want_logits, want = stack([plain_network(v, image) for v in networks])
  assert_close(logits, want_logits, 1e-4)
  assert_near(training, want, 1e-4)


def test_images_of_any_leading_shape(variables, image):
  logits, _ = plain_network(variables, image)

  @jax.jit
  def run(image):
    nested = apply(variables, image.reshape(2, 1, 4, 32, 32, 3))
    return nested, apply(variables, image[0]), jax.vmap(apply, (None, 0))(variables, image)

  nested, one, mapped = run(image)
  assert_close(nested, logits.reshape(2, 1, 4, 16, 16, 16, 1), 1e-4)
  assert_close(one, logits[0], 1e-4)
  assert_close(mapped, logits, 1e-4)


def test_a_hessian_vector_product_of_a_network(variables, image):
  params, statistics = variables['params'], variables['batch_stats']
  direction = jax.tree.map(lambda a: 0.1 * draw(40, *a.shape) * jnp.std(a), params)

  @jax.jit
  def product(params):
    gradient = jax.grad(lambda p: network_loss(p, statistics, image))
    return jax.jvp(gradient, (params,), (direction,))[1]

  def gradient(params):
    return plain_network({'params': params, 'batch_stats': statistics}, image)[1][1]

  assert_near(product(params), differences(gradient, (params,), (direction,), step=1e-3), 0.02)


@needs_kernels
def test_inference_is_exported_and_comes_back(variables, image):
  names = [name + native.library().suffix for name in native.KERNELS]
  calls = [jax.export.DisabledSafetyCheck.custom_call(name) for name in names]
  exported = jax.export.export(jax.jit(apply), platforms=['cpu'], disabled_checks=calls)
  again = jax.export.deserialize(exported(variables, image).serialize())
  assert names[0] in again.mlir_module()
  assert_close(again.call(variables, image), plain_network(variables, image)[0], 1e-4)


def test_a_network_in_other_types(variables, image):
  low = jax.tree.map(lambda a: a.astype(jnp.bfloat16), variables)
  half = image.astype(jnp.float16)
  want, _ = plain_network(jax.tree.map(np.float32, low), np.float32(half))
  with jax.numpy_dtype_promotion('standard'):  # bfloat16 parameters meet float32 features
    got = jax.jit(apply)(low, half)
  assert_close(got, want, 1e-4)


def test_a_network_in_x64_mode(variables, image):
  """Nothing becomes float64: not parameters, nor results, nor gradients."""
  logits, training = plain_network(variables, image)
  with jax.enable_x64(True):
    wide = jnp.asarray(np.float64(image))
    assert wide.dtype == jnp.float64
    init = functools.partial(ShapeNetwork(**SMALL).init, train=False)
    shapes = jax.eval_shape(init, jax.random.key(0), wide)
    assert {s.dtype for s in jax.tree.leaves(shapes)} == {np.dtype('float32')}
    got = jax.jit(network_values)(variables, wide)
  assert {a.dtype for a in jax.tree.leaves(got)} == {np.dtype('float32')}
  assert_close(got[0], logits, 1e-4)
  assert_near(got[1], training, 1e-4)
