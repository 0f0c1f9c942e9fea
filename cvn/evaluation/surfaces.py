"""Distances between surfaces: F-scores and the Chamfer distance of voxel centres.

Occupancy is the surface itself (cvn.grid), so the points of a surface are the centres of its
occupied voxels. Distances are Euclidean, in sides of the grid's cube: a voxel of a grid of 64 has a
side of 1/64 = 0.0156, so a tolerance below it asks for the very voxel.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.ndimage import distance_transform_edt

TOLERANCES = (1 / 200, 1 / 100, 1 / 50, 1 / 20)  # sides of the cube


class Distances(NamedTuple):
  """Distances from each point of a surface to the nearest point of the other one."""

  of_predicted: np.ndarray  # [N]
  of_true: np.ndarray  # [M]


def measure(predicted: Any, true: Any) -> Distances:
  """Distances between two surfaces in both directions; infinite where the other one is empty.

  Args:
    predicted: [X, X, X] bool.
    true: likewise.

  Raises:
    ValueError: the shapes differ.
  """
  predicted, true = np.asarray(predicted, bool), np.asarray(true, bool)
  if predicted.shape != true.shape:
    raise ValueError(f'predicted {predicted.shape} and true {true.shape} differ')
  return Distances(_nearest(true)[predicted], _nearest(predicted)[true])


def f_scores(distances: Distances, *, tolerances: Sequence[float] = TOLERANCES) -> np.ndarray:
  """The harmonic mean of precision and recall at each tolerance, in [0, 1].

  Precision is the share of predicted points within the tolerance of a true one, recall the share of
  true points within the tolerance of a predicted one (Knapitsch et al. 2017; Tatarchenko et al.
  2019 recommend 1/100). Two empty surfaces score 1, an empty and another one 0.

  Args:
    distances: between the surfaces.
    tolerances: [T], sides of the cube.

  Returns:
    [T].
  """
  if not len(distances.of_predicted) or not len(distances.of_true):
    same = len(distances.of_predicted) == len(distances.of_true)
    return np.full(len(tolerances), float(same))
  # Distances between voxels are square roots of whole numbers times a voxel's side.
  precision, recall = (np.array([np.mean(d <= t + 1e-9) for t in tolerances]) for d in distances)
  return 2 * precision * recall / np.maximum(precision + recall, 1e-12)


def chamfer(distances: Distances) -> float:
  """The mean of both directions' mean distances, in sides of the cube; NaN if a surface is empty.

  Args:
    distances: between the surfaces.
  """
  if not len(distances.of_predicted) or not len(distances.of_true):
    return float('nan')
  return float(np.mean([np.mean(d) for d in distances]))


def _nearest(occupied):
  """The distance of every voxel to the nearest occupied one."""
  if not occupied.any():
    return np.full(occupied.shape, np.inf)
  return distance_transform_edt(~occupied, sampling=1 / len(occupied))
