"""The decoder's stride-2 3x3x3 transposed convolution and the heads' 3x3x3 convolution.

Volumes are [..., X, Y, Z, C], kernels [3, 3, 3, in, out]. Along one axis, y[2 j + t] += a[j] w[t]
for the deconvolution and y[v] += a[v + t - 1] w[t] for the convolution: SAME padding of the
authors' framework. Volumes are large, and memory is what a processor waits for: so a volume is kept
as the product before it left it, x, and both read it as a = activation(scale x + shift), which is
the batch normalisation in between. They also return the sums that the next one needs.

`implementation` chooses the program (dispatch.py). In the plain one, the product is of matrices on
a CPU (matmul.py) and XLA's convolution elsewhere.

Products have float32 factors and sums. If the volume is bfloat16, the factors are too, and results
and gradients of volumes have the type of the volume. Volumes of other floating types are cast to
float32, and so are scale, shift and kernel; every gradient has the type of what was given.
"""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from cvn.ops import dispatch, matmul
from cvn.ops.derivatives import with_derivatives
from cvn.ops.dispatch import Implementation
from cvn.ops.normalization import Activation, activated, sum_channels

_DIMENSIONS = ('NXYZC', 'XYZIO', 'NXYZC')


def deconv(
  x: jax.Array,
  scale: jax.Array,
  shift: jax.Array,
  kernel: jax.Array,
  activation: Activation,
  *,
  dtype: Any = None,
  implementation: Implementation = 'auto',
) -> tuple[jax.Array, jax.Array]:
  """Stride-2 transposed convolution of activation(scale x + shift).

  Args:
    x: [..., X, Y, Z, in].
    scale, shift: [in].
    kernel: [3, 3, 3, in, out].
    activation: before the product.
    dtype: of the result, float32 or bfloat16; None for that of `x`.
    implementation: see dispatch.py.

  Returns:
    (y [..., 2X, 2Y, 2Z, out], sums [2, out] of y and of its square).

  Raises:
    ValueError: shapes do not fit, or the implementation is unknown.
    TypeError: an array does not have floating-point numbers, or `dtype` is another type.
    RuntimeError: there are no compiled kernels, which `implementation` asks for.
  """
  return _run('deconv', x, scale, shift, kernel, activation, dtype, implementation)


def conv(
  x: jax.Array,
  scale: jax.Array,
  shift: jax.Array,
  kernel: jax.Array,
  activation: Activation,
  *,
  implementation: Implementation = 'auto',
) -> tuple[jax.Array, jax.Array]:
  """Convolution of activation(scale x + shift), with zeros around it.

  Args:
    x: [..., X, Y, Z, in].
    scale, shift: [in].
    kernel: [3, 3, 3, in, out].
    activation: before the product.
    implementation: see dispatch.py.

  Returns:
    (y [..., X, Y, Z, out] float32, sums [2, out] of y and of its square).

  Raises:
    ValueError: shapes do not fit, or the implementation is unknown.
    TypeError: an array does not have floating-point numbers.
    RuntimeError: there are no compiled kernels, which `implementation` asks for.
  """
  return _run('conv', x, scale, shift, kernel, activation, jnp.float32, implementation)


def library_deconv(x: jax.Array, kernel: jax.Array) -> jax.Array:
  """The product as XLA has it: dilated input, correlated with the flipped kernel."""
  return lax.conv_general_dilated(
    x,
    kernel[::-1, ::-1, ::-1],
    (1, 1, 1),
    [(2, 1)] * 3,
    lhs_dilation=(2, 2, 2),
    dimension_numbers=_DIMENSIONS,
  )


def library_conv(x: jax.Array, kernel: jax.Array) -> jax.Array:
  """The product as XLA has it."""
  return lax.conv_general_dilated(x, kernel, (1, 1, 1), 'SAME', dimension_numbers=_DIMENSIONS)


def library_deconv_gradient(
  a: jax.Array, kernel: jax.Array, dy: jax.Array
) -> tuple[jax.Array, jax.Array]:
  """Gradients of a and kernel, by convolutions of stride 2.

  The transposed convolution is the adjoint of one of stride 2, S: <T(a, w), dy> = <a, S(dy, w)>. So
  the gradient of a is S(dy, w), and that of w is S's own. JAX's derivative of a convolution with
  dilated input is one with a dilated input and a kernel as large as the volume, for which no
  library of an accelerator has a program.

  Args:
    a: [B, X, Y, Z, in].
    kernel: [3, 3, 3, in, out].
    dy: [B, 2X, 2Y, 2Z, out], the cotangent of `library_deconv`.
  """

  def strided(w):
    dimensions = ('NXYZC', 'XYZOI', 'NXYZC')
    return lax.conv_general_dilated(dy, w, (2, 2, 2), [(0, 1)] * 3, dimension_numbers=dimensions)

  da, pull = jax.vjp(strided, kernel)
  return da, *pull(a)


def library_conv_gradient(
  a: jax.Array, kernel: jax.Array, dy: jax.Array
) -> tuple[jax.Array, jax.Array]:
  """Gradients of a and kernel, as XLA has them.

  Args:
    a: [B, X, Y, Z, in].
    kernel: [3, 3, 3, in, out].
    dy: [B, X, Y, Z, out], the cotangent of `library_conv`.
  """
  return jax.vjp(library_conv, a, kernel)[1](dy)


_LIBRARY = {
  'deconv': (library_deconv, library_deconv_gradient),
  'conv': (library_conv, library_conv_gradient),
}
_PRODUCTS = {
  'deconv': (matmul.deconv, matmul.deconv_gradient),
  'conv': (matmul.conv, matmul.conv_gradient),
}


