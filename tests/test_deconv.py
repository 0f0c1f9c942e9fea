"""All programs for a CPU agree with XLA's convolution: values and gradients."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from cvn import layers
from cvn.ops import deconv, native
from cvn.ops.normalization import ELU, IDENTITY, SIGMOID

# [B, X, Y, Z, in] and out.
SHAPES = [
  ((2, 2, 3, 4, 6), 5),
  ((1, 1, 1, 1, 3), 1),
  ((1, 5, 2, 1, 1), 34),
  ((2, 2, 2, 17, 33), 5),
  ((1, 2, 1, 32, 24), 16),
]


def plain_deconv(x, kernel, **options):
  """Of x as it is."""
  *arrays, activation = layers.as_pending(x)
  return deconv.deconv(*arrays, kernel, activation, **options)[0]


def plain_conv(x, kernel, **options):
  *arrays, activation = layers.as_pending(x)
  return deconv.conv(*arrays, kernel, activation, **options)[0]


PROGRAMS = {
  'deconv': (plain_deconv, deconv.deconv, deconv.library_deconv),
  'conv': (plain_conv, deconv.conv, deconv.library_conv),
}


def draw(rng, *shape):
  return rng.standard_normal(shape, dtype=np.float32)


def rounded(x):
  return lax.reduce_precision(x, exponent_bits=8, mantissa_bits=7)


def value_and_pullback(function, x, kernel, cotangent):
  out, pull = jax.vjp(function, x, kernel)
  return out, *pull(cotangent)


def assert_close(got, want, tolerance=1e-5):
  for g, w in zip(got, want, strict=True):
    assert g.shape == w.shape and g.dtype == w.dtype == np.float32
    scale = max(float(jnp.abs(w).max()), 1.0)
    np.testing.assert_allclose(g, w, rtol=tolerance, atol=tolerance * scale)


@pytest.fixture(params=['kernels', 'products', 'xla'])
def implementation(request, monkeypatch):
  """Each program for a CPU in turn: products have a gradient of their own, 'xla' has JAX's."""
  if request.param == 'kernels' and not native.available():
    pytest.skip('no C++ compiler here')
  if request.param == 'products':
    monkeypatch.setattr(native, 'wins', lambda *_, **__: False)
    return 'auto'
  return request.param


@pytest.mark.parametrize(('shape', 'cout'), SHAPES)
@pytest.mark.parametrize('name', PROGRAMS)
def test_value_and_gradients(implementation, name, shape, cout):
  ours, _, library = PROGRAMS[name]
  ours = functools.partial(ours, implementation=implementation)
  rng = np.random.default_rng(0)
  x, kernel = draw(rng, *shape), draw(rng, 3, 3, 3, shape[-1], cout)
  cotangent = draw(rng, *library(x, kernel).shape)
  got = jax.jit(lambda *a: value_and_pullback(ours, *a))(x, kernel, cotangent)
  assert_close(got, value_and_pullback(library, x, kernel, cotangent))


@pytest.mark.parametrize('activation', [IDENTITY, ELU, SIGMOID])
@pytest.mark.parametrize(('shape', 'cout'), SHAPES)
@pytest.mark.parametrize('name', PROGRAMS)
def test_what_comes_before_the_product_and_what_is_summed_behind_it(
  implementation, name, shape, cout, activation
):
  _, ours, library = PROGRAMS[name]
  rng = np.random.default_rng(4)
  cin = shape[-1]
  shapes = shape, (cin,), (cin,), (3, 3, 3, cin, cout)
  arguments = [draw(rng, *s) for s in shapes]

  def composed(x, scale, shift, kernel):
    scale, shift = (v.reshape(1, 1, 1, 1, -1) for v in (scale, shift))
    y = library(activation.value(x * scale + shift), kernel)
    axes = (0, 1, 2, 3)
    return y, jnp.stack([y.sum(axes), (y * y).sum(axes)])

  expected, pull = jax.vjp(composed, *arguments)
  cotangents = draw(rng, *expected[0].shape), draw(rng, 2, cout)

  @jax.jit
  def value_and_gradients(*arguments):
    value, pull = jax.vjp(
      lambda *a: ours(*a, activation, implementation=implementation), *arguments
    )
    return *value, *pull(cotangents)

  assert_close(value_and_gradients(*arguments), [*expected, *pull(cotangents)])


