"""Batch normalisation's own derivative against the one that JAX derives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from cvn.ops import native, normalization
from cvn.ops.normalization import ELU, EPSILON, IDENTITY, SIGMOID

PLAIN = {ELU: jax.nn.elu, SIGMOID: jax.nn.sigmoid, IDENTITY: lambda x: x}


def plain(x, gamma, beta, activation):
  """As the text books write it."""
  axes = tuple(range(x.ndim - 1))
  mean, variance = x.mean(axes, keepdims=True), x.var(axes, keepdims=True)
  spread = (1,) * (x.ndim - 1) + (-1,)
  z = (x - mean) / jnp.sqrt(variance + EPSILON)
  return PLAIN[activation](z * gamma.reshape(spread) + beta.reshape(spread))


def draw(*shape):
  rng = np.random.default_rng(0)
  x = 3 * rng.standard_normal(shape, dtype=np.float32) + 1
  gamma, beta = rng.standard_normal((2, shape[-1]), dtype=np.float32)
  return x, gamma, beta


@pytest.fixture(params=['kernels', 'loops', 'xla'])
def implementation(request, monkeypatch):
  """Volumes on a CPU have two programs; 'xla' is the second with JAX's derivative."""
  if request.param == 'kernels' and not native.available():
    pytest.skip('no C++ compiler here')
  if request.param == 'loops':
    monkeypatch.setattr(native, 'wins', lambda *_, **__: False)
    return 'auto'
  return request.param


@pytest.mark.parametrize('activation', PLAIN)
@pytest.mark.parametrize('channels', [1, 3, 16, 24, 5])
@pytest.mark.parametrize('dtype', [jnp.float32, jnp.bfloat16])
def test_activated_volumes(implementation, activation, channels, dtype):
  x, scale, shift = draw(2, 3, 4, 5, channels)
  x = x.astype(dtype)
  cotangent = np.random.default_rng(1).standard_normal(x.shape, np.float32).astype(dtype)

  @jax.jit
  def ours(*arguments):
    out, pull = jax.vjp(
      lambda *a: normalization.activate(*a, activation, implementation=implementation), *arguments
    )
    return out, *pull(cotangent)

  def expected(x, scale, shift):
    shape = (1,) * 4 + (-1,)
    return PLAIN[activation](x * scale.reshape(shape) + shift.reshape(shape))

  out, pull = jax.vjp(expected, x.astype(np.float32), scale, shift)
  got = ours(x, scale, shift)
  assert [a.dtype for a in got] == [dtype, dtype, jnp.float32, jnp.float32]
  tolerance = 1e-5 if dtype == jnp.float32 else 2**-7
  for a, b in zip(got, [out, *pull(cotangent.astype(np.float32))], strict=True):
    largest = float(jnp.abs(b).max())
    np.testing.assert_allclose(a.astype(jnp.float32), b, rtol=tolerance, atol=tolerance * largest)


def test_a_volume_is_normalised_from_its_sums():
  x, gamma, beta = draw(2, 3, 4, 5, 6)
  moments = normalization.moments(normalization.sum_channels(jnp.asarray(x)), x.size // x.shape[-1])
  scale, shift = normalization.coefficients(*moments, gamma, beta)
  got = normalization.activate(x, scale, shift, ELU)
  np.testing.assert_allclose(got, plain(x, gamma, beta, ELU), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize('implementation', ['auto', 'xla'])
@pytest.mark.parametrize('activation', PLAIN)
@pytest.mark.parametrize('shape', [(7, 5), (2, 3, 4, 6), (2, 2, 2, 2, 2, 2, 2, 3)])
def test_value_and_gradients(activation, shape, implementation):
  x, gamma, beta = draw(*shape)
  ours = jax.jit(
    lambda *a: normalization.normalize(*a, activation, implementation=implementation)[0]
  )
  out, pullback = jax.vjp(ours, x, gamma, beta)
  expected, expected_pullback = jax.vjp(lambda *a: plain(*a, activation), x, gamma, beta)
  np.testing.assert_allclose(out, expected, rtol=1e-5, atol=1e-5)
  cotangent = np.random.default_rng(1).standard_normal(shape, dtype=np.float32)
  for got, want in zip(pullback(cotangent), expected_pullback(cotangent), strict=True):
    np.testing.assert_allclose(got, want, rtol=1e-4, atol=2e-5)


def test_moments_are_those_of_numpy():
  x, gamma, beta = draw(50, 4)
  _, mean, variance = normalization.normalize(x, gamma, beta, ELU)
  np.testing.assert_allclose(mean, x.mean(0), rtol=1e-5)
  np.testing.assert_allclose(variance, x.var(0), rtol=1e-4)


def test_running_statistics_give_the_same_affine_map():
  x, gamma, beta = draw(50, 4)
  y, mean, variance = normalization.normalize(x, gamma, beta, SIGMOID)
  scale, shift = normalization.coefficients(mean, variance, gamma, beta)
  again = normalization.activated(x, scale, shift, SIGMOID)
  np.testing.assert_allclose(again, y, rtol=1e-6)


def test_constant_channel_is_finite():
  x = jnp.ones((6, 2))
  f = jax.grad(lambda x: normalization.normalize(x, jnp.ones(2), jnp.zeros(2), ELU)[0].sum())
  assert np.isfinite(f(x)).all()


@pytest.mark.parametrize('activation', PLAIN)
def test_slopes(activation):
  check_grads(activation.value, (jnp.array([-2.0, -0.5, 0.3, 4.0]),), 1, ('rev',), 1e-2, 1e-2)
  x = jnp.linspace(-4.0, 4.0, 9) + 0.1
  slope = jax.vmap(jax.grad(activation.value))(x)
  np.testing.assert_allclose(activation.slope(activation.value(x)), slope, rtol=1e-5, atol=1e-6)


def test_elu_of_tiny_numbers():
  x = jnp.array([-1e-3, -1e-6, 0.0, 1e-6])
  np.testing.assert_allclose(ELU.value(x), jax.nn.elu(x), atol=1.2e-7)
