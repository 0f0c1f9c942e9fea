"""Trivial baselines that a network must beat: one mean shape and one mean colour for all views.

Both use training models alone. Surfaces are voxel indices [S, 3] of a grid of `size`^3.
"""

from collections.abc import Sequence

import numpy as np


def mean_shape(surfaces: Sequence[np.ndarray], size: int) -> np.ndarray:
  """The voxels occupied in at least k of the models, for the k of the best mean IoU with them.

  Args:
    surfaces: [S, 3] integer indices of each model; at least one model.
    size: of the grid.

  Returns:
    occupancy [size, size, size] bool.
  """
  flat = [np.ravel_multi_index(np.asarray(s, np.int64).T, (size,) * 3) for s in surfaces]
  count = np.zeros(size**3, np.int64)  # models that occupy the voxel
  for voxels in flat:
    count[voxels] += 1
  models = len(flat)
  # Voxels with a count of at least k, for k from 0 to the number of models.
  predicted = _at_least(count, models)
  score = np.zeros(models)
  for voxels in flat:
    intersection = _at_least(count[voxels], models)
    score += (intersection / (predicted + len(voxels) - intersection))[1:]
  best = 1 + int(np.argmax(score))
  return (count >= best).reshape((size,) * 3)


def mean_color(colors: Sequence[np.ndarray]) -> np.ndarray:
  """The mean [3] of all models' surface colours [S, 3]: no constant colour has a lower error."""
  total = sum(np.sum(c, axis=0, dtype=np.float64) for c in colors)
  return total / sum(len(c) for c in colors)


def _at_least(values, most):
  """How many values are at least 0, 1, ... `most`."""
  return np.bincount(values, minlength=most + 1)[::-1].cumsum()[::-1]
