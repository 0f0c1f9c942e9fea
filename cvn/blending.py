"""Blending sampled and regressed colours; the colours of the joint baseline.

The weight w in [0, 1] is the confidence of the sampled colour, 1 - w that of the regressed one.
"""

import jax
import jax.numpy as jnp

from cvn.errors import UserError

ALPHA = 0.2  # the authors' choice


def blend(sampled: jax.Array, regressed: jax.Array, weight: jax.Array) -> jax.Array:
  """w sampled + (1 - w) regressed (equation 6).

  Args:
    sampled: [..., 3].
    regressed: [..., 3].
    weight: [..., 1].

  Raises:
    ValueError: the shapes do not fit.
  """
  if weight.shape != (*sampled.shape[:-1], 1) or regressed.shape != sampled.shape:
    raise ValueError(
      f'sampled {sampled.shape}, regressed {regressed.shape} and weight {weight.shape} do not fit'
    )
  return weight * sampled + (1 - weight) * regressed


def recalculate_weight(weight: jax.Array, *, alpha: float = ALPHA) -> jax.Array:
  """The test-time weight: w / alpha where w <= alpha, else 1 (section 3.5).

  >>> recalculate_weight(jnp.array([0.1, 0.2, 0.9]), alpha=0.2)
  Array([0.5, 1. , 1. ], dtype=float32)

  Args:
    weight: [...] as estimated, the confidence of the sampled colour.
    alpha: in (0, 1]; 1 leaves the weight as it is, smaller ones favour the sampled colour.

  Raises:
    UserError: alpha is outside (0, 1].
  """
  if not 0 < alpha <= 1:
    raise UserError(f'alpha must be above 0 and at most 1, not {alpha}')
  return jnp.minimum(weight / alpha, 1)


def adjust_color(predicted: jax.Array, threshold: float) -> tuple[jax.Array, jax.Array]:
  """Occupancy and colour of the joint baseline's volume (equation 9).

  A voxel is occupied where all its channels are above the threshold t; its colour is
  (c - t) / (1 - t).

  Args:
    predicted: [..., 3]; empty is -0.5.
    threshold: below 1.

  Returns:
    (occupancy [...] bool, color [..., 3] in [0, 1]; it means something where occupied).

  Raises:
    UserError: the threshold is 1 or above.
  """
  if not threshold < 1:
    raise UserError(f'the threshold must be below 1, not {threshold}')
  color = jnp.clip((predicted - threshold) / (1 - threshold), 0, 1)
  return jnp.all(predicted > threshold, axis=-1), color
