"""The colour that most of the surface in a voxel has.

The mean of red and white is pink, which no view shows. So areas are counted in a coarse histogram
of RGB a voxel, and the voxel takes the mean colour of the 2 x 2 x 2 neighbouring bins that hold
the largest area together. What differs by less than a bin in each channel is always together,
wherever the bins' borders lie; a grain or a shade is averaged, and two materials are not.
"""

import itertools
from typing import NamedTuple

import numpy as np

LEVELS = 8  # bins a channel; what differs by more than 2 / LEVELS is apart
CHUNK = 1 << 15  # bins looked at together; bounds the memory

_BINS = LEVELS**3
_CORNERS = np.array(list(itertools.product((0, 1), repeat=3)))


class Tally(NamedTuple):
  """Areas and colours by voxel and bin, the K of them that hold something."""

  key: np.ndarray  # [K] int64, voxel * LEVELS^3 + bin, in order
  total: np.ndarray  # [K, 4] float64: area times r, g, b; area


EMPTY = Tally(np.empty(0, np.int64), np.empty((0, 4)))


def add(tally: Tally, voxel: np.ndarray, area: np.ndarray, color: np.ndarray) -> Tally:
  """The tally with more pieces of surface in it.

  Args:
    tally: what is counted so far.
    voxel: [N] int64, the pieces' voxels by any number from 0.
    area: [N] above 0, in any unit.
    color: [N, 3] in [0, 1].
  """
  r, g, b = np.clip((color * LEVELS).astype(np.int64), 0, LEVELS - 1).T
  key = voxel * _BINS + (r * LEVELS + g) * LEVELS + b
  piece = area[:, None] * np.append(color, np.ones((len(color), 1)), 1)
  return _merged(np.append(tally.key, key), np.append(tally.total, piece, 0))


def dominant_colors(tally: Tally) -> tuple[np.ndarray, np.ndarray]:
  """The voxels that hold something, and their colours.

  Returns:
    (voxel [M] in order, color [M, 3] in [0, 1]).
  """
  of_voxel = tally.key // _BINS
  starts = np.searchsorted(of_voxel, of_voxel[::CHUNK])  # no voxel is in two parts
  voxel, color = [np.empty(0, np.int64)], [np.empty((0, 3))]
  for begin, end in itertools.pairwise(np.unique(np.append(starts, len(of_voxel)))):
    found = _largest(Tally(tally.key[begin:end], tally.total[begin:end]))
    voxel.append(found[0])
    color.append(found[1])
  return np.concatenate(voxel), np.concatenate(color)


def _largest(tally):
  """The same, all at once: by voxel and window, a window being 2 x 2 x 2 bins."""
  voxel, bins = np.divmod(tally.key, _BINS)
  # A bin is in the windows that begin in it and one below it, along each axis, counted from 1.
  low = np.stack(np.unravel_index(bins, (LEVELS,) * 3), -1)[:, None] + _CORNERS
  side = LEVELS + 1
  window = (low[..., 0] * side + low[..., 1]) * side + low[..., 2]
  key, total = _merged(
    (voxel[:, None] * side**3 + window).ravel(), np.repeat(tally.total, len(_CORNERS), 0)
  )
  voxel = key // side**3
  order = np.lexsort((total[:, 3], voxel))
  best = order[np.diff(voxel[order], append=-1) != 0]
  return voxel[best], total[best, :3] / total[best, 3:]


def _merged(key, total):
  """Adds up the rows of equal keys."""
  key, group = np.unique(key, return_inverse=True)
  return Tally(key, np.stack([np.bincount(group, t, len(key)) for t in total.T], -1))
