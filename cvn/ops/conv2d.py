"""The encoder's convolution of stride 2: [..., H, W, in] -> [..., H / 2, W / 2, out], SAME padding.

On a CPU the compiled kernels (native.py) compute it if they are available and take its shape: XLA's
gradients are several times slower there. XLA's convolution is the plain program on every platform.
`implementation` chooses (dispatch.py).
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from cvn.ops import dispatch
from cvn.ops.derivatives import with_derivatives
from cvn.ops.dispatch import Implementation

_CHANNELS = 16  # the kernels take multiples


def conv2d(
  x: jax.Array,
  kernel: jax.Array,
  *,
  mixed: bool = False,
  implementation: Implementation = 'auto',
) -> jax.Array:
  """[..., H, W, in], [size, size, in, out] -> [..., H / 2, W / 2, out] float32.

  Args:
    x: H and W are even. Other floating types than float32 are cast, also those of `kernel`.
    kernel: of the size 2 or more.
    mixed: whether factors of products may be rounded to bfloat16, where that is faster.
    implementation: see dispatch.py.

  Raises:
    ValueError: shapes do not fit, or the implementation is unknown.
    TypeError: an array does not have floating-point numbers.
    RuntimeError: there are no compiled kernels, which `implementation` asks for.
  """
  dispatch.check(implementation)
  shape, taps = np.shape(x), np.shape(kernel)
  if len(shape) < 3 or len(taps) != 4 or taps[2] != shape[-1] or shape[-3] % 2 or shape[-2] % 2:
    raise ValueError(
      f'conv2d takes x [..., H, W, in], H and W even, and a kernel [size, size, in, out]:'
      f' {shape}, {taps}'
    )
  x, kernel = dispatch.alike(
    dispatch.as_float('conv2d: x', x).reshape(-1, *shape[-3:]),
    dispatch.as_float('conv2d: kernel', kernel),
  )
  if implementation == 'xla':
    y = library_conv2d(x, kernel)
  else:
    out = taps[-1]
    choose = functools.partial(
      dispatch.choose,
      'conv2d',
      implementation=implementation,
      mixed=mixed,
      misfit=f'out of conv2d is no multiple of {_CHANNELS}: {out}' if out % _CHANNELS else '',
    )
    (y,) = with_derivatives(
      lambda *arrays: choose(functools.partial(_kernel, mixed), _plain, *arrays),
      functools.partial(_gradient, choose, mixed),
      plain_value=_plain,
      plain_gradient=_plain_gradient,
    )(x, kernel)
  return y.reshape(*shape[:-3], *y.shape[1:])


def library_conv2d(x: jax.Array, kernel: jax.Array) -> jax.Array:
  """The same as XLA has it."""
  return lax.conv_general_dilated(
    x, kernel, (2, 2), 'SAME', dimension_numbers=('NHWC', 'HWIO', 'NHWC')
  )


def _kernel(mixed, library, x, kernel):
  b, h, w, _ = x.shape
  y = jax.ShapeDtypeStruct((b, h // 2, w // 2, kernel.shape[-1]), jnp.float32)
  return dispatch.call(library, 'cvn_conv2d', [y], x, kernel, mixed=np.bool_(mixed))


def _gradient(choose, mixed, arrays, _, cotangents):
  """Those of x and kernel, each a call of its own: one that nobody needs is not made."""

  call = functools.partial(dispatch.call, mixed=np.bool_(mixed))

  def of_x(library, x, kernel, dy):
    dx = jax.ShapeDtypeStruct(x.shape, x.dtype)
    return call(library, 'cvn_conv2d_input_gradient', [dx], dy, kernel)[0]

  def of_kernel(library, x, kernel, dy):
    terms = jax.ShapeDtypeStruct((len(x), *kernel.shape), jnp.float32)
    found = call(library, 'cvn_conv2d_kernel_gradient', [terms], x, dy, volumes=(0, 1))
    return dispatch.sum_samples(found[0])

  def plain(number, *operands):
    return _plain_gradient(operands[:2], None, operands[2:])[number]

  return tuple(
    choose(program, functools.partial(plain, number), *arrays, *cotangents)
    for number, program in enumerate((of_x, of_kernel))
  )


def _plain(x, kernel):
  return (library_conv2d(x, kernel),)


def _plain_gradient(arrays, _, cotangents):
  return jax.vjp(library_conv2d, *arrays)[1](*cotangents)
