"""Colour complexity: how many colours a view shows (section "Further Analysis").

The unique colours of a whole set of views are found, rare ones left out, and the others clustered;
the complexity of a view is the number of clusters that more than a few of its pixels belong to.
Colours are 8-bit straight sRGB as stored, of foreground pixels alone: those at least half opaque.
"""

import warnings
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.cluster.vq import kmeans2
from scipy.spatial import cKDTree

from cvn.errors import UserError

T1 = 50  # the paper's: pixels of the set that a colour needs to be clustered
CLUSTERS = 128  # the paper's K
T2 = 5  # the paper's: a cluster counts in a view where more pixels than this belong to it
OPAQUE = 128  # alpha from which on a pixel is foreground, as in cvn.readouts
ITERATIONS = 100  # of K-means; the centres stand still after fewer


class Palette(NamedTuple):
  """The unique colours of some foreground pixels."""

  color: np.ndarray  # [U, 3] u8, in the order of (r, g, b)
  count: np.ndarray  # [U] int64, pixels


def find_palette(views: np.ndarray) -> Palette:
  """The palette of the foreground of views [..., 4] u8, straight alpha; it may be empty."""
  foreground = views[views[..., 3] >= OPAQUE].astype(np.int64)
  return _count(_pack(foreground), np.ones(len(foreground), np.int64))


def merge(palettes: Sequence[Palette]) -> Palette:
  """The palette of all the pixels of one or more palettes."""
  color, count = (np.concatenate(x) for x in zip(*palettes, strict=True))
  return _count(_pack(color), count)


def cluster(whole: Palette, *, t1: int = T1, clusters: int = CLUSTERS, seed: int = 0) -> np.ndarray:
  """The centres of the clusters of a set's colours.

  K-means, begun by k-means++. A colour weighs the same whatever its count: the paper clusters the
  retained colours, not the pixels.

  Args:
    whole: the palette of the set.
    t1: colours with a smaller count are left out.
    clusters: how many, K.
    seed: of K-means.

  Returns:
    [K, 3] float in [0, 255]; where no more than K colours are retained, those colours.

  Raises:
    UserError: no colour is retained.
  """
  retained = whole.color[whole.count >= t1].astype(np.float64)
  if len(retained) == 0:
    most = whole.count.max(initial=0)
    raise UserError(f'no colour has t1 = {t1} pixels, the most is {most}: take a lower t1')
  if len(retained) <= clusters:
    return retained
  with warnings.catch_warnings():
    # A cluster that loses all its colours keeps its centre, and kmeans2 warns.
    warnings.filterwarnings('ignore', 'One of the clusters is empty')
    rng = np.random.default_rng(seed)
    return kmeans2(retained, clusters, iter=ITERATIONS, minit='++', rng=rng)[0]


def complexity(palette: Palette, centers: np.ndarray, *, t2: int = T2) -> int:
  """The number of centres that are the nearest one for more than t2 pixels.

  Args:
    palette: of the foreground of a view.
    centers: [K, 3] from `cluster`.
    t2: pixels that do not count yet.
  """
  _, nearest = cKDTree(centers).query(palette.color)
  pixels = np.bincount(nearest, palette.count, len(centers))
  return int(np.sum(pixels > t2))


def _pack(color):
  """[P, 3] 8-bit colours -> [P] numbers in the same order."""
  r, g, b = color[:, 0], color[:, 1], color[:, 2]
  return r.astype(np.int64) << 16 | g.astype(np.int64) << 8 | b.astype(np.int64)


def _count(packed, count):
  unique, which = np.unique(packed, return_inverse=True)
  color = np.stack([unique >> 16, unique >> 8 & 255, unique & 255], -1).astype(np.uint8)
  total = np.zeros(len(unique), np.int64)
  np.add.at(total, which, count)
  return Palette(color, total)
