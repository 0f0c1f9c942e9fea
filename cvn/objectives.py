"""What each network is trained for: the loss of its output for a batch, and metrics.

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


def shape(logits, batch, recipe, train):
  """The recipe's loss of occupancy logits [B, X, Y, Z, 1]."""
  logits, occupancy = logits[..., 0], _occupancy(batch.index, logits.shape[1:4])
  loss = recipe.shape_loss(logits, occupancy)
  if train:
    return loss, {}
  found = metrics.iou(jax.nn.sigmoid(logits) > metrics.OCCUPIED, occupancy)
  return loss, {'iou': jnp.mean(found)}


def color(volumes, batch, recipe, train):
  """L_flow + L_clr_regress + L_blend of `ColorVolumes` (equation 8)."""
  del train
  # One gather for the three volumes; what it leaves out gets no gradient.
  stacked, mask = _at_surface(jnp.concatenate(volumes, axis=-1), batch.index)
  return color_at_surface(ColorVolumes(*jnp.split(stacked, (3, 5), axis=-1)), batch, mask, recipe)


def color_at_surface(volumes, batch, mask, recipe):
  """The same of volumes that were computed at the surface voxels alone, [B, S, channels].

  Returns:
    (loss, its terms).
  """
  regressed, flow, weight = volumes
  blended = blending.blend(recipe.sample(batch.image, flow), regressed, weight)
  loss, terms = losses.color_objective(
    regressed, blended, flow, batch.color, batch.flow, mask, distance=recipe.surface_distance
  )
  return loss, terms._asdict()


def regression(regressed, batch, recipe, train):
  """L_clr_regress alone, of colours [B, X, Y, Z, 3] (section 4.1)."""
  del train
  regressed, mask = _at_surface(regressed, batch.index)
  return recipe.surface_distance(regressed, batch.color, mask), {}


def flow(flow, batch, recipe, train):
  """L_flow alone, of (u, v) [B, X, Y, Z, 2] (section 4.1)."""
  del train
  flow, mask = _at_surface(flow, batch.index)
  return recipe.surface_distance(flow, batch.flow, mask), {}


def joint(output, batch, recipe, train):
  """L_flow + L_clr_regress + L_blend + MSFCEL of the unified network (section 4.1)."""
  logits, volumes = output
  shape_loss, found = shape(logits, batch, recipe, train)
  color_loss, terms = color(volumes, batch, recipe, train)
  return shape_loss + color_loss, {'shape': shape_loss, **terms, **found}


def r2n2(volume, batch, recipe, train):
  """The L2 loss of all voxels of the joint volume [B, X, Y, Z, 3] of shape and colour."""
  del recipe  # the text and the program leave nothing to choose
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
  """A volume at the surface voxels [B, S, C], and which slots are no padding [B, S]."""
  mask = index[..., 0] < volume.shape[1]
  gather = jax.vmap(lambda v, i: v.at[tuple(i.T)].get(mode='fill', fill_value=0))
  return gather(volume, index), mask
