"""Batch normalisation and the activation after it, as one function with its own gradient.

The derivative of each activation here is a function of its output, so what the backward pass keeps
is the input (the product before it keeps nothing) and the output (the next product needs it
anyway). Channels are the last axis; statistics are taken over all others.

Volumes are not normalised in a pass of their own: the next operation does it while it reads them
(deconv.py). Only the last volume is activated here.
"""

import functools
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from cvn.ops import dispatch
from cvn.ops.derivatives import with_derivatives
from cvn.ops.dispatch import Implementation

EPSILON = 1e-3  # of the authors' program


class Activation(NamedTuple):
  """A function and its derivative, the latter in terms of the function's value."""

  value: Callable[[jax.Array], jax.Array]
  slope: Callable[[jax.Array], jax.Array]
  number: np.int64  # in kernels.cc


jax.tree_util.register_static(Activation)


# exp(x) - 1 instead of expm1: within 6e-8 of it, and much faster.
ELU = Activation(
  lambda x: jnp.where(x > 0, x, jnp.exp(jnp.minimum(x, 0)) - 1),
  lambda y: jnp.where(y > 0, 1, y + 1),
  np.int64(1),
)
SIGMOID = Activation(jax.nn.sigmoid, lambda y: y * (1 - y), np.int64(2))
IDENTITY = Activation(lambda x: x, jnp.ones_like, np.int64(0))


def sum_channels(x: jax.Array) -> jax.Array:
  """The sums [2, C] of x [..., C] and of its square, in float32."""
  wide, axes = x.astype(jnp.float32), tuple(range(x.ndim - 1))
  return jnp.stack([jnp.sum(wide, axes), jnp.sum(wide * wide, axes)])


def moments(sums: jax.Array, count: jax.typing.ArrayLike) -> tuple[jax.Array, jax.Array]:
  """Mean and biased variance of each channel.

  Args:
    sums: [2, C], see `sum_channels`.
    count: of the numbers in a channel.

  Returns:
    (mean [C], variance [C]).
  """
  mean, square = sums / count
  return mean, jnp.maximum(square - mean * mean, 0)


def coefficients(
  mean: jax.Array, variance: jax.Array, gamma: jax.Array, beta: jax.Array
) -> tuple[jax.Array, jax.Array]:
  """Batch normalisation by these statistics as one product and sum.

  (x - mean) / sqrt(variance + EPSILON) * gamma + beta = scale x + shift

  Args:
    mean, variance: [C], the statistics.
    gamma, beta: [C], the parameters.

  Returns:
    (scale [C], shift [C]).
  """
  scale = gamma * jax.lax.rsqrt(variance + EPSILON)
  return scale, beta - mean * scale


def activated(
  x: jax.Array, scale: jax.Array, shift: jax.Array, activation: Activation
) -> jax.Array:
  """activation(scale x + shift), computed in float32.

  Args:
    x: [..., C].
    scale, shift: [C].
    activation: the function.

  Returns:
    [..., C], of the type of x.
  """
  z = x.astype(jnp.float32) * _spread(scale, x) + _spread(shift, x)
  return activation.value(z).astype(x.dtype)


def normalize(
  x: jax.Array,
  gamma: jax.Array,
  beta: jax.Array,
  activation: Activation,
  *,
  implementation: Implementation = 'auto',
) -> tuple[jax.Array, jax.Array, jax.Array]:
  """Normalises by the batch's own statistics.

  Args:
    x: [..., C]; other floating types than float32 are cast, also those of gamma and beta.
    gamma, beta: [C], the parameters of the batch normalisation.
    activation: applied after it.
    implementation: see dispatch.py; all but 'xla' have the gradient above.

  Returns:
    (y [..., C], mean [C], variance [C]): the variance is the biased one. No gradient flows through
    mean and variance as returned; the gradient of y accounts for them.

  Raises:
    ValueError: the implementation is unknown.
    TypeError: an array does not have floating-point numbers.
  """
  dispatch.check(implementation)
  arrays = dispatch.alike(
    dispatch.as_float('normalize: x', x),
    dispatch.as_float('normalize: gamma', gamma),
    dispatch.as_float('normalize: beta', beta),
  )
  plain = functools.partial(_normalize, activation)
  if implementation == 'xla':
    return plain(*arrays)
  return with_derivatives(
    plain,
    functools.partial(_normalize_gradient, activation),
    plain_value=plain,
    plain_gradient=lambda arrays, _, cotangents: jax.vjp(plain, *arrays)[1](cotangents),
  )(*arrays)


