"""The dominant colour of the surface in a voxel.

The mean of red and white is pink, which no view shows. So the area in a voxel is counted in a
coarse RGB histogram, and the voxel takes the mean colour of the 2 x 2 x 2 neighbouring bins with
the largest total area. Colours that differ by less than a bin in every channel always share such a
window, so grain and shading are averaged and two materials are not.
"""

import itertools
from typing import NamedTuple

import numpy as np

LEVELS = 8  # bins a channel; what differs by more than 2 / LEVELS is apart
CHUNK = 1 << 15  # bins looked at together; bounds the memory

_CORNERS = np.array(list(itertools.product((0, 1), repeat=3)))


class Tally(NamedTuple):
  """Areas and colours of the K nonempty pairs of voxel and bin."""

  key: np.ndarray  # [K] int64, voxel * LEVELS^3 + bin, in order
  total: np.ndarray  # [K, 4] float64: area times r, g, b; area


EMPTY = Tally(np.empty(0, np.int64), np.empty((0, 4)))


def add(tally: Tally, voxel: np.ndarray, area: np.ndarray, color: np.ndarray) -> Tally:
  """Adds pieces of surface to the tally.

  Args:
    tally: the counts so far.
    voxel: [N] int64, the voxel of each piece, any numbers from 0.
    area: [N] above 0, in any unit.
    color: [N, 3] in [0, 1].
  """
  bins = np.clip((color * LEVELS).astype(np.int64), 0, LEVELS - 1)
  key = voxel * LEVELS**3 + _joined(bins, LEVELS)
  piece = area[:, None] * np.append(color, np.ones((len(color), 1)), 1)
  return _merged(np.append(tally.key, key), np.append(tally.total, piece, 0))


def dominant_colors(tally: Tally) -> tuple[np.ndarray, np.ndarray]:
  """The nonempty voxels and their dominant colours.

  Returns:
    (voxel [M] in order, color [M, 3] in [0, 1]).
  """
  of_voxel, bins = _split(tally.key)
  starts = np.flatnonzero(np.diff(of_voxel, prepend=-1))
  total = np.add.reduceat(tally.total, starts)
  # In most voxels one window holds everything.
  spread = np.maximum.reduceat(bins, starts) - np.minimum.reduceat(bins, starts)
  mixed = np.flatnonzero((spread > 1).any(-1))
  voxel = of_voxel[starts]
  rest = np.isin(of_voxel, voxel[mixed])
  total[mixed] = _largest_windows(Tally(tally.key[rest], tally.total[rest]))
  return voxel, total[:, :3] / total[:, 3:]


def _largest_windows(tally):
  """Totals [M, 4] of the 2 x 2 x 2 bins with the largest area, a row for each nonempty voxel."""
  of_voxel, bins = _split(tally.key)
  cuts = np.searchsorted(of_voxel, of_voxel[::CHUNK])  # no voxel is in two parts
  result = [np.empty((0, 4))]
  for begin, end in itertools.pairwise(np.unique(np.append(cuts, len(of_voxel)))):
    # A bin is in the windows that begin in it and one below it, along each axis, counted from 1.
    window = _joined(bins[begin:end, None] + _CORNERS, LEVELS + 1)
    key = of_voxel[begin:end, None] * (LEVELS + 1) ** 3 + window
    key, total = _merged(key.ravel(), np.repeat(tally.total[begin:end], len(_CORNERS), 0))
    voxel = key // (LEVELS + 1) ** 3
    order = np.lexsort((total[:, 3], voxel))
    result.append(total[order[np.diff(voxel[order], append=-1) != 0]])
  return np.concatenate(result)


def _split(key):
  """The voxels [K] and bins [K, 3] of keys [K]."""
  voxel, bins = np.divmod(key, LEVELS**3)
  return voxel, np.stack(np.unravel_index(bins, (LEVELS,) * 3), -1)


def _joined(bins, side):
  """Combines [..., 3] numbers below `side` into [...] one number."""
  return (bins[..., 0] * side + bins[..., 1]) * side + bins[..., 2]


def _merged(key, total):
  """Adds up rows with equal keys."""
  key, group = np.unique(key, return_inverse=True)
  return Tally(key, np.stack([np.bincount(group, t, len(key)) for t in total.T], -1))
