"""From a view to coloured voxels: the whole inference (section 3.5) as one compiled function.

Views are [B, H, W, 4] straight-alpha sRGB in [0, 1], or [B, H, W, 3] without alpha. The networks
see them over a plain grey ground. Colours are sampled from the nearest foreground pixel: foreground
is what is at least half opaque or, without alpha, what differs from the ground as in the authors'
program. The networks run on their running batch statistics.
"""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from cvn import blending, sampler
from cvn.data import GREY, composite
from cvn.grid import GRID_SIZE, ColoredVoxels
from cvn.metrics import OCCUPIED
from cvn.networks import (
  AdaptedR2N2,
  ColorNetwork,
  FlowNetwork,
  JointNetwork,
  RegressionNetwork,
  ShapeNetwork,
)


class ColorEstimate(NamedTuple):
  """Colours of all voxels, with or without the batch axis; all in [0, 1]."""

  regressed: Any  # [X, Y, Z, 3]
  sampled: Any  # [X, Y, Z, 3] from the nearest foreground pixels
  flow: Any  # [X, Y, Z, 2] (u, v)
  weight: Any  # [X, Y, Z] confidence of the sampled colour, as estimated
  blended: Any  # [X, Y, Z, 3] with the recalculated weight


class Reconstruction(NamedTuple):
  """Everything the networks say of a view, with or without the batch axis; all in [0, 1]."""

  probability: Any  # [X, Y, Z] of being occupied
  regressed: Any  # as in `ColorEstimate`
  sampled: Any
  flow: Any
  weight: Any
  blended: Any


@functools.partial(jax.jit, static_argnames='grid_size')
def estimate_shape(
  variables, views: jax.Array, *, background: float = GREY, grid_size: int = GRID_SIZE
) -> jax.Array:
  """Occupancy probabilities [B, X, Y, Z].

  Args:
    variables: of a `ShapeNetwork`.
    views: [B, H, W, 4 or 3].
    background: grey level in [0, 1] behind the object.
    grid_size: of the network.
  """
  image, _, _ = _prepare(views, background)
  network = ShapeNetwork(views.shape[2], grid_size)
  return jax.nn.sigmoid(network.apply(variables, image, train=False)[..., 0])


@functools.partial(jax.jit, static_argnames=('alpha', 'grid_size'))
def estimate_color(
  variables,
  views: jax.Array,
  *,
  alpha: float = blending.ALPHA,
  background: float = GREY,
  grid_size: int = GRID_SIZE,
) -> ColorEstimate:
  """Colours of all voxels, batched.

  Args:
    variables: of a `ColorNetwork`.
    views: [B, H, W, 4 or 3].
    alpha: in (0, 1], see `blending.recalculate_weight`.
    background: grey level in [0, 1] behind the object.
    grid_size: of the network.

  Raises:
    UserError: alpha is outside (0, 1].
  """
  image, color, foreground = _prepare(views, background)
  volumes = ColorNetwork(views.shape[2], grid_size).apply(variables, image, train=False)
  return _blend(volumes, color, foreground, alpha)


@functools.partial(jax.jit, static_argnames=('alpha', 'grid_size'))
def reconstruct(
  shape_variables,
  color_variables,
  views: jax.Array,
  *,
  alpha: float = blending.ALPHA,
  background: float = GREY,
  grid_size: int = GRID_SIZE,
) -> Reconstruction:
  """Shape and colours from views, batched.

  Args:
    shape_variables: of a `ShapeNetwork`.
    color_variables: of a `ColorNetwork`.
    views: [B, H, W, 4 or 3].
    alpha: in (0, 1], see `blending.recalculate_weight`.
    background: grey level in [0, 1] behind the object.
    grid_size: of the networks.

  Raises:
    UserError: alpha is outside (0, 1].
  """
  sizes = {'background': background, 'grid_size': grid_size}
  return Reconstruction(
    estimate_shape(shape_variables, views, **sizes),
    *estimate_color(color_variables, views, alpha=alpha, **sizes),
  )


