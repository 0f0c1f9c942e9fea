"""The encoder's convolution against the library's: values and gradients."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cvn.ops import conv2d, native

# [B, H, W, in], size and out of the kernel.
SHAPES = [
  ((2, 16, 12, 3), 7, 16),
  ((1, 2, 2, 5), 3, 32),
  ((3, 10, 6, 20), 5, 48),
  ((2, 8, 70, 64), 5, 64),
  ((1, 36, 4, 16), 4, 16),
  ((2, 6, 6, 3), 3, 5),  # the kernels do not take 5 channels, 'auto' does
]


def draw(rng, *shape):
  return rng.standard_normal(shape, dtype=np.float32)


def value_and_gradients(function, x, kernel, dy):
  y, pull = jax.vjp(function, x, kernel)
  return y, *pull(dy)


def make(shape, size, out):
  rng = np.random.default_rng(0)
  x, kernel = draw(rng, *shape), draw(rng, size, size, shape[-1], out)
  return x, kernel, draw(rng, *conv2d.library_conv2d(x, kernel).shape)


@pytest.mark.parametrize('implementation', ['auto', 'xla'])
@pytest.mark.parametrize(('shape', 'size', 'out'), SHAPES)
def test_value_and_gradients(shape, size, out, implementation):
  arguments = make(shape, size, out)
  ours = functools.partial(conv2d.conv2d, implementation=implementation)
  got = jax.jit(lambda *a: value_and_gradients(ours, *a))(*arguments)
  expected = value_and_gradients(conv2d.library_conv2d, *arguments)
  for a, b in zip(got, expected, strict=True):
    np.testing.assert_allclose(a, b, rtol=1e-5, atol=1e-5 * float(jnp.abs(b).max()))


@pytest.mark.parametrize(('shape', 'size', 'out'), SHAPES)
def test_mixed_precision_rounds_factors_at_most(shape, size, out):
  arguments = make(shape, size, out)
  ours = functools.partial(conv2d.conv2d, mixed=True)
  got = jax.jit(lambda *a: value_and_gradients(ours, *a))(*arguments)
  expected = value_and_gradients(conv2d.library_conv2d, *arguments)
  for a, b in zip(got, expected, strict=True):
    assert a.dtype == jnp.float32
    np.testing.assert_allclose(a, b, atol=0.01 * float(jnp.abs(b).max()))


def test_a_gradient_that_nobody_needs_is_not_made():
  """As that of the picture."""
  if not native.available():
    pytest.skip('no C++ compiler here')
  x, kernel, dy = make((2, 8, 8, 3), 3, 16)
  gradient = jax.jit(jax.grad(lambda k: jnp.sum(conv2d.conv2d(x, k) * dy)))
  assert 'cvn_conv2d_input_gradient' not in gradient.lower(kernel).compile().as_text()


@pytest.mark.parametrize('mixed', [False, True])
def test_accelerators_get_the_library(mixed):
  x, kernel, dy = make((2, 8, 8, 3), 3, 16)
  ours = functools.partial(conv2d.conv2d, mixed=mixed)
  step = jax.jit(lambda *a: value_and_gradients(ours, *a))
  for platform in ('cuda', 'tpu'):
    module = jax.export.export(step, platforms=[platform])(x, kernel, dy).mlir_module()
    assert module.count('stablehlo.convolution') == 3 and 'cvn_' not in module
