"""The two recipes: `paper` does what the text says, `release` what the authors' program does.

Both run through the same code; BUILD_NOTES.md has a row for every difference.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from cvn import losses, sampler


class Recipe(NamedTuple):
  """How a network is trained. Schedules are functions of the samples seen so far."""

  name: str
  shape_loss: Callable  # (logits, occupancy) -> scalar
  surface_distance: Callable  # (prediction, target, mask) -> scalar, of the three colour terms
  sample: Callable  # (image, flow) -> colours, in training
  kernel_penalty: float  # times the sum of absolute kernel values, added to the loss
  learning_rate: Callable[[jax.Array], jax.Array]


def _constant(value):
  return lambda samples: jnp.full_like(samples, value)


def _release_learning_rate(samples):
  return jnp.maximum(3e-4 * 0.7 ** jnp.floor(samples / 20000), 1e-5)


def norm_decay(samples: jax.Array, batch_size: int) -> jax.Array:
  """Decay of the running BatchNorm statistics: the authors' program's, the text says nothing.

  Theirs is for batches of 60. Smaller ones keep more of what was, so that the memory is of as many
  samples: half of it goes in 60 at first, whatever the batch.
  """
  decay = jnp.minimum(1 - 0.5 * 0.5 ** jnp.floor(samples / 20000), 0.99)
  return decay ** (batch_size / 60)


PAPER = Recipe(
  'paper',
  shape_loss=losses.msfcel,
  surface_distance=losses.surface_l2,
  sample=sampler.bilinear,
  kernel_penalty=0.0,
  learning_rate=_constant(3e-4),
)
RELEASE = Recipe(
  'release',
  shape_loss=losses.msfcel,
  surface_distance=losses.surface_l1,
  sample=sampler.nearest,
  kernel_penalty=1e-5,
  learning_rate=_release_learning_rate,
)
RECIPES = {r.name: r for r in (PAPER, RELEASE)}
