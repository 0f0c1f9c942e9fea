"""How the output of each kind of network is read, for inference.

Views are straight-alpha sRGB [B, H, W, 4] or, without alpha, [B, H, W, 3], as uint8 or as floats in
[0, 1]. The networks see them over the grey background of the authors' data. Colours are sampled
from the nearest foreground pixel: foreground is what is at least half opaque or, without alpha,
what differs from the background as in the authors' program.

A kind is a key of `networks.NETWORKS`; a new one needs a line in `READOUTS`, and one in the tuples
after it if it predicts shapes or colours.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from cvn import metrics, sampler
from cvn.data import composite


class Volumes(NamedTuple):
  """One network's predictions for views; None where it makes none."""

  probability: Any = None  # [B, X, Y, Z] of being occupied; the lowest channel of `joint`
  regressed: Any = None  # [B, X, Y, Z, 3]
  sampled: Any = None  # [B, X, Y, Z, 3] from the nearest foreground pixels
  flow: Any = None  # [B, X, Y, Z, 2] (u, v)
  weight: Any = None  # [B, X, Y, Z, 1] of the sampled colour, as estimated
  joint: Any = None  # [B, X, Y, Z, 3] the adapted 3D-R2N2's volume of shape and colour


def prepare(views: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
  """The networks' image, the colours to sample, and where they may be sampled.

  Args:
    views: [B, H, W, 4 or 3].

  Returns:
    (image [B, H, W, 3] over the background, colours [B, H, W, 3], foreground [B, H, W] bool).

  Raises:
    ValueError: views have another shape.
  """
  foreground, views = foreground_of(views), _as_float(views)
  if views.shape[-1] == 3:
    return views, views, foreground
  image = composite(views)
  # An edge pixel's own colour, not its mixture with the background.
  return image, jnp.where(foreground[..., None], views[..., :3], image), foreground


def foreground_of(views: jax.Array) -> jax.Array:
  """Where the object is, [B, H, W] bool.

  Args:
    views: [B, H, W, 4 or 3].

  Raises:
    ValueError: views have another shape.
  """
  if views.ndim != 4 or views.shape[-1] not in (3, 4):
    raise ValueError(f'views must be [B, H, W, 4] or [B, H, W, 3]: {views.shape}')
  if views.shape[-1] == 3:
    return sampler.foreground_from_color(_as_float(views))
  return _as_float(views[..., 3]) >= 0.5


def _as_float(views):
  return views.astype(jnp.float32) / 255 if views.dtype == jnp.uint8 else views


def _read_shape(logits, image, foreground):
  del image, foreground
  return Volumes(probability=jax.nn.sigmoid(logits[..., 0]))


def _read_color(volumes, image, foreground):
  sampled = sampler.nearest_foreground(image, volumes.flow, foreground)
  return Volumes(None, volumes.regressed, sampled, volumes.flow, volumes.weight)


def _read_regression(regressed, image, foreground):
  del image, foreground
  return Volumes(regressed=regressed)


def _read_flow(flow, image, foreground):
  return Volumes(sampled=sampler.nearest_foreground(image, flow, foreground), flow=flow)


def _read_joint(output, image, foreground):
  logits, volumes = output
  probability = _read_shape(logits, image, foreground).probability
  return _read_color(volumes, image, foreground)._replace(probability=probability)


def _read_r2n2(joint, image, foreground):
  del image, foreground
  return Volumes(probability=joint.min(-1), joint=joint)


# How the output of each kind of network is read: (output, image, foreground) -> volumes.
READOUTS: dict[str, Callable[[Any, jax.Array, jax.Array], Volumes]] = {
  'shape': _read_shape,
  'color': _read_color,
  'regression': _read_regression,
  'flow': _read_flow,
  'joint': _read_joint,
  'r2n2': _read_r2n2,
}

# From which probability on a voxel is occupied, unless one was chosen on a validation split.
THRESHOLDS = {
  'shape': metrics.OCCUPIED,
  'joint': metrics.OCCUPIED,
  'r2n2': metrics.JOINT_OCCUPIED,
}
SHAPE_KINDS = (*THRESHOLDS,)
COLOR_KINDS = ('color', 'regression', 'flow', 'joint', 'r2n2')
BLENDING_KINDS = ('color', 'joint')  # whose colours depend on alpha
