"""The faces between occupied and empty voxels: the visible boundary of a coloured shape.

Corners are points of the lattice formed by the voxels' corners: (i, j, k) is the lower corner of
voxel (i, j, k); the outermost ones lie on the cube's surface.
"""

from typing import NamedTuple

import numpy as np


class Faces(NamedTuple):
  """Unit squares between an occupied voxel and an empty one, or the outside."""

  voxel: np.ndarray  # [F, 3] the occupied one
  corners: np.ndarray  # [F, 4, 3] lattice points, counter-clockwise seen from outside
  axis: np.ndarray  # [F] that the face is perpendicular to: 0, 1 or 2
  sign: np.ndarray  # [F] of the outward direction along it: -1 or 1


def find_faces(occupancy: np.ndarray) -> Faces:
  """The faces of an occupancy [X, Y, Z] bool."""
  padded = np.pad(occupancy, 1)
  parts = []
  for axis in range(3):
    # Around the face, counter-clockwise seen from the axis's positive end.
    ring = np.zeros((4, 3), int)
    ring[:, (axis + 1) % 3] = (0, 1, 1, 0)
    ring[:, (axis + 2) % 3] = (0, 0, 1, 1)
    for sign in (-1, 1):
      neighbour = np.roll(padded, -sign, axis)[1:-1, 1:-1, 1:-1]
      voxel = np.argwhere(occupancy & ~neighbour)
      around = ring[::sign].copy()
      around[:, axis] = (sign + 1) // 2
      count = len(voxel)
      parts.append(
        Faces(voxel, voxel[:, None] + around, np.full(count, axis), np.full(count, sign))
      )
  return Faces(*(np.concatenate(x) for x in zip(*parts, strict=True)))
