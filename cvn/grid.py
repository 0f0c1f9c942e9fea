"""The voxel grid: `size`^3 voxels that fill the cube [-0.5, 0.5]^3 of the object's frame.

World axes are right-handed: x right, y up, z out of the object's front. A volume is an array
[..., X, Y, Z, C] whose axes are the Cartesian axes in order, and voxel (i, j, k) has its centre at
((i, j, k) + 0.5) / size - 0.5. This is the one file that knows it. Functions take numpy and jax
arrays alike.
"""

from typing import Any, NamedTuple

import numpy as np

GRID_SIZE = 64
PADDING_INDEX = 255  # an index no grid has: scatters and gathers with mode 'drop' / 'fill' skip it

# The longest side of a normalised object leaves one voxel of the default grid free at either end.
OBJECT_EXTENT = 1 - 2 / GRID_SIZE


class ColoredVoxels(NamedTuple):
  """A coloured shape: colours mean something on occupied voxels only."""

  occupancy: Any  # [X, Y, Z] bool
  color: Any  # [X, Y, Z, 3] float in [0, 1], sRGB


def to_voxels(index: Any, color: Any, *, size: int = GRID_SIZE) -> ColoredVoxels:
  """A list of surface voxels as volumes, black where empty.

  Args:
    index: [S, 3] integer, PADDING_INDEX where there is none.
    color: [S, 3] in [0, 1].
    size: of the grid.
  """
  index, color = np.asarray(index), np.asarray(color)
  real = index[:, 0] != PADDING_INDEX
  at = tuple(index[real].T)
  voxels = ColoredVoxels(np.zeros((size,) * 3, bool), np.zeros((size,) * 3 + (3,), color.dtype))
  voxels.occupancy[at] = True
  voxels.color[at] = color[real]
  return voxels


def index_to_world(index: Any, *, size: int = GRID_SIZE) -> Any:
  """Centres of voxels: [..., 3] integer indices -> [..., 3] world coordinates in [-0.5, 0.5].

  >>> index_to_world(np.array([0, 32, 63]))
  array([-0.4921875,  0.0078125,  0.4921875])
  """
  return (2 * index + 1) / (2 * size) - 0.5  # whole numbers as long as possible: no promotion


def world_to_grid(points: Any, *, size: int = GRID_SIZE) -> Any:
  """World coordinates [..., 3] -> continuous grid coordinates, where voxel i spans [i, i + 1)."""
  return (points + 0.5) * size