def activate(
  x: jax.Array,
  scale: jax.Array,
  shift: jax.Array,
  activation: Activation,
  *,
  implementation: Implementation = 'auto',
) -> jax.Array:
  """activation(scale x + shift) of a volume.

  Args:
    x: [..., X, Y, Z, C] float32 or bfloat16; other floating types are cast to float32.
    scale, shift: [C], cast to float32.
    activation: the function.
    implementation: see dispatch.py.

  Raises:
    ValueError: shapes do not fit, or the implementation is unknown.
    TypeError: an array does not have floating-point numbers.
    RuntimeError: there are no compiled kernels, which `implementation` asks for.
  """
  dispatch.check(implementation)
  shape = np.shape(x)
  if len(shape) < 4 or not np.shape(scale) == np.shape(shift) == shape[-1:]:
    raise ValueError(
      f'activate takes x [..., X, Y, Z, C] and scale and shift [C]: {shape}, {np.shape(scale)},'
      f' {np.shape(shift)}'
    )
  arrays = dispatch.alike(
    dispatch.as_float('activate: x', x, allowed=dispatch.VOLUMES).reshape(-1, *shape[-4:]),
    dispatch.as_float('activate: scale', scale),
    dispatch.as_float('activate: shift', shift),
  )
  plain = functools.partial(_plain, activation)
  if implementation == 'xla':
    (y,) = plain(*arrays)
  else:
    plain_gradient = functools.partial(_plain_gradient, activation)
    choose = functools.partial(
      dispatch.choose,
      'activated',
      implementation=implementation,
      mixed=arrays[0].dtype == jnp.bfloat16,
    )
    (y,) = with_derivatives(
      lambda *arrays: choose(functools.partial(_kernel, activation), plain, *arrays),
      lambda *groups: choose(
        functools.partial(_kernel_gradient, activation), plain_gradient, *groups
      ),
      plain_value=plain,
      plain_gradient=plain_gradient,
    )(*arrays)
  return y.reshape(shape)


def _normalize(activation, x, gamma, beta):
  mean, variance = moments(sum_channels(x), x.size // x.shape[-1])
  y = activated(x, *coefficients(mean, variance, gamma, beta), activation)
  return y, jax.lax.stop_gradient(mean), jax.lax.stop_gradient(variance)


def _normalize_gradient(activation, arrays, results, cotangents):
  (x, gamma, _), (y, mean, variance) = arrays, results
  axes, count = tuple(range(x.ndim - 1)), x.size // x.shape[-1]
  rstd = jax.lax.rsqrt(variance + EPSILON)
  # dz is the gradient before the activation; its sums are enough to find that of the input.
  dz = cotangents[0] * activation.slope(y)
  d_beta, dz_x = jnp.sum(dz, axes), jnp.sum(dz * x, axes)
  d_gamma = (dz_x - mean * d_beta) * rstd  # sum of dz times x normalised
  # dx = scale * (dz - mean(dz) - x_hat * mean(dz * x_hat)), with x_hat = (x - mean) * rstd.
  scale = gamma * rstd
  slope = -scale * rstd * d_gamma / count
  rest = -scale * d_beta / count - slope * mean
  return dz * _spread(scale, x) + x * _spread(slope, x) + _spread(rest, x), d_gamma, d_beta


def _kernel(activation, library, x, scale, shift):
  result = jax.ShapeDtypeStruct(x.shape, x.dtype)
  return dispatch.call(
    library, 'cvn_activated', [result], x, scale, shift, activation=activation.number
  )


def _kernel_gradient(activation, library, arrays, _, cotangents):
  """Those of x, scale and shift."""
  x = arrays[0]
  found = [
    jax.ShapeDtypeStruct(x.shape, x.dtype),
    jax.ShapeDtypeStruct((len(x), 2, x.shape[-1]), jnp.float32),
  ]
  dx, sums = dispatch.call(
    library, 'cvn_activated_gradient', found, *arrays, *cotangents,
    volumes=(0, 3), in_place=3, activation=activation.number,
  )  # fmt: skip
  dshift, dscale = sums.sum(0)
  return dx, dscale, dshift


def _plain(activation, x, scale, shift):
  return (activated(x, scale, shift, activation),)


def _plain_gradient(activation, arrays, _, cotangents):
  return jax.vjp(lambda *a: activated(*a, activation), *arrays)[1](*cotangents)


def _spread(v, like):
  return v.reshape((1,) * (like.ndim - 1) + (-1,))