def _run(name, x, scale, shift, kernel, activation, dtype, implementation):
  """(y, sums) of one of two programs, after the checks at the door."""
  dispatch.check(implementation)
  shapes = np.shape(x), np.shape(scale), np.shape(shift), np.shape(kernel)
  cin = shapes[0][-1:]
  if len(shapes[0]) < 4 or shapes[1:3] != (cin, cin) or shapes[3][:4] != (3, 3, 3, *cin):
    raise ValueError(
      f'{name} takes x [..., X, Y, Z, in], scale and shift [in] and a kernel [3, 3, 3, in, out]:'
      f' {", ".join(map(str, shapes))}'
    )
  x = dispatch.as_float(f'{name}: x', x, allowed=dispatch.VOLUMES)
  dtype = jnp.dtype(dtype or x.dtype)
  if dtype not in dispatch.VOLUMES:
    raise TypeError(f'{name}: the result can be float32 or bfloat16: {dtype}')
  rest = [
    dispatch.as_float(f'{name}: {what}', v)
    for what, v in (('scale', scale), ('shift', shift), ('kernel', kernel))
  ]
  arrays = dispatch.alike(x.reshape(-1, *x.shape[-4:]), *rest)

  plain = functools.partial(_plain, name, activation, dtype)
  if implementation == 'xla':
    y, sums = plain(*arrays)
  else:
    choose = functools.partial(
      dispatch.choose, name, implementation=implementation, mixed=x.dtype == jnp.bfloat16
    )
    plain_gradient = functools.partial(_plain_gradient, name, activation)
    y, sums = with_derivatives(
      lambda *arrays: choose(functools.partial(_kernel, name, activation, dtype), plain, *arrays),
      lambda *groups: choose(
        functools.partial(_kernel_gradient, name, activation), plain_gradient, *groups
      ),
      plain_value=plain,
      plain_gradient=plain_gradient,
    )(*arrays)
  return y.reshape(*x.shape[:-4], *y.shape[1:]), sums


def _kernel(name, activation, dtype, library, x, scale, shift, kernel):
  """(y, sums) of the compiled kernel."""
  b, *size, _ = x.shape
  factor, cout = 2 if name == 'deconv' else 1, kernel.shape[-1]
  results = [
    jax.ShapeDtypeStruct((b, *(factor * s for s in size), cout), dtype),
    jax.ShapeDtypeStruct((b, 2, cout), jnp.float32),
  ]
  y, sums = dispatch.call(
    library, f'cvn_{name}', results, x, scale, shift, kernel, activation=activation.number
  )
  return y, sums.sum(0)


def _kernel_gradient(name, activation, library, arrays, results, cotangents):
  """Those of x, scale, shift and kernel, of the compiled kernel."""
  (x, scale, shift, kernel), (y, _), (dy, dsums) = arrays, results, cotangents
  taps, (cin, cout) = kernel.shape[:3], kernel.shape[3:]
  order = {'deconv': (*taps, cin, cout), 'conv': (cout, *taps, cin)}[name]
  found = [
    jax.ShapeDtypeStruct(x.shape, x.dtype),
    jax.ShapeDtypeStruct((len(x), 2, cin), jnp.float32),
    jax.ShapeDtypeStruct((len(x), *order), jnp.float32),
  ]
  dx, dcoefficients, dkernel = dispatch.call(
    library, f'cvn_{name}_gradient', found, x, scale, shift, kernel, y, dy, dsums,
    volumes=(0, 4, 5), activation=activation.number,
  )  # fmt: skip
  dshift, dscale = dcoefficients.sum(0)
  dkernel = dispatch.sum_samples(dkernel)
  return dx, dscale, dshift, dkernel if name == 'deconv' else jnp.moveaxis(dkernel, 0, -1)


def _plain(name, activation, dtype, *arrays):
  """(y, sums) of plain operations."""

  def of_matrices(x, scale, shift, kernel):
    return _PRODUCTS[name][0](x, scale, shift, _rounded(kernel, x), activation, dtype)

  def of_library(x, scale, shift, kernel):
    a = activated(x, scale, shift, activation)
    y = _LIBRARY[name][0](a, kernel.astype(x.dtype)).astype(dtype)
    return y, sum_channels(y)

  return dispatch.product(of_matrices, of_library, *arrays)


def _plain_gradient(name, activation, arrays, results, cotangents):
  """Those of x, scale, shift and kernel. Makes the activations again, so that none are kept."""

  def of_matrices(x, scale, shift, kernel, y, dy, dsums):
    kernel = _rounded(kernel, x)
    return _PRODUCTS[name][1](x, scale, shift, kernel, activation, y, dy, dsums)

  def of_library(x, scale, shift, kernel, y, dy, dsums):
    first, second = dsums.reshape(2, 1, 1, 1, 1, -1)
    dy = dy.astype(jnp.float32) + first + 2 * second * y.astype(jnp.float32)
    a, pull = jax.vjp(lambda *v: activated(*v, activation), x, scale, shift)
    # The cotangent is a factor of products too.
    da, dkernel = _LIBRARY[name][1](a, kernel.astype(x.dtype), dy.astype(x.dtype))
    return *pull(da), dkernel.astype(jnp.float32)

  y, _ = results
  return dispatch.product(of_matrices, of_library, *arrays, y, *cotangents)


def _rounded(kernel, x):
  """The kernel as a factor of products with x: no more digits than x has."""
  return kernel.astype(x.dtype).astype(jnp.float32)