@functools.partial(jax.jit, static_argnames=('alpha', 'grid_size'))
def estimate_joint(
  variables,
  views: jax.Array,
  *,
  alpha: float = blending.ALPHA,
  background: float = GREY,
  grid_size: int = GRID_SIZE,
) -> Reconstruction:
  """The same from the variables of one `JointNetwork`."""
  image, color, foreground = _prepare(views, background)
  logits, volumes = JointNetwork(views.shape[2], grid_size).apply(variables, image, train=False)
  return Reconstruction(jax.nn.sigmoid(logits[..., 0]), *_blend(volumes, color, foreground, alpha))


@functools.partial(jax.jit, static_argnames='grid_size')
def estimate_regression(
  variables, views: jax.Array, *, background: float = GREY, grid_size: int = GRID_SIZE
) -> jax.Array:
  """The colours [B, X, Y, Z, 3] of a `RegressionNetwork`; arguments as of `estimate_shape`."""
  image, _, _ = _prepare(views, background)
  return RegressionNetwork(views.shape[2], grid_size).apply(variables, image, train=False)


@functools.partial(jax.jit, static_argnames='grid_size')
def estimate_flow(
  variables, views: jax.Array, *, background: float = GREY, grid_size: int = GRID_SIZE
) -> tuple[jax.Array, jax.Array]:
  """The flow [B, X, Y, Z, 2] of a `FlowNetwork`, and the foreground colours that it fetches.

  Arguments as of `estimate_shape`.
  """
  image, color, foreground = _prepare(views, background)
  flow = FlowNetwork(views.shape[2], grid_size).apply(variables, image, train=False)
  return flow, sampler.nearest_foreground(color, flow, foreground)


@functools.partial(jax.jit, static_argnames='grid_size')
def estimate_r2n2(
  variables, views: jax.Array, *, background: float = GREY, grid_size: int = GRID_SIZE
) -> jax.Array:
  """The joint volume [B, X, Y, Z, 3] of an `AdaptedR2N2`, for `blending.adjust_color`.

  Arguments as of `estimate_shape`.
  """
  image, _, _ = _prepare(views, background)
  return AdaptedR2N2(views.shape[2], grid_size).apply(variables, image, train=False)


def to_voxels(reconstruction: Reconstruction, threshold: float = OCCUPIED) -> ColoredVoxels:
  """The coloured shape of one reconstruction (no batch axis), as numpy arrays."""
  return ColoredVoxels(
    np.asarray(reconstruction.probability) >= threshold, np.asarray(reconstruction.blended)
  )


def foreground_of(views: Any) -> jax.Array:
  """Where the object is, [B, H, W] bool, in views [B, H, W, 4 or 3]."""
  if views.ndim != 4 or views.shape[-1] not in (3, 4):
    raise ValueError(f'views must be [B, H, W, 4] or [B, H, W, 3]: {views.shape}')
  if views.shape[-1] == 3:
    return sampler.foreground_from_color(views)
  return jnp.asarray(views[..., 3] >= 0.5)


def _blend(volumes, color, foreground, alpha):
  """The colours of `ColorVolumes`."""
  sampled = sampler.nearest_foreground(color, volumes.flow, foreground)
  weight = blending.recalculate_weight(volumes.weight, alpha)
  blended = blending.blend(sampled, volumes.regressed, weight)
  return ColorEstimate(volumes.regressed, sampled, volumes.flow, volumes.weight[..., 0], blended)


def _prepare(views, background):
  """The networks' image, the colours to sample and where they may be sampled."""
  foreground = foreground_of(views)
  if views.shape[-1] == 3:
    return views, views, foreground
  image = composite(views, background)
  # An edge pixel's own colour, not its mixture with the ground.
  return image, jnp.where(foreground[..., None], views[..., :3], image), foreground
