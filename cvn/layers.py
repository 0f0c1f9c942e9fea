"""Layers: a linear map and a bias, then batch normalisation, then an activation.

Every layer of the authors' program has this form, the last ones included (epsilon 1e-3, biased
batch variance). In training the collection `batch_stats` that `apply` returns holds the statistics
of this batch alone; `cvn.train` folds them into running averages, whose decay is the recipe's.
"""

from typing import Any

import jax
import jax.numpy as jnp
from flax import linen as nn
from jax import lax

from cvn import deconv
from cvn.normalization import ELU, IDENTITY, Activation, affine, normalize

_glorot = nn.initializers.glorot_uniform()


class Norm(nn.Module):
  """Batch normalisation over all axes but the last, then the activation.

  A bias in front of it, which the layers have, only moves the mean: it is not added in training.
  """

  activation: Activation

  @nn.compact
  def __call__(self, x: jax.Array, bias: jax.Array, train: bool) -> jax.Array:
    shape = x.shape[-1:]
    scale = self.param('scale', nn.initializers.ones, shape)
    offset = self.param('bias', nn.initializers.zeros, shape)
    mean = self.variable('batch_stats', 'mean', jnp.zeros, shape)
    variance = self.variable('batch_stats', 'var', jnp.ones, shape)
    if not train:
      return affine(x, mean.value - bias, variance.value, scale, offset, self.activation)
    y, batch_mean, batch_variance = normalize(x, scale, offset, self.activation)
    if not self.is_initializing():
      mean.value, variance.value = batch_mean + bias, batch_variance
    return y


def _finish(module: nn.Module, x, activation, train):
  """Bias, normalisation and activation, in `module`'s scope."""
  bias = module.param('bias', nn.initializers.zeros, x.shape[-1:])
  return Norm(activation, name='norm')(x, bias, train)


class Dense(nn.Module):
  """[B, in] -> [B, features]."""

  features: int

  @nn.compact
  def __call__(self, x: jax.Array, train: bool) -> jax.Array:
    kernel = self.param('kernel', _glorot, (x.shape[-1], self.features))
    return _finish(self, x @ kernel, ELU, train)


class Conv2D(nn.Module):
  """[B, H, W, in] -> [B, H / stride, W / stride, features]."""

  features: int
  size: int
  stride: int = 1
  padding: str = 'SAME'

  @nn.compact
  def __call__(self, x: jax.Array, train: bool) -> jax.Array:
    kernel = self.param('kernel', _glorot, (self.size, self.size, x.shape[-1], self.features))
    x = lax.conv_general_dilated(
      x, kernel, (self.stride,) * 2, self.padding, dimension_numbers=('NHWC', 'HWIO', 'NHWC')
    )
    return _finish(self, x, ELU, train)


class Deconv3D(nn.Module):
  """[B, X, Y, Z, in] -> [B, 2X, 2Y, 2Z, features], of the input's type or another one."""

  features: int
  activation: Activation = ELU
  dtype: Any = None

  @nn.compact
  def __call__(self, x: jax.Array, train: bool) -> jax.Array:
    kernel = self.param('kernel', _glorot, (3, 3, 3, x.shape[-1], self.features))
    return _finish(self, deconv.deconv(x, kernel, self.dtype), self.activation, train)


class Conv3D(nn.Module):
  """[B, X, Y, Z, in] -> [B, X, Y, Z, features] float32, from 3x3x3 voxels."""

  features: int
  activation: Activation = IDENTITY

  @nn.compact
  def __call__(self, x: jax.Array, train: bool) -> jax.Array:
    kernel = self.param('kernel', _glorot, (3, 3, 3, x.shape[-1], self.features))
    return _finish(self, deconv.conv(x, kernel), self.activation, train)
