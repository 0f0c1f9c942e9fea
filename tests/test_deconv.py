"""The matrix-product deconvolution against the library's convolution with dilated input."""

import jax
import numpy as np
import pytest
from jax import lax

from cvn import deconv

DIMENSIONS = ('NXYZC', 'XYZIO', 'NXYZC')


def library_deconv(x, kernel):
  """Stride-2 SAME: the input dilated, correlated with the flipped kernel."""
  return lax.conv_general_dilated(
    x,
    kernel[::-1, ::-1, ::-1],
    (1, 1, 1),
    [(2, 1)] * 3,
    lhs_dilation=(2, 2, 2),
    dimension_numbers=DIMENSIONS,
  )


def library_conv(x, kernel):
  return lax.conv_general_dilated(x, kernel, (1, 1, 1), 'SAME', dimension_numbers=DIMENSIONS)


def our_deconv(x, kernel):
  return deconv.interleave(deconv.deconv(x, kernel))


def blocks(x):
  """Plain layout -> phase layout."""
  b, sx, sy, sz, c = x.shape
  x = x.reshape(b, sx // 2, 2, sy // 2, 2, sz // 2, 2, c)
  return x.transpose(0, 1, 3, 5, 2, 4, 6, 7)


def our_conv(x, kernel):
  return deconv.interleave(deconv.conv(blocks(x), kernel))


def draw(rng, *shape):
  return rng.standard_normal(shape, dtype=np.float32)


@pytest.mark.parametrize('shape', [(2, 2, 3, 4, 6), (1, 1, 1, 1, 3), (1, 5, 2, 1, 1)])
@pytest.mark.parametrize('cout', [1, 5])
@pytest.mark.parametrize(
  ('ours', 'library', 'scale'), [(our_deconv, library_deconv, 1), (our_conv, library_conv, 2)]
)
def test_value_and_gradients(ours, library, scale, shape, cout):
  rng = np.random.default_rng(0)
  b, *size, cin = shape
  x, kernel = draw(rng, b, *(scale * s for s in size), cin), draw(rng, 3, 3, 3, cin, cout)
  out, pullback = jax.vjp(jax.jit(ours), x, kernel)
  expected, expected_pullback = jax.vjp(library, x, kernel)
  cotangent = draw(rng, *out.shape)
  np.testing.assert_allclose(out, expected, rtol=1e-5, atol=1e-5)
  for got, want in zip(pullback(cotangent), expected_pullback(cotangent), strict=True):
    np.testing.assert_allclose(got, want, rtol=1e-5, atol=2e-5)


def test_interleave_places_phases():
  rng = np.random.default_rng(0)
  x = draw(rng, 2, 4, 6, 8, 3)
  phases = blocks(x)
  np.testing.assert_array_equal(phases[:, 1, 2, 3, 1, 0, 1], x[:, 3, 4, 7])
  np.testing.assert_array_equal(deconv.interleave(phases), x)
