"""Measures of a reconstruction: IoU of shapes, surface PSNR of colours (section 4, evaluation).

Volumes are [..., X, Y, Z]; colours sRGB in [0, 1]; PSNR is in dB, for colours times 255.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from cvn.grid import ColoredVoxels

OCCUPIED = 0.8  # the probability from which on a voxel is occupied, in the authors' program

# The joint baseline's: half way from empty, -0.5, to black, 0.
JOINT_OCCUPIED = -0.25

# Full-range YCbCr of JPEG; its offset of 128 cancels in differences.
_YCBCR = np.array([[0.299, 0.587, 0.114], [-0.168736, -0.331264, 0.5], [0.5, -0.418688, -0.081312]])


class SurfacePsnr(NamedTuple):
  """dB in both colour spaces."""

  rgb: float
  ycbcr: float


def iou(predicted: Any, true: Any) -> Any:
  """Intersection over union of occupancies; 1 where both are empty. Takes numpy and jax arrays.

  >>> half = np.arange(8).reshape(2, 2, 2) < 4
  >>> float(iou(half, np.ones((2, 2, 2), bool)))
  0.5

  Args:
    predicted: [..., X, Y, Z] bool.
    true: [..., X, Y, Z] bool.

  Returns:
    [...].

  Raises:
    ValueError: the shapes differ.
  """
  if predicted.shape != true.shape:
    raise ValueError(f'predicted {predicted.shape} and true {true.shape} differ')
  volume = (-3, -2, -1)
  intersection = (predicted & true).sum(volume)
  union = (predicted | true).sum(volume)
  both_empty = (union == 0).astype(union.dtype)
  return (intersection + both_empty) / (union + both_empty)


def iou_at(score: np.ndarray, true: np.ndarray, thresholds: Sequence[float]) -> np.ndarray:
  """The IoU for many thresholds at once.

  Args:
    score: [X, Y, Z] occupancy scores.
    true: [X, Y, Z] bool.
    thresholds: [T], increasing.

  Returns:
    [T], as `iou(score > t, true)`.
  """
  above = np.searchsorted(thresholds, np.ravel(score), 'left')  # how many thresholds are below
  occupied = np.ravel(true)

  def count(values):
    return np.bincount(values, minlength=len(thresholds) + 1)[::-1].cumsum()[::-1][1:]

  intersection = count(above[occupied])
  union = count(above) + occupied.sum() - intersection
  return (intersection + (union == 0)) / (union + (union == 0))


def surface_psnr(predicted: ColoredVoxels, true: ColoredVoxels) -> SurfacePsnr:
  """PSNR between predicted voxels' colours and those of the nearest true surface voxels.

  Every predicted voxel is compared with one true voxel, itself where that is occupied.

  Args:
    predicted: occupancy [X, Y, Z] bool, color [X, Y, Z, 3].
    true: likewise.

  Returns:
    The two PSNRs: NaN where a shape has no voxel, infinite where all colours agree.
  """
  partner = aligned_colors(predicted.occupancy, true)
  return psnr(np.asarray(predicted.color)[np.asarray(predicted.occupancy)], partner)


def aligned_colors(occupancy: Any, true: ColoredVoxels) -> np.ndarray:
  """The colours [N, 3] that a shape's N voxels (in row-major order) are compared with.

  A voxel's partner is the nearest true surface voxel; among equally near ones the first in
  row-major order. Without any true voxel the colours are NaN.

  Args:
    occupancy: [X, Y, Z] bool.
    true: the true voxels.
  """
  voxels = np.argwhere(np.asarray(occupancy))
  occupied = np.asarray(true.occupancy)
  surface = np.argwhere(occupied)
  if len(surface) == 0:
    return np.full((len(voxels), 3), np.nan)
  # Squared distances are whole numbers, so a fourth coordinate whose square grows with the voxel's
  # place, from 0 to less than 1, decides between equals and nothing else.
  rank = np.sqrt(np.arange(len(surface)) / len(surface))
  tree = cKDTree(np.column_stack([surface, rank]))
  nearest = tree.query(np.column_stack([voxels, np.zeros(len(voxels))]))[1]
  return np.asarray(true.color, np.float64)[occupied][nearest]


def psnr(colors: Any, reference: Any) -> SurfacePsnr:
  """PSNR between two lists of colours.

  20 log10(255) - 10 log10(mean squared error over colours and channels), for colours times 255, as
  they are and in full-range YCbCr without rounding.

  Args:
    colors: [N, 3].
    reference: [N, 3].

  Returns:
    The two PSNRs: NaN where N is 0, infinite where all colours agree.
  """
  difference = 255 * (np.asarray(colors, np.float64) - np.asarray(reference, np.float64))
  return SurfacePsnr(_decibels(difference), _decibels(difference @ _YCBCR.T))


def _decibels(difference):
  if difference.size == 0:
    return float('nan')
  error = np.mean(difference**2)
  return float('inf') if error == 0 else float(20 * np.log10(255) - 10 * np.log10(error))
