"""Layers: a linear map and a bias, then batch normalisation, then an activation.

Every layer of the authors' program has this form, the last ones included (epsilon 1e-3, biased
batch variance). In training the collection `batch_stats` that `apply` returns holds the statistics
of this batch alone; `cvn.train` folds them into running averages, whose decay is the recipe's.
Volumes are handed on as pre-activations with their pending normalisation, which the next operation
applies while it reads them (cvn/ops/deconv.py).
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from flax import linen as nn

from cvn.ops import conv2d, deconv
from cvn.ops.normalization import (
  ELU,
  IDENTITY,
  Activation,
  activate,
  activated,
  coefficients,
  moments,
  normalize,
)

_glorot = nn.initializers.glorot_uniform()


class PendingNorm(NamedTuple):
  """A pre-activation x with its pending batch-norm scale and shift: activation(scale x + shift)."""

  x: jax.Array  # [..., X, Y, Z, C]
  scale: jax.Array  # [C]
  shift: jax.Array  # [C]
  activation: Activation


def as_pending(x: jax.Array) -> PendingNorm:
  """Wraps an array: nothing is pending."""
  c = x.shape[-1]
  return PendingNorm(x, jnp.ones(c, jnp.float32), jnp.zeros(c, jnp.float32), IDENTITY)


def materialize(volume: PendingNorm, *, implementation: str = 'auto') -> jax.Array:
  """The activations of a volume; for `implementation` see cvn/ops/dispatch.py."""
  return activate(*volume, implementation=implementation)


class Norm(nn.Module):
  """Batch normalisation over all axes but the last, then the activation.

  A bias in front of it, which the layers have, only moves the mean: it is not added in training.
  """

  activation: Activation
  implementation: str = 'auto'

  @nn.compact
  def __call__(self, x: jax.Array, bias: jax.Array, train: bool) -> jax.Array:
    gamma, beta, mean, variance = _norm_variables(self, x.shape[-1:])
    if not train:
      scale, shift = coefficients(mean.value - bias, variance.value, gamma, beta)
      return activated(x, scale, shift, self.activation)
    y, batch_mean, batch_variance = normalize(
      x, gamma, beta, self.activation, implementation=self.implementation
    )
    if not self.is_initializing():
      mean.value, variance.value = batch_mean + bias, batch_variance
    return y


class VolumeNorm(nn.Module):
  """`Norm` of a volume whose sums are known."""

  activation: Activation

  @nn.compact
  def __call__(self, x: jax.Array, sums: jax.Array, bias: jax.Array, train: bool) -> PendingNorm:
    gamma, beta, mean, variance = _norm_variables(self, x.shape[-1:])
    if not train:
      found = mean.value - bias, variance.value
    else:
      found = moments(sums, x.size // x.shape[-1])
      if not self.is_initializing():
        mean.value, variance.value = found[0] + bias, found[1]
    return PendingNorm(x, *coefficients(*found, gamma, beta), self.activation)


def _norm_variables(module: nn.Module, shape):
  """Gamma, beta and the running statistics, in `module`'s scope."""
  return (
    module.param('scale', nn.initializers.ones, shape, jnp.float32),
    module.param('bias', nn.initializers.zeros, shape, jnp.float32),
    module.variable('batch_stats', 'mean', jnp.zeros, shape, jnp.float32),
    module.variable('batch_stats', 'var', jnp.ones, shape, jnp.float32),
  )


def _normalized(module: nn.Module, x, activation, train):
  """Bias, normalisation and activation, in `module`'s scope."""
  bias = _bias(module, x)
  return Norm(activation, module.implementation, name='norm')(x, bias, train)


def _pend_norm(module: nn.Module, x, sums, activation, train) -> PendingNorm:
  """`_normalized` of a volume."""
  return VolumeNorm(activation, name='norm')(x, sums, _bias(module, x), train)


def _bias(module: nn.Module, x):
  return module.param('bias', nn.initializers.zeros, x.shape[-1:], jnp.float32)


def _kernel(module: nn.Module, *shape):
  return module.param('kernel', _glorot, shape, jnp.float32)


class Dense(nn.Module):
  """[..., in] -> [..., features]."""

  features: int
  implementation: str = 'auto'

  @nn.compact
  def __call__(self, x: jax.Array, train: bool) -> jax.Array:
    kernel = _kernel(self, x.shape[-1], self.features)
    return _normalized(self, x @ kernel, ELU, train)


class Conv2D(nn.Module):
  """[..., H, W, in] -> [..., H / 2, W / 2, features]."""

  features: int
  size: int
  mixed: bool = False
  implementation: str = 'auto'

  @nn.compact
  def __call__(self, x: jax.Array, train: bool) -> jax.Array:
    kernel = _kernel(self, self.size, self.size, x.shape[-1], self.features)
    y = conv2d.conv2d(x, kernel, mixed=self.mixed, implementation=self.implementation)
    return _normalized(self, y, ELU, train)


class Collect(nn.Module):
  """[..., H, W, in] -> [..., features]: a convolution whose filters cover the whole map."""

  features: int
  implementation: str = 'auto'

  @nn.compact
  def __call__(self, x: jax.Array, train: bool) -> jax.Array:
    kernel = _kernel(self, *x.shape[-3:], self.features)
    x = x.reshape(*x.shape[:-3], -1) @ kernel.reshape(-1, self.features)
    return _normalized(self, x, ELU, train)


class Deconv3D(nn.Module):
  """[..., X, Y, Z, in] -> [..., 2X, 2Y, 2Z, features], of the input's type or another one."""

  features: int
  activation: Activation = ELU
  dtype: Any = None
  implementation: str = 'auto'

  @nn.compact
  def __call__(self, volume: PendingNorm, train: bool) -> PendingNorm:
    kernel = _kernel(self, 3, 3, 3, volume.x.shape[-1], self.features)
    *arrays, activation = volume
    y, sums = deconv.deconv(
      *arrays, kernel, activation, dtype=self.dtype, implementation=self.implementation
    )
    return _pend_norm(self, y, sums, self.activation, train)


class Conv3D(nn.Module):
  """[..., X, Y, Z, in] -> [..., X, Y, Z, features] float32, from 3x3x3 voxels."""

  features: int
  activation: Activation = IDENTITY
  implementation: str = 'auto'

  @nn.compact
  def __call__(self, volume: PendingNorm, train: bool) -> PendingNorm:
    kernel = _kernel(self, 3, 3, 3, volume.x.shape[-1], self.features)
    *arrays, activation = volume
    y, sums = deconv.conv(*arrays, kernel, activation, implementation=self.implementation)
    return _pend_norm(self, y, sums, self.activation, train)
