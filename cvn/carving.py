"""Space carving of an estimated shape by the silhouette of its view.

A voxel that projects off the view's silhouette is empty, however sure the network is of it. Which
azimuth the view was taken from is not known; it is told from the shape itself: the better the
silhouette of the estimate, seen from an azimuth, agrees with the view's, the likelier the azimuth.
Beyond the paper, which uses the camera for the target flows alone (section 3.3).
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


@functools.partial(jax.jit, static_argnames='azimuths')
def carve(
  probability: Any, foreground: Any, azimuths: Sequence[float] = camera.AZIMUTHS
) -> jax.Array:
  """Occupancy [B, X, Y, Z] times how surely each voxel lies inside the silhouette, in [0, 1].

  Inside is what projects onto the foreground, in the mean over the azimuths with
  `azimuth_weights`. A foreground that is the whole image changes nothing.

  Args:
    probability: [B, X, Y, Z] of being occupied.
    foreground: [B, H, W] bool, square, of views with the camera of cvn.camera.
    azimuths: a tuple, degrees: those that the view may have been taken from.
  """
  inside, agreement = _compare(probability, foreground, azimuths)
  weights = jax.nn.softmax(SHARPNESS * agreement, axis=0)
  return probability * jnp.einsum('ab,abxyz->bxyz', weights, inside.astype(jnp.float32))


@functools.partial(jax.jit, static_argnames='azimuths')
def azimuth_weights(
  probability: Any, foreground: Any, azimuths: Sequence[float] = camera.AZIMUTHS
) -> jax.Array:
  """How likely each azimuth is, [B, A], a softmax; arguments as of `carve`.

  Of each azimuth counts the IoU of two silhouettes: the foreground, and that of the voxels with a
  probability of at least 0.8 seen from there.
  """
  return jax.nn.softmax(SHARPNESS * _compare(probability, foreground, azimuths)[1], axis=0).T


def _compare(probability, foreground, azimuths):
  """For each azimuth: which voxels are inside [A, B, X, Y, Z], the silhouettes' IoU [A, B]."""
  size, image = probability.shape[1:], foreground.shape[1:]
  if len(set(size)) > 1 or len(set(image)) > 1 or len(probability) != len(foreground):
    raise ValueError(f'[B, X, X, X] and [B, H, H] are due: {probability.shape}, {foreground.shape}')
  cameras = [camera.camera_at(a, image_size=image[0]) for a in azimuths]
  occupied = (probability >= OCCUPIED).reshape(len(probability), -1)
  centers = grid.index_to_world(
    np.stack(np.meshgrid(*map(np.arange, size), indexing='ij'), -1).reshape(-1, 3), size=size[0]
  )

  def compare(view):
    with jax.default_matmul_precision('highest'):
      pixel, _ = camera.project(jnp.asarray(centers, jnp.float32), view)
    column, row = jnp.clip(jnp.floor(pixel).astype(jnp.int32), 0, image[0] - 1).T
    drawn = jnp.zeros(foreground.shape, bool).at[:, row, column].max(occupied)
    seen = _close(drawn)
    union = jnp.sum(seen | foreground, (1, 2))
    agreement = jnp.sum(seen & foreground, (1, 2)) / jnp.maximum(union, 1)
    return foreground[:, row, column].reshape(probability.shape), agreement

  views = jax.tree.map(lambda *x: jnp.asarray(np.stack(x), jnp.float32), *cameras)
  return jax.lax.map(compare, views)


def _close(mask):
  """Closes the gaps of a pixel that voxels, drawn as points, leave between them."""

  def window(x, start, reduce):
    return jax.lax.reduce_window(x, start, reduce, (1, 3, 3), (1, 1, 1), 'SAME')

  return window(window(mask, False, jnp.logical_or), True, jnp.logical_and)
