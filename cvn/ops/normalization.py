"""Batch normalisation and the activation after it, as one function with its own derivative.

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

from cvn.ops import dispatch, native

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


def coefficients(mean, variance, scale, offset):
  """(gain, offset): what normalisation by these statistics multiplies with and adds, [C] all."""
  gain = scale * jax.lax.rsqrt(variance + EPSILON)
  return gain, offset - mean * gain


def activated(x, gain, offset, activation: Activation):
  """activation(gain x + offset), made in float32, of the type of x; channels last."""
  z = x.astype(jnp.float32) * _spread(gain, x) + _spread(offset, x)
  return activation.value(z).astype(x.dtype)


def affine(x, mean, variance, scale, offset, activation: Activation):
  """activation((x - mean) / sqrt(variance + EPSILON) * scale + offset), channels last."""
  return activated(x, *coefficients(mean, variance, scale, offset), activation)


@functools.partial(jax.custom_vjp, nondiff_argnums=(3,))
def normalize(x, scale, offset, activation: Activation):
  """Normalises by the batch's own statistics.

  Args:
    x: [..., C].
    scale, offset: [C], BatchNorm's gamma and beta.
    activation: applied after it.

  Returns:
    (y [..., C], mean [C], variance [C]): the variance is the biased one. No gradient flows through
    mean and variance as returned; the gradient of y accounts for them.
  """
  axes = tuple(range(x.ndim - 1))
  mean, variance = moments(jnp.stack([jnp.sum(x, axes), jnp.sum(x * x, axes)]), x)
  return affine(x, mean, variance, scale, offset, activation), mean, variance


def moments(sums, x):
  """(mean [C], biased variance [C]) of x, from the sums [2, C] of it and of its square."""
  mean, square = sums / (x.size // x.shape[-1])
  return mean, jnp.maximum(square - mean * mean, 0)


def _normalize_forward(x, scale, offset, activation):
  y, mean, variance = normalize(x, scale, offset, activation)
  return (y, mean, variance), (x, y, mean, variance, scale)


def _normalize_backward(activation, residuals, cotangents):
  x, y, mean, variance, scale = residuals
  axes, count = tuple(range(x.ndim - 1)), x.size // x.shape[-1]
  rstd = jax.lax.rsqrt(variance + EPSILON)
  # dz is the gradient before the activation; its sums are enough to find that of the input.
  dz = cotangents[0] * activation.slope(y)
  d_offset, dz_x = jnp.sum(dz, axes), jnp.sum(dz * x, axes)
  d_scale = (dz_x - mean * d_offset) * rstd  # sum of dz times x normalised
  # dx = gain * (dz - mean(dz) - x_hat * mean(dz * x_hat)), with x_hat = (x - mean) * rstd.
  gain = scale * rstd
  slope = -gain * rstd * d_scale / count
  rest = -gain * d_offset / count - slope * mean
  return dz * _spread(gain, x) + x * _spread(slope, x) + _spread(rest, x), d_scale, d_offset


normalize.defvjp(_normalize_forward, _normalize_backward)


@functools.partial(jax.custom_vjp, nondiff_argnums=(3,))
def activate(x, gain, offset, activation: Activation):
  """The same of a volume [B, X, Y, Z, C]."""

  def kernel(*arrays):
    result = jax.ShapeDtypeStruct(x.shape, x.dtype)
    return dispatch.call('cvn_activated', [result], *arrays, activation=activation.number)[0]

  def loops(*arrays):
    return activated(*arrays, activation)

  return _by_platform(kernel, loops, x, gain, offset)


def _activate_forward(x, gain, offset, activation):
  return activate(x, gain, offset, activation), (x, gain, offset)


def _activate_backward(activation, residuals, dy):
  def kernel(x, gain, offset, dy):
    results = [
      jax.ShapeDtypeStruct(x.shape, x.dtype),
      jax.ShapeDtypeStruct((len(x), 2, x.shape[-1]), jnp.float32),
    ]
    dx, sums = dispatch.call(
      'cvn_activated_gradient', results, x, gain, offset, dy,
      volumes=(0, 3), in_place=3, activation=activation.number,
    )  # fmt: skip
    doffset, dgain = sums.sum(0)
    return dx, dgain, doffset

  def loops(x, gain, offset, dy):
    return jax.vjp(lambda *a: activated(*a, activation), x, gain, offset)[1](dy)

  return _by_platform(kernel, loops, *residuals, dy)


activate.defvjp(_activate_forward, _activate_backward)


def _by_platform(kernel, loops, *arrays):
  """The compiled kernel on a CPU that has it, loops of the compiler's elsewhere."""

  def on_cpu(*arrays):
    return (kernel if native.available() else loops)(*arrays)

  return jax.lax.platform_dependent(*arrays, cpu=on_cpu, default=loops)


def _spread(v, like):
  return v.reshape((1,) * (like.ndim - 1) + (-1,))
