"""The decoder's stride-2 3x3x3 transposed convolution and the heads' 3x3x3 convolution.

Volumes are [B, X, Y, Z, C], kernels [3, 3, 3, in, out]. Along one axis, y[2 j + t] += a[j] w[t] for
the deconvolution and y[v] += a[v + t - 1] w[t] for the convolution: SAME padding of the authors'
framework. Volumes are large, and memory is what a processor waits for: so a volume is kept as the
product before it left it, x, and both read it as a = activation(gain x + offset), which is the
batch normalisation in between. They also return the sums that the next one needs.

Which program computes them is decided when the function is lowered: on a CPU the compiled kernels
(native.py) or, where these are missing, matrix products (matmul.py); elsewhere the
library's convolution. Derivatives are those of the same program.

Kernels are float32, and so is every sum. Where the input is bfloat16, so are all factors of
products; results and gradients of volumes have the type of the volume.
"""

import functools

import jax
import jax.numpy as jnp
from jax import lax

from cvn.ops import dispatch, matmul, native
from cvn.ops.normalization import Activation, activated

_DIMENSIONS = ('NXYZC', 'XYZIO', 'NXYZC')


@functools.partial(jax.custom_vjp, nondiff_argnums=(4, 5))
def deconv(
  x: jax.Array,
  gain: jax.Array,
  offset: jax.Array,
  kernel: jax.Array,
  activation: Activation,
  dtype=None,
) -> tuple[jax.Array, jax.Array]:
  """Stride-2 transposed convolution of activation(gain x + offset).

  Args:
    x: [B, X, Y, Z, in] float32 or bfloat16.
    gain, offset: [in].
    kernel: [3, 3, 3, in, out] float32.
    activation: before the product.
    dtype: of the result; None for that of `x`.

  Returns:
    (y [B, 2X, 2Y, 2Z, out], sums [2, out] of y and of its square).
  """
  shape = (len(x), *(2 * s for s in x.shape[1:4]), kernel.shape[-1])
  y = jax.ShapeDtypeStruct(shape, dtype or x.dtype)
  return _forward('deconv', y, x, gain, offset, kernel, activation)


@functools.partial(jax.custom_vjp, nondiff_argnums=(4,))
def conv(
  x: jax.Array, gain: jax.Array, offset: jax.Array, kernel: jax.Array, activation: Activation
) -> tuple[jax.Array, jax.Array]:
  """Convolution of activation(gain x + offset), with zeros around it.

  Args:
    x: [B, X, Y, Z, in] float32 or bfloat16.
    gain, offset: [in].
    kernel: [3, 3, 3, in, out] float32.
    activation: before the product.

  Returns:
    (y [B, X, Y, Z, out] float32, sums [2, out] of y and of its square).
  """
  y = jax.ShapeDtypeStruct((*x.shape[:-1], kernel.shape[-1]), jnp.float32)
  return _forward('conv', y, x, gain, offset, kernel, activation)


def library_deconv(x: jax.Array, kernel: jax.Array) -> jax.Array:
  """The product as the library has it: dilated input, correlated with the flipped kernel."""
  return lax.conv_general_dilated(
    x,
    kernel[::-1, ::-1, ::-1],
    (1, 1, 1),
    [(2, 1)] * 3,
    lhs_dilation=(2, 2, 2),
    dimension_numbers=_DIMENSIONS,
  )


def library_conv(x: jax.Array, kernel: jax.Array) -> jax.Array:
  """The product as the library has it."""
  return lax.conv_general_dilated(x, kernel, (1, 1, 1), 'SAME', dimension_numbers=_DIMENSIONS)


def _deconv_forward(x, gain, offset, kernel, activation, dtype):
  y, sums = deconv(x, gain, offset, kernel, activation, dtype)
  return (y, sums), (x, gain, offset, kernel, y)


def _deconv_backward(activation, dtype, residuals, cotangents):
  del dtype
  *inputs, y = residuals
  return _gradients('deconv', activation, inputs, y, cotangents)


