"""The stride-2 3x3x3 transposed convolution of the decoder and the 3x3x3 convolution of the heads.

Volumes are [B, X, Y, Z, C], kernels [3, 3, 3, in, out]. Along one axis, y[2 j + t] += x[j] w[t] for
the deconvolution and o[v] += x[v + t - 1] w[t] for the convolution: SAME padding of the authors'
framework. Which program computes them is decided when the function is lowered: on a CPU the
compiled kernels (cvn/native.py) or, where these are missing, matrix products (cvn/phases.py);
elsewhere the library's convolution. Derivatives are those of the same program.

Kernels are float32, and so is every sum. Where the input is bfloat16, so are all factors of
products; results and gradients of volumes have the type of the volume.
"""

import functools

import jax
import jax.numpy as jnp
from jax import lax

from cvn import native, phases

_DIMENSIONS = ('NXYZC', 'XYZIO', 'NXYZC')


@functools.partial(jax.custom_vjp, nondiff_argnums=(2,))
def deconv(x: jax.Array, kernel: jax.Array, dtype=None) -> jax.Array:
  """Stride-2 transposed convolution: [B, X, Y, Z, in] -> [B, 2X, 2Y, 2Z, out].

  Args:
    x: [B, X, Y, Z, in] float32 or bfloat16.
    kernel: [3, 3, 3, in, out] float32.
    dtype: of the result; None for that of `x`.
  """

  def kernels(x, kernel):
    b, *size, _ = x.shape
    result = jax.ShapeDtypeStruct((b, *(2 * s for s in size), kernel.shape[-1]), dtype or x.dtype)
    return native.call('cvn_deconv', [result], x, kernel)[0]

  return _by_platform(kernels, phases.deconv, library_deconv, dtype, x, kernel)


@functools.partial(jax.custom_vjp, nondiff_argnums=())
def conv(x: jax.Array, kernel: jax.Array) -> jax.Array:
  """Convolution with zeros around: [B, X, Y, Z, in] -> [B, X, Y, Z, out] float32.

  Args:
    x: [B, X, Y, Z, in] float32 or bfloat16.
    kernel: [3, 3, 3, in, out] float32.
  """

  def kernels(x, kernel):
    result = jax.ShapeDtypeStruct((*x.shape[:-1], kernel.shape[-1]), jnp.float32)
    return native.call('cvn_conv', [result], x, kernel)[0]

  return _by_platform(kernels, phases.conv, library_conv, jnp.float32, x, kernel)


def library_deconv(x: jax.Array, kernel: jax.Array) -> jax.Array:
  """The same as the library has it: dilated input, correlated with the flipped kernel."""
  return lax.conv_general_dilated(
    x,
    kernel[::-1, ::-1, ::-1],
    (1, 1, 1),
    [(2, 1)] * 3,
    lhs_dilation=(2, 2, 2),
    dimension_numbers=_DIMENSIONS,
  )


def library_conv(x: jax.Array, kernel: jax.Array) -> jax.Array:
  """The same as the library has it."""
  return lax.conv_general_dilated(x, kernel, (1, 1, 1), 'SAME', dimension_numbers=_DIMENSIONS)


def _deconv_forward(x, kernel, dtype):
  return deconv(x, kernel, dtype), (x, kernel)


def _deconv_backward(dtype, residuals, dy):
  del dtype

  def kernels(x, kernel, dy):
    results = [_like(x), jax.ShapeDtypeStruct((len(x), *kernel.shape), jnp.float32)]
    dx, dkernel = native.call('cvn_deconv_gradient', results, x, kernel, dy, volumes=(0, 2))
    return dx, _sum_samples(dkernel)

  return _gradient_by_platform(kernels, phases.deconv, library_deconv, *residuals, dy)


def _conv_forward(x, kernel):
  return conv(x, kernel), (x, kernel)


def _conv_backward(residuals, dy):
  def kernels(x, kernel, dy):
    shape = (len(x), kernel.shape[-1], *kernel.shape[:-1])
    results = [_like(x), jax.ShapeDtypeStruct(shape, jnp.float32)]
    dx, dkernel = native.call(
      'cvn_conv_gradient', results, x, kernel, dy, volumes=(0, 2), in_place=0
    )
    return dx, jnp.moveaxis(_sum_samples(dkernel), 0, -1)

  return _gradient_by_platform(kernels, phases.conv, library_conv, *residuals, dy)


deconv.defvjp(_deconv_forward, _deconv_backward)
conv.defvjp(_conv_forward, _conv_backward)


def _by_platform(kernels, products, library, dtype, x, kernel):
  """Calls one of three programs for the same thing; the result's type is `dtype` or that of x."""

  def on_cpu(x, kernel):
    if native.available():
      return kernels(x, kernel)
    return products(*_rounded(x, kernel)).astype(dtype or x.dtype)

  def elsewhere(x, kernel):
    return library(x, kernel.astype(x.dtype)).astype(dtype or x.dtype)

  return lax.platform_dependent(x, kernel, cpu=on_cpu, default=elsewhere)


def _gradient_by_platform(kernels, products, library, x, kernel, dy):
  """Calls one of three programs for the gradients of x and kernel."""

  def on_cpu(x, kernel, dy):
    if native.available():
      return kernels(x, kernel, dy)
    wide, kernel, dy = _rounded(x, kernel, dy)
    dx, dkernel = jax.vjp(products, wide, kernel)[1](dy)
    return dx.astype(x.dtype), dkernel

  def elsewhere(x, kernel, dy):
    dx, dkernel = jax.vjp(library, x, kernel.astype(x.dtype))[1](dy.astype(x.dtype))
    return dx, dkernel.astype(jnp.float32)

  return lax.platform_dependent(x, kernel, dy, cpu=on_cpu, default=elsewhere)


def _rounded(x, *others):
  """All as float32, with no more digits than x has."""
  return [a.astype(x.dtype).astype(jnp.float32) for a in (x, *others)]


def _sum_samples(x):
  """x.sum(0), as a product: the compiler's own sum over the first axis is slow."""
  return (jnp.ones((1, len(x))) @ x.reshape(len(x), -1)).reshape(x.shape[1:])


def _like(x):
  return jax.ShapeDtypeStruct(x.shape, x.dtype)
