"""Lifting: an image's features, carried into the object's volume along the camera's rays.

A frustum [B, V, U, D, C] holds features of an image of V rows and U columns at D depths. Its cells
are equal shares of the image and of the depths from NEAR to FAR, which hold the whole cube at every
azimuth. The volume is the object's, [B, X, Y, Z, C] (cvn.grid), and the cameras are those of
cvn.camera: they circle at elevation 0, so the column u and the depth of a voxel depend on x, z and
the azimuth alone, and with the depth known, its row v depends on y alone. So lifting is separable:
rows are interpolated once for each depth, whatever the azimuth, and each vertical column of voxels
is then a mean of four columns of the frustum.
"""

import functools
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from cvn import camera, grid

NEAR, FAR = camera.DISTANCE - 0.7, camera.DISTANCE + 0.7  # world units along the viewing axis


class Rays(NamedTuple):
  """Where voxels lie in a frustum, for every azimuth."""

  rows: np.ndarray  # [D, Y, V] weights of the frustum's rows
  cells: np.ndarray  # [A, X * Z, 4] int32, u * D + d
  weights: np.ndarray  # [A, X * Z, 4] of these cells


@functools.lru_cache
def make_rays(azimuths: Sequence[float], *, grid_size: int, image_size: int, depths: int) -> Rays:
  """The constants of a lifting.

  Args:
    azimuths: a tuple, degrees.
    grid_size: X = Y = Z.
    image_size: U = V.
    depths: D.
  """
  axis = grid.index_to_world(np.arange(grid_size), size=grid_size)
  x, z = (v.ravel() for v in np.meshgrid(axis, axis, indexing='ij'))
  ground = np.stack([x, np.zeros_like(x), z], -1)
  cells, weights = [], []
  for azimuth in azimuths:
    pixel, depth = camera.project(ground, camera.camera_at(azimuth, image_size=image_size))
    (u0, u1), wu = _cell(pixel[:, 0], image_size)
    (d0, d1), wd = _cell((depth - NEAR) / (FAR - NEAR) * depths, depths)
    corners = [(u0, 1 - wu, d0, 1 - wd), (u0, 1 - wu, d1, wd)]
    corners += [(u1, wu, d0, 1 - wd), (u1, wu, d1, wd)]
    cells.append(np.stack([u * depths + d for u, _, d, _ in corners], -1))
    weights.append(np.stack([a * b for _, a, _, b in corners], -1))
  rows = np.zeros((depths, grid_size, image_size))
  for d, depth in enumerate(NEAR + (np.arange(depths) + 0.5) / depths * (FAR - NEAR)):
    # A point straight ahead of the camera, at every height of the grid.
    points = np.stack([np.zeros_like(axis), axis, np.full_like(axis, camera.DISTANCE - depth)], -1)
    pixel, _ = camera.project(points, camera.camera_at(0, image_size=image_size))
    (v0, v1), wv = _cell(pixel[:, 1], image_size)
    np.add.at(rows[d], (np.arange(grid_size), v0), 1 - wv)
    np.add.at(rows[d], (np.arange(grid_size), v1), wv)
  return Rays(
    rows.astype(np.float32),
    np.stack(cells).astype(np.int32),
    np.stack(weights).astype(np.float32),
  )


def lift(frustum: jax.Array, azimuths: jax.Array, shares: jax.Array, rays: Rays) -> jax.Array:
  """A frustum's features at the voxels, as a mean over azimuths that the view may be from.

  Args:
    frustum: [B, V, U, D, C].
    azimuths: [B, K] integer, rows of `rays`.
    shares: [B, K] of the mean.
    rays: for the sizes of the frustum.

  Returns:
    [B, X, Y, Z, C], of the frustum's type.

  Raises:
    ValueError: the shapes do not fit.
  """
  b, v, u, d, c = frustum.shape
  depths, y, rows = rays.rows.shape
  if (rows, depths) != (v, d) or azimuths.shape != shares.shape or len(azimuths) != b:
    raise ValueError(
      f'a frustum [B, {rows}, U, {depths}, C] and azimuths and shares [B, K] are due:'
      f' {frustum.shape}, {azimuths.shape}, {shares.shape}'
    )
  columns = jnp.einsum('dyv,bvudc->budyc', rays.rows.astype(frustum.dtype), frustum)
  columns = columns.reshape(b, u * d, y * c)
  weights = (jnp.asarray(rays.weights)[azimuths] * shares[..., None, None]).astype(frustum.dtype)
  cells = jnp.asarray(rays.cells)[azimuths]  # [B, K, X * Z, 4]

  def one(columns, cells, weights):
    return jnp.einsum('knjc,knj->nc', columns[cells], weights)

  volume = jax.vmap(one)(columns, cells, weights)  # [B, X * Z, Y * C]
  return volume.reshape(b, y, y, y, c).swapaxes(2, 3)


def _cell(coordinate, size):
  """The two cells around a coordinate in [0, size] along an axis, and the second one's weight."""
  x = np.clip(coordinate - 0.5, 0, size - 1)
  low = np.minimum(np.floor(x).astype(int), size - 2)
  return (low, low + 1), x - low
