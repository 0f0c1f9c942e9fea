"""The objective of each network: the loss of its output for a batch, and metrics.

Every objective is (output, batch, recipe, train) -> (loss, metrics). Surfaces come as in cvn.data:
indices [B, S, 3], padded with PADDING_INDEX, and the colours and flows of these voxels. Outside of
training there are more metrics, such as the IoU of a shape.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from cvn import blending, losses, metrics
from cvn.networks import ColorVolumes
from cvn.recipe import Recipe

Objective = Callable[[Any, Any, Recipe, bool], tuple[jax.Array, dict[str, jax.Array]]]

EMPTY = -0.5  # every channel of an empty voxel of the joint volume (section 4, competing methods)


Result = tuple[jax.Array, dict[str, jax.Array]]  # (loss, metrics)


def shape(logits: jax.Array, batch: Any, recipe: Recipe, train: bool) -> Result:
  """The recipe's shape loss.

  Args:
    logits: [B, X, Y, Z, 1] of occupancy.
    batch: decoded.
    recipe: its shape loss is used.
    train: whether in training; otherwise there is the IoU, too.
  """
  logits, occupancy = logits[..., 0], _occupancy(batch.index, logits.shape[1:4])
  loss = recipe.shape_loss(logits, occupancy)
  if train:
    return loss, {}
  found = metrics.iou(jax.nn.sigmoid(logits) > metrics.OCCUPIED, occupancy)
  return loss, {'iou': jnp.mean(found)}


def color(volumes: ColorVolumes, batch: Any, recipe: Recipe, train: bool) -> Result:
  """L_flow + L_clr_regress + L_blend (equation 8); the metrics are the three terms.

  Args:
    volumes: of the colour network.
    batch: decoded.
    recipe: its sampler and surface distance are used.
    train: does not matter.
  """
  del train
  # One gather for the three volumes; voxels that it leaves out get no gradient.
  stacked, mask = _at_surface(jnp.concatenate(volumes, axis=-1), batch.index)
  return color_at_surface(ColorVolumes(*jnp.split(stacked, (3, 5), axis=-1)), batch, mask, recipe)


def color_at_surface(volumes: ColorVolumes, batch: Any, mask: jax.Array, recipe: Recipe) -> Result:
  """`color` for volumes that were computed at the surface voxels alone.

  Args:
    volumes: [B, S, channels] each.
    batch: decoded.
    mask: [B, S] bool, False where padded.
    recipe: its sampler and surface distance are used.
  """
  regressed, flow, weight = volumes
  blended = blending.blend(recipe.sample(batch.image, flow), regressed, weight)
  loss, terms = losses.color_objective(
    regressed, blended, flow, batch.color, batch.flow, mask, distance=recipe.surface_distance
  )
  return loss, terms._asdict()


def regression(regressed: jax.Array, batch: Any, recipe: Recipe, train: bool) -> Result:
  """L_clr_regress alone (section 4.1).

  Args:
    regressed: [B, X, Y, Z, 3] colours.
    batch: decoded.
    recipe: its surface distance is used.
    train: does not matter.
  """
  del train
  regressed, mask = _at_surface(regressed, batch.index)
  return recipe.surface_distance(regressed, batch.color, mask), {}


def flow(flow: jax.Array, batch: Any, recipe: Recipe, train: bool) -> Result:
  """L_flow alone (section 4.1).

  Args:
    flow: [B, X, Y, Z, 2] (u, v).
    batch: decoded.
    recipe: its surface distance is used.
    train: does not matter.
  """
  del train
  flow, mask = _at_surface(flow, batch.index)
  return recipe.surface_distance(flow, batch.flow, mask), {}


def joint(
  output: tuple[jax.Array, ColorVolumes], batch: Any, recipe: Recipe, train: bool
) -> Result:
  """L_flow + L_clr_regress + L_blend + MSFCEL of the unified network (section 4.1).

  Args:
    output: (logits, volumes) of the joint network.
    batch: decoded.
    recipe: as of `shape` and `color`.
    train: as of `shape`.
  """
  logits, volumes = output
  shape_loss, found = shape(logits, batch, recipe, train)
  color_loss, terms = color(volumes, batch, recipe, train)
  return shape_loss + color_loss, {'shape': shape_loss, **terms, **found}


def r2n2(volume: jax.Array, batch: Any, recipe: Recipe, train: bool) -> Result:
  """The L2 loss over all voxels of the joint volume of shape and colour.

  Args:
    volume: [B, X, Y, Z, 3], of the adapted 3D-R2N2.
    batch: decoded.
    recipe: does not matter: the text and the program leave nothing to choose.
    train: as of `shape`.
  """
  del recipe
  target = jax.vmap(
    lambda i, c: jnp.full(volume.shape[1:], EMPTY).at[tuple(i.T)].set(c, mode='drop')
  )(batch.index, batch.color)
  loss = losses.joint_l2(volume, target)
  if train:
    return loss, {}
  occupied = jnp.all(volume > metrics.JOINT_OCCUPIED, axis=-1)
  found = metrics.iou(occupied, _occupancy(batch.index, volume.shape[1:4]))
  return loss, {'iou': jnp.mean(found)}


OBJECTIVES = {
  'shape': shape,
  'color': color,
  'regression': regression,
  'flow': flow,
  'joint': joint,
  'r2n2': r2n2,
}


def _occupancy(index, size):
  """Whether each voxel is a surface voxel, [B, *size] bool."""
  return jax.vmap(lambda i: jnp.zeros(size, bool).at[tuple(i.T)].set(True, mode='drop'))(index)


def _at_surface(volume, index):
  """A volume at the surface voxels [B, S, C], and its mask [B, S], False where padded."""
  mask = index[..., 0] < volume.shape[1]
  gather = jax.vmap(lambda v, i: v.at[tuple(i.T)].get(mode='fill', fill_value=0))
  return gather(volume, index), mask
