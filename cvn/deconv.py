"""The stride-2 3x3x3 transposed convolution of the decoder and the 3x3x3 convolution of the heads.

Volumes are [B, X, Y, Z, C], kernels [3, 3, 3, in, out]. Along one axis, y[2 j + t] += x[j] w[t] for
the deconvolution and o[v] += x[v + t - 1] w[t] for the convolution: SAME padding of the authors'
framework. Which program computes them is decided when the function is lowered: on a CPU the
compiled kernels (cvn/native.py) or, where these are missing, matrix products (cvn/phases.py);
elsewhere the library's convolution. Derivatives are those of the same program.

With `mixed`, the factors of every product are rounded to bfloat16; sums and results are float32.
"""

import functools

import jax
import jax.numpy as jnp
from jax import lax

from cvn import native, phases

_DIMENSIONS = ('NXYZC', 'XYZIO', 'NXYZC')


@functools.partial(jax.custom_vjp, nondiff_argnums=(2,))
def deconv(x: jax.Array, kernel: jax.Array, mixed: bool = False) -> jax.Array:
  """Stride-2 transposed convolution: [B, X, Y, Z, in] -> [B, 2X, 2Y, 2Z, out].

  Args:
    x: [B, X, Y, Z, in] float32.
    kernel: [3, 3, 3, in, out] float32.
    mixed: whether products are of bfloat16.
  """
  return _by_platform(_native_deconv, phases.deconv, library_deconv, mixed, x, kernel)


@functools.partial(jax.custom_vjp, nondiff_argnums=(2,))
def conv(x: jax.Array, kernel: jax.Array, mixed: bool = False) -> jax.Array:
  """Convolution with zeros around: [B, X, Y, Z, in] -> [B, X, Y, Z, out].

  Args:
    x: [B, X, Y, Z, in] float32.
    kernel: [3, 3, 3, in, out] float32.
    mixed: whether products are of bfloat16.
  """
  return _by_platform(_native_conv, phases.conv, library_conv, mixed, x, kernel)


def library_deconv(x: jax.Array, kernel: jax.Array) -> jax.Array:
  """The same as the library has it: dilated input, correlated with the flipped kernel."""
  return lax.conv_general_dilated(
    x,
    kernel[::-1, ::-1, ::-1],
    (1, 1, 1),
    [(2, 1)] * 3,
    lhs_dilation=(2, 2, 2),
    dimension_numbers=_DIMENSIONS,
    preferred_element_type=jnp.float32,
  )


def library_conv(x: jax.Array, kernel: jax.Array) -> jax.Array:
  """The same as the library has it."""
  return lax.conv_general_dilated(
    x,
    kernel,
    (1, 1, 1),
    'SAME',
    dimension_numbers=_DIMENSIONS,
    preferred_element_type=jnp.float32,
  )


def _deconv_forward(x, kernel, mixed):
  return deconv(x, kernel, mixed), (x, kernel)


def _deconv_backward(mixed, residuals, dy):
  return _by_platform(
    _native_deconv_gradient,
    _gradient_of(phases.deconv),
    _gradient_of(library_deconv),
    mixed,
    *residuals,
    dy,
  )


def _conv_forward(x, kernel, mixed):
  return conv(x, kernel, mixed), (x, kernel)


def _conv_backward(mixed, residuals, dy):
  return _by_platform(
    _native_conv_gradient,
    _gradient_of(phases.conv),
    _gradient_of(library_conv),
    mixed,
    *residuals,
    dy,
  )


deconv.defvjp(_deconv_forward, _deconv_backward)
conv.defvjp(_conv_forward, _conv_backward)


def _by_platform(kernels, products, library, mixed, *arrays):
  """Calls one of three programs for the same thing."""

  def rounded(function):
    def call(*arrays):
      # On an accelerator, as bfloat16: its own units multiply them.
      return function(*(a.astype(jnp.bfloat16) if mixed else a for a in arrays))

    return call

  def on_cpu(*arrays):
    if native.available():
      return kernels(*arrays, mixed=mixed)
    if mixed:
      arrays = [lax.reduce_precision(a, exponent_bits=8, mantissa_bits=7) for a in arrays]
    return products(*arrays)

  return lax.platform_dependent(*arrays, cpu=on_cpu, default=rounded(library))


def _gradient_of(function):
  """(x, kernel, dy) -> (dx, dkernel), float32."""

  def gradient(x, kernel, dy):
    _, pull = jax.vjp(function, x, kernel)
    return tuple(g.astype(jnp.float32) for g in pull(dy.astype(jnp.float32)))

  return gradient


def _native_deconv(x, kernel, mixed):
  b, *size, _ = x.shape
  shape = (b, *(2 * s for s in size), kernel.shape[-1])
  return native.call('cvn_deconv', [shape], x, kernel, mixed=mixed)[0]


def _native_deconv_gradient(x, kernel, dy, mixed):
  shapes = [x.shape, (len(x), *kernel.shape)]
  dx, dkernel = native.call('cvn_deconv_gradient', shapes, x, kernel, dy, mixed=mixed)
  return dx, dkernel.sum(0)


def _native_conv(x, kernel, mixed):
  shape = (*x.shape[:-1], kernel.shape[-1])
  return native.call('cvn_conv', [shape], x, kernel, mixed=mixed)[0]


def _native_conv_gradient(x, kernel, dy, mixed):
  shapes = [x.shape, (len(x), kernel.shape[-1], *kernel.shape[:-1])]
  dx, dkernel = native.call('cvn_conv_gradient', shapes, x, kernel, dy, mixed=mixed)
  return dx, jnp.moveaxis(dkernel.sum(0), 0, -1)
