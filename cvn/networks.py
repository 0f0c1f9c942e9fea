"""The networks: one encoder and decoder trunk, and the heads that make volumes of it (section 3.4).

Images are [..., H, W, 3] in [0, 1]; volumes [..., X, Y, Z, C]. `apply(variables, image, train=...)`
uses batch statistics when `train`, else the running ones in `variables['batch_stats']`. Features
of a `mixed` network's volumes, where nearly all the work is, are bfloat16; parameters, sums,
statistics and all that comes out are float32. `implementation` chooses the program of every
layer: 'auto', 'kernels' or 'xla' (cvn/ops/dispatch.py).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from flax import linen as nn

from cvn.camera import IMAGE_SIZE
from cvn.grid import GRID_SIZE
from cvn.layers import (
  Collect,
  Conv2D,
  Conv3D,
  Deconv3D,
  Dense,
  PendingNorm,
  as_pending,
  materialize,
)
from cvn.ops import dispatch
from cvn.ops.normalization import IDENTITY, SIGMOID, Activation

ENCODER = ((7, 64), (5, 64), (5, 128), (3, 128), (3, 256))  # (filter size, channels), stride 2
DECODER = (64, 32, 32)  # channels of the deconvolutions before the heads

# Statistics of a channel of the joint volume, which is -0.5 but for the surface, about a fortieth.
JOINT_MEAN, JOINT_SPREAD = -0.475, 0.15


class ColorVolumes(NamedTuple):
  """The colour network's three volumes; all in [0, 1]."""

  regressed: jax.Array  # [..., X, Y, Z, 3] sRGB
  flow: jax.Array  # [..., X, Y, Z, 2] (u, v)
  weight: jax.Array  # [..., X, Y, Z, 1] the paper's w: confidence of the sampled colour


class Encoder(nn.Module):
  """[..., H, W, 3] -> latent features [..., features], through a code of 512 numbers."""

  features: int
  mixed: bool = False
  implementation: str = 'auto'

  @nn.compact
  def __call__(self, image: jax.Array, train: bool) -> jax.Array:
    x, chosen = image, self.implementation
    for i, (size, channels) in enumerate(ENCODER):
      x = Conv2D(channels, size, self.mixed, chosen, name=f'conv{i}')(x, train)
    x = Collect(512, chosen, name=f'conv{len(ENCODER)}')(x, train)
    x = Dense(512, chosen, name='latent0')(x, train)
    return Dense(self.features, chosen, name='latent1')(x, train)


class Decoder(nn.Module):
  """[..., s, s, s, 128] -> [..., 8 s, 8 s, 8 s, 32]."""

  implementation: str = 'auto'

  @nn.compact
  def __call__(self, x: PendingNorm, train: bool) -> PendingNorm:
    for i, channels in enumerate(DECODER):
      x = Deconv3D(channels, implementation=self.implementation, name=f'deconv{i}')(x, train)
    return x


class Trunk(nn.Module):
  """An image's feature volume at half the grid's size: [..., X/2, Y/2, Z/2, 32]."""

  image_size: int
  grid_size: int
  mixed: bool = False
  implementation: str = 'auto'

  @nn.compact
  def __call__(self, image: jax.Array, train: bool) -> PendingNorm:
    if image.shape[-3:] != (self.image_size, self.image_size, 3):
      raise ValueError(
        f'images must be [..., {self.image_size}, {self.image_size}, 3]: {image.shape}'
      )
    image = dispatch.as_float('images', image)
    s = self.grid_size // 2 ** (len(DECODER) + 1)
    x = Encoder(s**3 * 128, self.mixed, self.implementation, name='encoder')(image, train)
    x = x.astype(jnp.bfloat16 if self.mixed else jnp.float32)
    volume = as_pending(x.reshape(*x.shape[:-1], s, s, s, 128))
    return Decoder(self.implementation, name='decoder')(volume, train)


class Head(nn.Module):
  """A volume at the grid's full size: deconvolution, then a 3x3x3 convolution to its channels."""

  hidden: int
  features: int
  activation: Activation = IDENTITY
  implementation: str = 'auto'

  @nn.compact
  def __call__(self, x: PendingNorm, train: bool) -> jax.Array:
    chosen = self.implementation
    x = Deconv3D(self.hidden, implementation=chosen, name='deconv')(x, train)
    x = Conv3D(self.features, self.activation, chosen, name='conv')(x, train)
    return materialize(x, implementation=chosen)


