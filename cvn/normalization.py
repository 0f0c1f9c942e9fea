"""Batch normalisation and the activation after it, as one function with its own derivative.

The derivative of each activation here is a function of its output, so what the backward pass keeps
is the input (the product before it keeps nothing) and the output (the next product needs it
anyway). Channels are the last axis; statistics are taken over all others.

Volumes are large, and memory is what a CPU waits for: there the compiled kernels (cvn/native.py),
where they are at hand, go over a volume half as often as the compiler's own loops do.
"""

import functools
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from cvn import native

EPSILON = 1e-3  # of the authors' program


class Activation(NamedTuple):
  """A function and its derivative, the latter in terms of the function's value."""

  value: Callable[[jax.Array], jax.Array]
  slope: Callable[[jax.Array], jax.Array]
  number: np.int64  # in kernels.cc


# exp(x) - 1 instead of expm1: within 6e-8 of it, and much faster.
ELU = Activation(
  lambda x: jnp.where(x > 0, x, jnp.exp(jnp.minimum(x, 0)) - 1),
  lambda y: jnp.where(y > 0, 1, y + 1),
  np.int64(1),
)
SIGMOID = Activation(jax.nn.sigmoid, lambda y: y * (1 - y), np.int64(2))
IDENTITY = Activation(lambda x: x, jnp.ones_like, np.int64(0))


def affine(x, mean, variance, scale, offset, activation: Activation):
  """activation((x - mean) / sqrt(variance + EPSILON) * scale + offset), channels last."""
  gain = scale * jax.lax.rsqrt(variance + EPSILON)
  return _activated(x, gain, offset - mean * gain, activation)


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
  mean, square = _sums(x) / (x.size // x.shape[-1])
  variance = jnp.maximum(square - mean * mean, 0)
  return affine(x, mean, variance, scale, offset, activation), mean, variance


def _normalize_forward(x, scale, offset, activation):
  y, mean, variance = normalize(x, scale, offset, activation)
  return (y, mean, variance), (x, y, mean, variance, scale, offset)


def _normalize_backward(activation, residuals, cotangents):
  x, y, mean, variance, scale, offset = residuals
  dy = cotangents[0]
  count = x.size // x.shape[-1]
  rstd = jax.lax.rsqrt(variance + EPSILON)
  gain = scale * rstd
  constant = offset - mean * gain
  # dz is the gradient before the activation; its sums are enough to find that of the input.
  d_offset, dz_x = _gradient_sums(x, y, dy, gain, constant, activation)
  d_scale = (dz_x - mean * d_offset) * rstd  # sum of dz times x normalised
  # dx = gain * (dz - mean(dz) - x_hat * mean(dz * x_hat)), with x_hat = (x - mean) * rstd.
  slope = -gain * rstd * d_scale / count
  rest = -gain * d_offset / count - slope * mean
  return _input_gradient(x, y, dy, gain, constant, slope, rest, activation), d_scale, d_offset


normalize.defvjp(_normalize_forward, _normalize_backward)


def _sums(x):
  """Sums [2, C] of x and of its square."""

  def kernel(x):
    return native.call('cvn_moments', [_sums_of(x)], x)[0].sum(0)

  def loops(x):
    axes = tuple(range(x.ndim - 1))
    x = x.astype(jnp.float32)
    return jnp.stack([jnp.sum(x, axes), jnp.sum(x * x, axes)])

  return _by_platform(kernel, loops, x)


def _activated(x, gain, offset, activation):
  """activation(gain x + offset), of the type of x."""

  def kernel(x, *vectors):
    return native.call('cvn_activated', [_like(x)], x, *vectors, activation=activation.number)[0]

  def loops(x, gain, offset):
    return activation.value(x * _spread(gain, x) + _spread(offset, x)).astype(x.dtype)

  return _by_platform(kernel, loops, x, gain, offset)


def _gradient_sums(x, y, dy, gain, offset, activation):
  """Sums [2, C] of dz and of dz x, for y = activation(gain x + offset)."""

  def kernel(x, y, dy, *vectors):
    arrays, number = (x, dy, *vectors), activation.number
    results = [_sums_of(x)]
    sums = native.call('cvn_gradient_sums', results, *arrays, volumes=(0, 1), activation=number)
    return sums[0].sum(0)

  def loops(x, y, dy, gain, offset):
    axes = tuple(range(x.ndim - 1))
    x, y, dy = (v.astype(jnp.float32) for v in (x, y, dy))
    dz = dy * activation.slope(y)
    return jnp.stack([jnp.sum(dz, axes), jnp.sum(dz * x, axes)])

  return _by_platform(kernel, loops, x, y, dy, gain, offset)


def _input_gradient(x, y, dy, gain, offset, slope, rest, activation):
  """gain dz + slope x + rest, of the type of x."""

  def kernel(x, y, dy, *vectors):
    arrays, number = (x, dy, *vectors), activation.number
    results = [_like(x)]
    dx = native.call(
      'cvn_input_gradient', results, *arrays, volumes=(0, 1), in_place=1, activation=number
    )
    return dx[0]

  def loops(x, y, dy, gain, offset, slope, rest):
    dz = dy.astype(jnp.float32) * activation.slope(y.astype(jnp.float32))
    dx = dz * _spread(gain, x) + x * _spread(slope, x) + _spread(rest, x)
    return dx.astype(x.dtype)

  return _by_platform(kernel, loops, x, y, dy, gain, offset, slope, rest)


def _sums_of(x):
  return jax.ShapeDtypeStruct((len(x), 2, x.shape[-1]), jnp.float32)


def _like(x):
  return jax.ShapeDtypeStruct(x.shape, x.dtype)


def _by_platform(kernel, loops, x, *others):
  """The compiled kernel for volumes on a CPU that has it, loops of the compiler's elsewhere."""
  if x.ndim != 5:
    return loops(x, *others)

  def on_cpu(*arrays):
    return (kernel if native.available() else loops)(*arrays)

  return jax.lax.platform_dependent(x, *others, cpu=on_cpu, default=loops)


def _spread(v, like):
  return v.reshape((1,) * (like.ndim - 1) + (-1,))
