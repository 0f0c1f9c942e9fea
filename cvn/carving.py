"""Space carving of an estimated shape by the silhouette of its view.

A voxel that projects off the view's silhouette is empty, however sure the network is of it; and
the ray of a silhouette's pixel must meet the surface, so probabilities are raised along a ray that
meets too little of it. The azimuth of the view is not known and is estimated from the shape: the
better the silhouette of the estimate, seen from an azimuth, agrees with the view's, the likelier
the azimuth. This goes beyond the paper, which uses the camera for the target flows alone (section
3.3).
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
# Probabilities are raised until this many occupied voxels can be expected along a ray. Occupancy is
# the surface, which a ray meets in front and behind: where an unsure network spreads probability
# over the inside, enough is expected already, and raising it would fill the inside.
EXPECTED = 2.0
MOST = 2.0  # the largest factor, so that nothing likely comes from nothing


@functools.partial(jax.jit, static_argnames='azimuths')
def carve(
  probability: Any, foreground: Any, *, azimuths: Sequence[float] = camera.AZIMUTHS
) -> jax.Array:
  """Occupancy [B, X, Y, Z] in [0, 1] that agrees with the silhouettes.

  Seen from an azimuth, a voxel that projects off the foreground has 0. The probability of any other
  voxel is raised until `EXPECTED` occupied voxels can be expected along its ray, the largest
  probability there is 1, or the factor is `MOST`; the ray of a voxel is all that projects to its
  pixel and the eight around it. The result is the mean over the azimuths, weighted by
  `azimuth_weights`, or 0.9 of the likeliest azimuth's value if that is more.

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
    explained = probability * _look_up(_raise(probability, pixels, foreground), pixels, probability)
    left = jnp.where(_look_up(foreground, pixels, probability), explained, 0)
    mean = mean + weights[:, None, None, None] * left
    return (mean, jnp.where(likeliest[:, None, None, None], left, best)), None

  pixels = _project(probability, foreground, azimuths)
  weights = _weigh(probability, foreground, pixels)
  likeliest = jax.nn.one_hot(jnp.argmax(weights, axis=0), len(weights), axis=0, dtype=bool)
  none = jnp.zeros_like(probability)
  (mean, best), _ = jax.lax.scan(add, (none, none), (pixels, weights, likeliest))
  return jnp.maximum(mean, LIKELIEST * best)


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


def _raise(probability, pixels, foreground):
  """By what factor probabilities are raised along the rays of all pixels, [B, H, W]."""
  values = probability.reshape(len(probability), -1)
  none = jnp.zeros(foreground.shape, probability.dtype)
  largest = _window(none.at[:, *pixels].max(values), -jnp.inf, jax.lax.max)
  total = _window(none.at[:, *pixels].add(values), 0.0, jax.lax.add)
  # Several columns of voxels project to the nine pixels: each covers a square of this side.
  side = foreground.shape[1] / (2 * camera.HALF_WIDTH * camera.DISTANCE) / probability.shape[1]
  expected = total * side**2 / 9
  enough = jnp.maximum(EXPECTED / jnp.maximum(expected, 1e-6), 1)
  return jnp.minimum(jnp.minimum(1 / jnp.maximum(largest, 1e-6), enough), MOST)


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