class FlowHead(nn.Module):
  """The flow volume comes from one deconvolution, as in the authors' program."""

  implementation: str = 'auto'

  @nn.compact
  def __call__(self, x: PendingNorm, train: bool) -> jax.Array:
    chosen = self.implementation
    x = Deconv3D(2, SIGMOID, jnp.float32, chosen, name='deconv')(x, train)
    return materialize(x, implementation=chosen)


def _color_heads(x: PendingNorm, train: bool, implementation: str) -> ColorVolumes:
  # The authors' network says how sure it is of the regressed colour: 1 - w.
  return ColorVolumes(
    Head(16, 3, SIGMOID, implementation, name='regressed')(x, train),
    FlowHead(implementation, name='flow')(x, train),
    1 - Head(16, 1, SIGMOID, implementation, name='weight')(x, train),
  )


def _trunk(network: nn.Module) -> Trunk:
  """That of a network, in its scope."""
  n = network
  return Trunk(n.image_size, n.grid_size, n.mixed, n.implementation, name='trunk')


class ShapeNetwork(nn.Module):
  """Image -> occupancy logits [..., X, Y, Z, 1]."""

  image_size: int = IMAGE_SIZE
  grid_size: int = GRID_SIZE
  mixed: bool = False
  implementation: str = 'auto'

  @nn.compact
  def __call__(self, image: jax.Array, *, train: bool) -> jax.Array:
    x = _trunk(self)(image, train)
    return Head(24, 1, IDENTITY, self.implementation, name='head')(x, train)


class ColorNetwork(nn.Module):
  """Image -> `ColorVolumes`."""

  image_size: int = IMAGE_SIZE
  grid_size: int = GRID_SIZE
  mixed: bool = False
  implementation: str = 'auto'

  @nn.compact
  def __call__(self, image: jax.Array, *, train: bool) -> ColorVolumes:
    x = _trunk(self)(image, train)
    return _color_heads(x, train, self.implementation)


class RegressionNetwork(nn.Module):
  """The colour regression model (section 4.1): colours [..., X, Y, Z, 3] in [0, 1] alone."""

  image_size: int = IMAGE_SIZE
  grid_size: int = GRID_SIZE
  mixed: bool = False
  implementation: str = 'auto'

  @nn.compact
  def __call__(self, image: jax.Array, *, train: bool) -> jax.Array:
    x = _trunk(self)(image, train)
    return Head(16, 3, SIGMOID, self.implementation, name='regressed')(x, train)


class FlowNetwork(nn.Module):
  """The flow model (section 4.1): (u, v) [..., X, Y, Z, 2] in [0, 1], and no colours."""

  image_size: int = IMAGE_SIZE
  grid_size: int = GRID_SIZE
  mixed: bool = False
  implementation: str = 'auto'

  @nn.compact
  def __call__(self, image: jax.Array, *, train: bool) -> jax.Array:
    x = _trunk(self)(image, train)
    return FlowHead(self.implementation, name='flow')(x, train)


class JointNetwork(nn.Module):
  """The unified network (section 4.3): one trunk, four volumes. -> (logits, `ColorVolumes`)."""

  image_size: int = IMAGE_SIZE
  grid_size: int = GRID_SIZE
  mixed: bool = False
  implementation: str = 'auto'

  @nn.compact
  def __call__(self, image: jax.Array, *, train: bool) -> tuple[jax.Array, ColorVolumes]:
    x = _trunk(self)(image, train)
    logits = Head(24, 1, IDENTITY, self.implementation, name='head')(x, train)
    return logits, _color_heads(x, train, self.implementation)


class AdaptedR2N2(nn.Module):
  """The baseline: one volume [..., X, Y, Z, 3] of shape and colour jointly; empty is -0.5.

  3D-R2N2 without recurrence and with one more upsampling layer (section 4, competing methods), on
  this framework's own trunk: 'all other training settings are kept constant'. A normalised output
  starts with mean 0 and variance 1, far from a volume that is nearly everywhere empty; what is
  normalised here is the difference from that volume's mean, in units of its spread.
  """

  image_size: int = IMAGE_SIZE
  grid_size: int = GRID_SIZE
  mixed: bool = False
  implementation: str = 'auto'

  @nn.compact
  def __call__(self, image: jax.Array, *, train: bool) -> jax.Array:
    x = _trunk(self)(image, train)
    normal = Head(24, 3, IDENTITY, self.implementation, name='head')(x, train)
    return JOINT_MEAN + JOINT_SPREAD * normal


NETWORKS = {
  'shape': ShapeNetwork,
  'color': ColorNetwork,
  'regression': RegressionNetwork,
  'flow': FlowNetwork,
  'joint': JointNetwork,
  'r2n2': AdaptedR2N2,
}
