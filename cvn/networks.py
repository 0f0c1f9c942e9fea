"""The networks: one encoder and decoder trunk, and the heads that make volumes of it (section 3.4).

Images are [B, H, W, 3] in [0, 1]; volumes [B, X, Y, Z, C]. `apply(variables, image, train=...)`
uses batch statistics when `train`, else the running ones in `variables['batch_stats']`. Features
of a `mixed` network's volumes, where nearly all the work is, are bfloat16; parameters, sums,
statistics and all that comes out are float32.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from flax import linen as nn

from cvn.camera import IMAGE_SIZE
from cvn.grid import GRID_SIZE
from cvn.layers import Collect, Conv2D, Conv3D, Deconv3D, Dense, Volume, finish, volume_of
from cvn.ops.normalization import IDENTITY, SIGMOID, Activation

ENCODER = ((7, 64), (5, 64), (5, 128), (3, 128), (3, 256))  # (filter size, channels), stride 2
DECODER = (64, 32, 32)  # channels of the deconvolutions before the heads

# Of a channel of the joint volume: -0.5 where empty, and about a fortieth of it is surface.
JOINT_MEAN, JOINT_SPREAD = -0.475, 0.15


class ColorVolumes(NamedTuple):
  """What the colour network says of every voxel; all in [0, 1]."""

  regressed: jax.Array  # [B, X, Y, Z, 3] sRGB
  flow: jax.Array  # [B, X, Y, Z, 2] (u, v)
  weight: jax.Array  # [B, X, Y, Z, 1] the paper's w: confidence of the sampled colour


class Encoder(nn.Module):
  """[B, H, W, 3] -> latent features [B, features], through a code of 512 numbers."""

  features: int
  mixed: bool = False

  @nn.compact
  def __call__(self, image: jax.Array, train: bool) -> jax.Array:
    x = image
    for i, (size, channels) in enumerate(ENCODER):
      x = Conv2D(channels, size, self.mixed, name=f'conv{i}')(x, train)
    x = Collect(512, name=f'conv{len(ENCODER)}')(x, train)
    x = Dense(512, name='latent0')(x, train)
    return Dense(self.features, name='latent1')(x, train)


class Decoder(nn.Module):
  """[B, s, s, s, 128] -> [B, 8 s, 8 s, 8 s, 32]."""

  @nn.compact
  def __call__(self, x: Volume, train: bool) -> Volume:
    for i, channels in enumerate(DECODER):
      x = Deconv3D(channels, name=f'deconv{i}')(x, train)
    return x


class Trunk(nn.Module):
  """An image's feature volume at half the grid's size: [B, X/2, Y/2, Z/2, 32]."""

  image_size: int
  grid_size: int
  mixed: bool = False

  @nn.compact
  def __call__(self, image: jax.Array, train: bool) -> Volume:
    if image.ndim != 4 or image.shape[1:] != (self.image_size, self.image_size, 3):
      raise ValueError(
        f'images must be [B, {self.image_size}, {self.image_size}, 3]: {image.shape}'
      )
    s = self.grid_size // 2 ** (len(DECODER) + 1)
    x = Encoder(s**3 * 128, self.mixed, name='encoder')(image, train)
    x = x.astype(jnp.bfloat16 if self.mixed else jnp.float32)
    return Decoder(name='decoder')(volume_of(x.reshape(-1, s, s, s, 128)), train)


class Head(nn.Module):
  """A volume at the grid's full size: deconvolution, then a 3x3x3 convolution to its channels."""

  hidden: int
  features: int
  activation: Activation = IDENTITY

  @nn.compact
  def __call__(self, x: Volume, train: bool) -> jax.Array:
    x = Deconv3D(self.hidden, name='deconv')(x, train)
    return finish(Conv3D(self.features, self.activation, name='conv')(x, train))


class FlowHead(nn.Module):
  """The flow volume comes from one deconvolution, as in the authors' program."""

  @nn.compact
  def __call__(self, x: Volume, train: bool) -> jax.Array:
    return finish(Deconv3D(2, SIGMOID, jnp.float32, name='deconv')(x, train))


