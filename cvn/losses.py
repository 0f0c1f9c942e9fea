"""Losses: pure functions of arrays of any leading shape, to a scalar.

A mask marks surface voxels. Values where the mask is False, NaN included, change neither the loss
nor its gradient, so predictions may be dense volumes or gathered at sparse indices with padding. A
mean over no voxels is 0, and so is its gradient.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp


class ColorTerms(NamedTuple):
  """The terms of the colour objective; scalars."""

  flow: jax.Array
  regressed: jax.Array
  blended: jax.Array


def msfcel(logits: jax.Array, occupancy: jax.Array) -> jax.Array:
  """Mean squared false cross-entropy: FPCE^2 + FNCE^2 (equation 1).

  FPCE is the mean cross-entropy over all empty voxels of the batch, FNCE that over all occupied
  ones, as in the authors' program. A side without voxels contributes 0.

  >>> loss = msfcel(jnp.zeros(4), jnp.array([True, False, False, False]))
  >>> bool(jnp.isclose(loss, 2 * jnp.log(2) ** 2))
  True

  Args:
    logits: [...] log odds of being occupied.
    occupancy: [...] bool, or 0 and 1.
  """
  _check_same(logits, occupancy)
  occupied = occupancy.astype(bool)
  fpce = _masked_mean(jax.nn.softplus(logits), ~occupied)
  fnce = _masked_mean(jax.nn.softplus(-logits), occupied)
  return fpce**2 + fnce**2


def cross_entropy(logits: jax.Array, occupancy: jax.Array) -> jax.Array:
  """Mean cross-entropy over all voxels: what MSFCEL is compared with (section 4.1).

  Args:
    logits: [...] log odds of being occupied.
    occupancy: [...] bool, or 0 and 1.
  """
  _check_same(logits, occupancy)
  return jnp.mean(jax.nn.softplus(jnp.where(occupancy.astype(bool), -logits, logits)))


def surface_l2(prediction: jax.Array, target: jax.Array, mask: jax.Array) -> jax.Array:
  """Mean Euclidean distance over surface voxels (equations 3, 5 and 7).

  Its gradient is 0 where prediction and target are equal.

  >>> prediction, target = jnp.array([[3.0, 4.0], [9.0, 9.0]]), jnp.zeros((2, 2))
  >>> surface_l2(prediction, target, jnp.array([True, False]))
  Array(5., dtype=float32)

  Args:
    prediction: [..., C].
    target: [..., C].
    mask: [...] bool, the surface voxels.
  """
  squared = jnp.sum(_masked_difference(prediction, target, mask) ** 2, axis=-1)
  # The inner where keeps the square root's infinite slope out of the gradient.
  positive = squared > 0
  distance = jnp.where(positive, jnp.sqrt(jnp.where(positive, squared, 1)), 0)
  return jnp.sum(distance) / _count(mask)


def surface_l1(prediction: jax.Array, target: jax.Array, mask: jax.Array) -> jax.Array:
  """Mean absolute difference over the channel entries of surface voxels: the authors' program.

  Its gradient is 0 where an entry of prediction and target are equal.

  Args:
    prediction: [..., C].
    target: [..., C].
    mask: [...] bool, the surface voxels.
  """
  difference = _masked_difference(prediction, target, mask)
  # Not jnp.abs: its slope at 0 is 1, and the authors' framework's, as the sign's, is 0.
  total = jnp.sum(difference * jnp.sign(difference))
  return total / (_count(mask) * target.shape[-1])


def joint_l2(prediction: jax.Array, target: jax.Array) -> jax.Array:
  """Mean over all voxels, empty ones included, of the squared Euclidean distance.

  The loss of the adapted 3D-R2N2 (section 4, competing methods), whose empty voxels are -0.5 in
  every channel. Squared, as the text writes an L2 loss out for shapes (section 3.2).

  Args:
    prediction: [..., C].
    target: [..., C].
  """
  _check_same(prediction, target)
  return jnp.mean(jnp.sum((prediction - target) ** 2, axis=-1))


def color_objective(
  regressed: jax.Array,
  blended: jax.Array,
  flow: jax.Array,
  target_color: jax.Array,
  target_flow: jax.Array,
  mask: jax.Array,
  *,
  distance: Callable[[jax.Array, jax.Array, jax.Array], jax.Array] = surface_l2,
) -> tuple[jax.Array, ColorTerms]:
  """L_flow + L_clr_regress + L_blend (equation 8).

  Args:
    regressed: [..., 3] regressed colours.
    blended: [..., 3] blend of sampled and regressed colours.
    flow: [..., 2] estimated (u, v).
    target_color: [..., 3].
    target_flow: [..., 2].
    mask: [...] bool, the surface voxels.
    distance: `surface_l2` (the text) or `surface_l1` (the authors' program).

  Returns:
    (sum of the terms, the terms).
  """
  terms = ColorTerms(
    flow=distance(flow, target_flow, mask),
    regressed=distance(regressed, target_color, mask),
    blended=distance(blended, target_color, mask),
  )
  return sum(terms), terms


def _masked_difference(prediction, target, mask):
  _check_same(prediction, target)
  if mask.shape != target.shape[:-1]:
    raise ValueError(f'mask {mask.shape} does not fit voxels {target.shape[:-1]}')
  return jnp.where(mask[..., None], prediction - target, 0)


def _masked_mean(x, mask):
  return jnp.sum(jnp.where(mask, x, 0)) / _count(mask)


def _count(mask):
  """How many are True, as a divisor: at least 1."""
  return jnp.maximum(jnp.sum(mask), 1).astype(jnp.float32)


def _check_same(prediction, target):
  if prediction.shape != target.shape:
    raise ValueError(f'prediction {prediction.shape} and target {target.shape} differ')