def _conv_forward(x, gain, offset, kernel, activation):
  y, sums = conv(x, gain, offset, kernel, activation)
  return (y, sums), (x, gain, offset, kernel, y)


def _conv_backward(activation, residuals, cotangents):
  *inputs, y = residuals
  return _gradients('conv', activation, inputs, y, cotangents)


deconv.defvjp(_deconv_forward, _deconv_backward)
conv.defvjp(_conv_forward, _conv_backward)


_LIBRARY = {'deconv': library_deconv, 'conv': library_conv}
_PRODUCTS = {
  'deconv': (matmul.deconv, matmul.deconv_gradient),
  'conv': (matmul.conv, matmul.conv_gradient),
}


def _forward(name, y, *arguments):
  """(y, sums) of one of three programs; `y` tells its shape and type."""
  *arrays, activation = arguments

  def kernels(x, gain, offset, kernel):
    results = [y, jax.ShapeDtypeStruct((len(x), 2, y.shape[-1]), jnp.float32)]
    out, sums = dispatch.call(
      f'cvn_{name}', results, x, gain, offset, kernel, activation=activation.number
    )
    return out, sums.sum(0)

  def products(x, gain, offset, kernel):
    kernel = kernel.astype(x.dtype).astype(jnp.float32)
    return _PRODUCTS[name][0](x, gain, offset, kernel, activation, y.dtype)

  def library(x, gain, offset, kernel):
    a = activated(x, gain, offset, activation)
    out = _LIBRARY[name](a, kernel.astype(x.dtype)).astype(y.dtype)
    wide, axes = out.astype(jnp.float32), (0, 1, 2, 3)
    return out, jnp.stack([jnp.sum(wide, axes), jnp.sum(wide * wide, axes)])

  return by_platform(kernels, products, library, *arrays)


def _gradients(name, activation, inputs, y, cotangents):
  """Those of x, gain, offset and kernel, of one of three programs."""

  def kernels(x, gain, offset, kernel, y, dy, dsums):
    taps, (cin, cout) = kernel.shape[:3], kernel.shape[3:]
    order = {'deconv': (*taps, cin, cout), 'conv': (cout, *taps, cin)}[name]
    results = [
      jax.ShapeDtypeStruct(x.shape, x.dtype),
      jax.ShapeDtypeStruct((len(x), 2, cin), jnp.float32),
      jax.ShapeDtypeStruct((len(x), *order), jnp.float32),
    ]
    dx, dcoefficients, dkernel = dispatch.call(
      f'cvn_{name}_gradient', results, x, gain, offset, kernel, y, dy, dsums,
      volumes=(0, 4, 5), activation=activation.number,
    )  # fmt: skip
    doffset, dgain = dcoefficients.sum(0)
    dkernel = dispatch.sum_samples(dkernel)
    return dx, dgain, doffset, dkernel if name == 'deconv' else jnp.moveaxis(dkernel, 0, -1)

  def products(x, gain, offset, kernel, *results):
    kernel = kernel.astype(x.dtype).astype(jnp.float32)
    return _PRODUCTS[name][1](x, gain, offset, kernel, activation, *results)

  def library(x, gain, offset, kernel, y, dy, dsums):
    first, second = dsums.reshape(2, 1, 1, 1, 1, -1)
    dy = dy.astype(jnp.float32) + first + 2 * second * y.astype(jnp.float32)

    def value(x, gain, offset, kernel):
      return _LIBRARY[name](activated(x, gain, offset, activation), kernel)

    out, pull = jax.vjp(value, x, gain, offset, kernel.astype(x.dtype))
    *gradients, dkernel = pull(dy.astype(out.dtype))
    return *gradients, dkernel.astype(jnp.float32)

  return by_platform(kernels, products, library, *inputs, y, *cotangents)


def by_platform(kernels, products, library, *arrays):
  """Calls one of three programs for the same thing, whose choice is made when it is lowered."""

  def on_cpu(*arrays):
    return (kernels if native.available() else products)(*arrays)

  return lax.platform_dependent(*arrays, cpu=on_cpu, default=library)
