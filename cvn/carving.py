"""Space carving of an estimated shape by the silhouette of its view.

A voxel that projects off the view's silhouette is empty, however sure the network is of it; and
some voxel along the ray of a silhouette's pixel must be occupied, so probabilities are relative to
the largest one along their ray. Where the network is unsure, this fills the inside of the
silhouette, but occupancy is the surface: what lies deep inside is emptied again. The azimuth of the
view is not known and is estimated from the shape: the better the silhouette of the estimate, seen
from an azimuth, agrees with the view's, the likelier the azimuth. This goes beyond the paper, which
uses the camera for the target flows alone (section 3.3).
"""

import functools
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from cvn import camera, grid
from cvn.metrics import OCCUPIED

# How fast an azimuth's weight falls with the IoU of its silhouette, chosen on a validation split.
SHARPNESS = 30.0
# The result is at least this share of what the likeliest azimuth alone leaves: thin parts, on which
# azimuths disagree, would be lost in the mean.
LIKELIEST = 0.9
# Floor on the largest probability along a ray: a ray with none above 0.5 is not normalised to 1.
EVEN = 0.5
# A voxel lies inside if all voxels as near as this have this share of its value at least; both were
# chosen on a validation split.
DEPTH, INSIDE = 2, 0.9


@functools.partial(jax.jit, static_argnames='azimuths')
def carve(
  probability: Any, foreground: Any, *, azimuths: Sequence[float] = camera.AZIMUTHS
) -> jax.Array:
  """Occupancy [B, X, Y, Z] in [0, 1] that agrees with the silhouettes.

  Seen from an azimuth, a voxel that projects off the foreground has 0, any other its probability
  divided by the largest one that projects to its pixel or the pixels around it, or by 0.5 if that
  is more. From this follows the mean over the azimuths, weighted by `azimuth_weights`, or 0.9 of
  the likeliest azimuth's value if that is more. A voxel that lies inside, where the cube of 5^3
  voxels around it has nothing below 0.9 of its value, gets 0.

  Args:
    probability: [B, X, Y, Z] of being occupied.
    foreground: [B, H, W] bool, square, of views with the camera of cvn.camera.
    azimuths: a tuple, degrees: those that the view may have been taken from.

  Raises:
    ValueError: the arrays do not fit.
  """

  def add(found, seen):
    mean, best = found
    pixels, weights, likeliest = seen
    largest = _draw(probability, pixels, foreground.shape[1:])
    largest = _window(largest, -jnp.inf, jax.lax.max)
    explained = probability / jnp.maximum(_look_up(largest, pixels, probability), EVEN)
    left = jnp.where(_look_up(foreground, pixels, probability), explained, 0)
    mean = mean + weights[:, None, None, None] * left
    return (mean, jnp.where(likeliest[:, None, None, None], left, best)), None

  pixels = _project(probability, foreground, azimuths)
  weights = _weigh(probability, foreground, pixels)
  likeliest = jax.nn.one_hot(jnp.argmax(weights, axis=0), len(weights), axis=0, dtype=bool)
  none = jnp.zeros_like(probability)
  (mean, best), _ = jax.lax.scan(add, (none, none), (pixels, weights, likeliest))
  carved = jnp.maximum(mean, LIKELIEST * best)
  return jnp.where(_least_around(carved) < INSIDE * carved, carved, 0)


@functools.partial(jax.jit, static_argnames='azimuths')
def azimuth_weights(
  probability: Any, foreground: Any, *, azimuths: Sequence[float] = camera.AZIMUTHS
) -> jax.Array:
  """How likely each azimuth is: a softmax over the azimuths' IoU of two silhouettes.

  One is the foreground, the other that of the voxels with a probability of at least 0.8, seen from
  the azimuth.

  Args:
    probability: [B, X, Y, Z] of being occupied.
    foreground: [B, H, W] bool, square.
    azimuths: a tuple, degrees.

  Returns:
    [B, A].
  """
  return _weigh(probability, foreground, _project(probability, foreground, azimuths)).T


def _least_around(volume):
  """The smallest value within DEPTH voxels along every axis."""
  window = (1, *[2 * DEPTH + 1] * 3)
  return jax.lax.reduce_window(volume, jnp.inf, jax.lax.min, window, (1,) * 4, 'SAME')


def _weigh(probability, foreground, pixels):
  """The weights [A, B] of the azimuths from which voxels project to `pixels`."""

  def agree(pixels):
    seen = _close(_draw(probability >= OCCUPIED, pixels, foreground.shape[1:]))
    union = jnp.sum(seen | foreground, (1, 2))
    return jnp.sum(seen & foreground, (1, 2)) / jnp.maximum(union, 1)

  return jax.nn.softmax(SHARPNESS * jax.lax.map(agree, pixels), axis=0)


def _project(probability, foreground, azimuths):
  """The pixels (row, column) that voxels' centres project to from each azimuth, [A, X * Y * Z]."""
  size, image = probability.shape[1:], foreground.shape[1:]
  if len(set(size)) > 1 or len(set(image)) > 1 or len(probability) != len(foreground):
    raise ValueError(
      f'[B, X, X, X] and [B, H, H] are needed: {probability.shape}, {foreground.shape}'
    )
  index = np.stack(np.meshgrid(*map(np.arange, size), indexing='ij'), -1).reshape(-1, 3)
  centers = jnp.asarray(grid.index_to_world(index, size=size[0]), jnp.float32)
  cameras = [camera.camera_at(a, image_size=image[0]) for a in azimuths]
  cameras = jax.tree.map(lambda *x: jnp.asarray(np.stack(x), jnp.float32), *cameras)

  def project(view):
    with jax.default_matmul_precision('highest'):
      pixel, _ = camera.project(centers, view)
    column, row = jnp.clip(jnp.floor(pixel).astype(jnp.int32), 0, image[0] - 1).T
    return row, column

  return jax.lax.map(project, cameras)


def _draw(volume, pixels, size):
  """The largest value that projects to each pixel, [B, H, W]; 0 where none does."""
  values = volume.reshape(len(volume), -1)
  return jnp.zeros((len(volume), *size), volume.dtype).at[:, *pixels].max(values)


def _look_up(image, pixels, volume):
  """The pixels [B, H, W] of all voxels, in the shape of the volume."""
  return image[:, *pixels].reshape(volume.shape)


def _window(image, start, reduce):
  return jax.lax.reduce_window(image, start, reduce, (1, 3, 3), (1, 1, 1), 'SAME')


def _close(mask):
  """Closes the gaps of a pixel that voxels, drawn as points, leave between them."""
  return _window(_window(mask, False, jnp.logical_or), True, jnp.logical_and)
