"""The recipes: `paper` does what the text says, `release` what the authors' program does.

`best` is the text's with what more was found to help (BUILD_NOTES.md). All run through the same
code; BUILD_NOTES.md has a row for every difference.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import optax

from cvn import losses, sampler


class Recipe(NamedTuple):
  """How a network is trained."""

  name: str
  shape_loss: Callable  # (logits, occupancy) -> scalar
  surface_distance: Callable  # (prediction, target, mask) -> scalar, for the three colour terms
  sample: Callable  # (image, flow) -> colours, in training
  kernel_penalty: float  # weight of the sum of absolute kernel values in the loss
  learning_rate: float  # of the first step
  schedule: Callable[[float, float], optax.Schedule]  # (first rate, samples in all) -> schedule
  mirror: bool  # whether half of the samples are mirrored, image and object
  recolor: bool  # whether samples get other colours, image and object


# A schedule here is a function of the samples seen, not of the steps: it does not depend on the
# batch size.


def constant(learning_rate: float, total: float) -> optax.Schedule:
  """The learning rate stays (section 4: 0.0003)."""
  del total
  return optax.constant_schedule(learning_rate)


def staircase(learning_rate: float, total: float) -> optax.Schedule:
  """The authors' program: times 0.7 every 20,000 samples, from 3e-4 down to 1e-5."""
  del total
  return optax.exponential_decay(
    learning_rate, 20000, 0.7, staircase=True, end_value=learning_rate / 30
  )


def cosine(learning_rate: float, total: float) -> optax.Schedule:
  """Half a cosine, down to 0 at the end of the training."""
  return optax.cosine_decay_schedule(learning_rate, total)


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
  learning_rate=3e-4,
  schedule=constant,
  mirror=False,
  recolor=False,
)
RELEASE = PAPER._replace(
  name='release',
  surface_distance=losses.surface_l1,
  sample=sampler.nearest,
  kernel_penalty=1e-5,
  schedule=staircase,
)
BEST = PAPER._replace(
  name='best', sample=sampler.bilinear_foreground, schedule=cosine, mirror=True, recolor=True
)
RECIPES = {r.name: r for r in (PAPER, RELEASE, BEST)}
SCHEDULES = {s.__name__: s for s in (constant, staircase, cosine)}