def _color_heads(x: Volume, train: bool) -> ColorVolumes:
  # The authors' network says how sure it is of the regressed colour: 1 - w.
  return ColorVolumes(
    Head(16, 3, SIGMOID, name='regressed')(x, train),
    FlowHead(name='flow')(x, train),
    1 - Head(16, 1, SIGMOID, name='weight')(x, train),
  )


class ShapeNetwork(nn.Module):
  """Image -> occupancy logits [B, X, Y, Z, 1]."""

  image_size: int = IMAGE_SIZE
  grid_size: int = GRID_SIZE
  mixed: bool = False

  @nn.compact
  def __call__(self, image: jax.Array, *, train: bool) -> jax.Array:
    x = Trunk(self.image_size, self.grid_size, self.mixed, name='trunk')(image, train)
    return Head(24, 1, name='head')(x, train)


class ColorNetwork(nn.Module):
  """Image -> `ColorVolumes`."""

  image_size: int = IMAGE_SIZE
  grid_size: int = GRID_SIZE
  mixed: bool = False

  @nn.compact
  def __call__(self, image: jax.Array, *, train: bool) -> ColorVolumes:
    x = Trunk(self.image_size, self.grid_size, self.mixed, name='trunk')(image, train)
    return _color_heads(x, train)


class RegressionNetwork(nn.Module):
  """The colour regression model (section 4.1): colours [B, X, Y, Z, 3] in [0, 1], and no others."""

  image_size: int = IMAGE_SIZE
  grid_size: int = GRID_SIZE
  mixed: bool = False

  @nn.compact
  def __call__(self, image: jax.Array, *, train: bool) -> jax.Array:
    x = Trunk(self.image_size, self.grid_size, self.mixed, name='trunk')(image, train)
    return Head(16, 3, SIGMOID, name='regressed')(x, train)


class FlowNetwork(nn.Module):
  """The flow model (section 4.1): (u, v) [B, X, Y, Z, 2] in [0, 1], and no colours."""

  image_size: int = IMAGE_SIZE
  grid_size: int = GRID_SIZE
  mixed: bool = False

  @nn.compact
  def __call__(self, image: jax.Array, *, train: bool) -> jax.Array:
    x = Trunk(self.image_size, self.grid_size, self.mixed, name='trunk')(image, train)
    return FlowHead(name='flow')(x, train)


class JointNetwork(nn.Module):
  """The unified network (section 4.3): one trunk, four volumes. -> (logits, `ColorVolumes`)."""

  image_size: int = IMAGE_SIZE
  grid_size: int = GRID_SIZE
  mixed: bool = False

  @nn.compact
  def __call__(self, image: jax.Array, *, train: bool) -> tuple[jax.Array, ColorVolumes]:
    x = Trunk(self.image_size, self.grid_size, self.mixed, name='trunk')(image, train)
    return Head(24, 1, name='head')(x, train), _color_heads(x, train)


class AdaptedR2N2(nn.Module):
  """The baseline: one volume [B, X, Y, Z, 3] of shape and colour jointly; empty is -0.5.

  3D-R2N2 without recurrence and with one more upsampling layer (section 4, competing methods), on
  this framework's own trunk: 'all other training settings are kept constant'. A normalised output
  starts with mean 0 and variance 1, far from a volume that is nearly everywhere empty; what is
  normalised here is the difference from that volume's mean, in units of its spread.
  """

  image_size: int = IMAGE_SIZE
  grid_size: int = GRID_SIZE
  mixed: bool = False

  @nn.compact
  def __call__(self, image: jax.Array, *, train: bool) -> jax.Array:
    x = Trunk(self.image_size, self.grid_size, self.mixed, name='trunk')(image, train)
    return JOINT_MEAN + JOINT_SPREAD * Head(24, 3, name='head')(x, train)


NETWORKS = {
  'shape': ShapeNetwork,
  'color': ColorNetwork,
  'regression': RegressionNetwork,
  'flow': FlowNetwork,
  'joint': JointNetwork,
  'r2n2': AdaptedR2N2,
}
