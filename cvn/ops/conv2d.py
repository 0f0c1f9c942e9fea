"""The encoder's convolution of stride 2: [B, H, W, in] -> [B, H / 2, W / 2, out], SAME padding.

On a CPU the compiled kernels (native.py) compute it if they are available and take its shape: XLA's
gradients are several times slower there. Everywhere else XLA computes it. The choice is made when
the function is lowered.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from cvn.ops import dispatch, native

_LANES = 16  # numbers in a vector of kernels/common.h


@functools.partial(jax.custom_vjp, nondiff_argnums=(2,))
def conv2d(x: jax.Array, kernel: jax.Array, mixed: bool = False) -> jax.Array:
  """[B, H, W, in], [size, size, in, out] -> [B, H / 2, W / 2, out], all float32.

  Args:
    x: H and W are even.
    kernel: of the size 2 or more.
    mixed: whether factors of products may be rounded to bfloat16, where that is faster.
  """

  def kernels(x, kernel):
    b, h, w, _ = x.shape
    y = jax.ShapeDtypeStruct((b, h // 2, w // 2, kernel.shape[-1]), jnp.float32)
    return dispatch.call('cvn_conv2d', [y], x, kernel, mixed=np.bool_(mixed))[0]

  return _by_platform(kernels, library_conv2d, kernel.shape, x, kernel)


def library_conv2d(x: jax.Array, kernel: jax.Array) -> jax.Array:
  """The same as the library has it."""
  return lax.conv_general_dilated(
    x, kernel, (2, 2), 'SAME', dimension_numbers=('NHWC', 'HWIO', 'NHWC')
  )


def _forward(x, kernel, mixed):
  return conv2d(x, kernel, mixed), (x, kernel)


def _backward(mixed, residuals, dy):
  x, kernel = residuals
  flag = np.bool_(mixed)

  def input_kernel(dy, kernel):
    dx = jax.ShapeDtypeStruct(x.shape, x.dtype)
    return dispatch.call('cvn_conv2d_input_gradient', [dx], dy, kernel, mixed=flag)[0]

  def input_library(dy, kernel):
    return jax.vjp(lambda x: library_conv2d(x, kernel), jnp.zeros_like(x))[1](dy)[0]

  def kernel_kernel(x, dy):
    terms = jax.ShapeDtypeStruct((len(x), *kernel.shape), jnp.float32)
    name = 'cvn_conv2d_kernel_gradient'
    return dispatch.sum_samples(dispatch.call(name, [terms], x, dy, volumes=(0, 1), mixed=flag)[0])

  def kernel_library(x, dy):
    return jax.vjp(lambda k: library_conv2d(x, k), jnp.zeros_like(kernel))[1](dy)[0]

  # Apart, so that a gradient that nobody needs is not made.
  return (
    _by_platform(input_kernel, input_library, kernel.shape, dy, kernel),
    _by_platform(kernel_kernel, kernel_library, kernel.shape, x, dy),
  )


conv2d.defvjp(_forward, _backward)


def _by_platform(kernels, library, shape, *arrays):
  """Calls one of two programs for the same thing, for a kernel of that shape."""

  def on_cpu(*arrays):
    fits = shape[-1] % _LANES == 0
    return (kernels if fits and native.available() else library)(*arrays)

  return lax.platform_dependent(*arrays, cpu=on_cpu, default=library)