@pytest.mark.parametrize(('shape', 'cout'), SHAPES)
@pytest.mark.parametrize('name', PROGRAMS)
def test_bfloat16_volumes_round_factors_and_results_and_nothing_else(
  implementation, name, shape, cout
):
  ours, _, library = PROGRAMS[name]
  ours = functools.partial(ours, implementation=implementation)
  rng = np.random.default_rng(1)
  x = draw(rng, *shape).astype(jnp.bfloat16)
  kernel = draw(rng, 3, 3, 3, shape[-1], cout)
  out_dtype = jnp.float32 if name == 'conv' else jnp.bfloat16
  shape = library(x.astype(jnp.float32), kernel).shape
  cotangent = draw(rng, *shape).astype(out_dtype)
  out, dx, dkernel = jax.jit(lambda *a: value_and_pullback(ours, *a))(x, kernel, cotangent)
  assert (out.dtype, dx.dtype, dkernel.dtype) == (out_dtype, jnp.bfloat16, jnp.float32)
  want = value_and_pullback(
    library, x.astype(jnp.float32), rounded(kernel), rounded(cotangent.astype(jnp.float32))
  )
  # A result is rounded once, by half a unit in the eighth digit at most; sums are float32's. JAX's
  # own derivative rounds the gradient of a rounded kernel too.
  assert_close([out.astype(jnp.float32)], want[:1], 2**-8 if name == 'deconv' else 1e-5)
  assert_close([dx.astype(jnp.float32)], want[1:2], 2**-8)
  assert_close([dkernel], want[2:], 2**-8 if implementation == 'xla' else 1e-5)


def test_a_bfloat16_volume_may_give_a_float32_one(implementation):
  """As the flow's does: a place in the image needs more than eight binary digits."""
  rng = np.random.default_rng(3)
  x, kernel = draw(rng, 2, 3, 4, 5, 8).astype(jnp.bfloat16), draw(rng, 3, 3, 3, 8, 2)
  ours = functools.partial(plain_deconv, dtype=jnp.float32, implementation=implementation)
  function = jax.jit(lambda *a: value_and_pullback(ours, *a))
  dy = draw(rng, 2, 6, 8, 10, 2)
  out, dx, dkernel = function(x, kernel, dy)
  assert (out.dtype, dx.dtype, dkernel.dtype) == (jnp.float32, jnp.bfloat16, jnp.float32)
  want = value_and_pullback(
    deconv.library_deconv, x.astype(jnp.float32), rounded(kernel), rounded(dy)
  )
  assert_close([out], want[:1])
  assert_close([dkernel], want[2:], 2**-8 if implementation == 'xla' else 1e-5)
  assert_close([dx.astype(jnp.float32)], want[1:2], 2**-8)


@pytest.mark.parametrize('name', PROGRAMS)
def test_batches_are_taken_sample_by_sample(implementation, name):
  """What is summed over a batch is summed in the same order whatever the threads do."""
  ours = functools.partial(PROGRAMS[name][0], implementation=implementation)
  rng = np.random.default_rng(2)
  x, kernel = draw(rng, 5, 4, 4, 4, 8), draw(rng, 3, 3, 3, 8, 4)
  function = jax.jit(lambda x, k, dy: value_and_pullback(ours, x, k, dy))
  dy = draw(rng, *ours(x, kernel).shape)
  first, again = function(x, kernel, dy), function(x, kernel, dy)
  for a, b in zip(first, again, strict=True):
    np.testing.assert_array_equal(a, b)
  y, dx, _ = function(x[:1], kernel, dy[:1])
  np.testing.assert_allclose(y[0], first[0][0], rtol=1e-5, atol=1e-5)
  np.testing.assert_allclose(dx[0], first[1][0], rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize('implementation', ['auto', 'xla'])
@pytest.mark.parametrize('dtype', [jnp.float32, jnp.bfloat16])
@pytest.mark.parametrize('name', PROGRAMS)
def test_accelerators_get_the_library_and_cpus_do_not(name, dtype, implementation):
  x, kernel = jnp.zeros((1, 4, 4, 4, 8), dtype), jnp.zeros((3, 3, 3, 8, 4))

  def step(x, kernel):
    def loss(x, kernel):
      y = PROGRAMS[name][0](x, kernel, implementation=implementation)
      return jnp.sum(y.astype(jnp.float32) ** 2)

    return jax.value_and_grad(loss, (0, 1))(x, kernel)

  checks = [
    jax.export.DisabledSafetyCheck.custom_call(name + native.library().suffix)
    for name in native.KERNELS
    if native.available()
  ]
  lowered = {
    platform: jax.export.export(jax.jit(step), platforms=[platform], disabled_checks=checks)(
      x, kernel
    ).mlir_module()
    for platform in ('cpu', 'cuda', 'tpu')
  }
  for platform in ('cuda', 'tpu'):
    assert lowered[platform].count('stablehlo.convolution') == 3  # value and two gradients
    assert 'cvn_' not in lowered[platform]
  assert 'stablehlo.convolution' not in lowered['cpu']
  assert ('cvn_' in lowered['cpu']) == (implementation == 'auto' and native.available())


@pytest.mark.parametrize(('shape', 'cout'), SHAPES)
def test_the_gradient_of_accelerators_is_the_derivative(shape, cout):
  """That of the adjoint, without an input or a kernel that is dilated and as large as a volume."""
  rng = np.random.default_rng(0)
  x, kernel = draw(rng, *shape), draw(rng, 3, 3, 3, shape[-1], cout)
  y, pull = jax.vjp(deconv.library_deconv, x, kernel)
  dy = draw(rng, *y.shape)
  assert_close(deconv.library_deconv_gradient(x, kernel, dy), pull(dy))
  text = jax.jit(deconv.library_deconv_gradient).lower(x, kernel, dy).as_text()
  assert 'lhs_dilate = [2, 2, 2]' not in text
