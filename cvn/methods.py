"""What a trained network of any kind says of views: how occupied voxels are, and their colours.

`kind` is a key of `networks.NETWORKS`. Views are [V, H, W, 4 or 3], as in cvn.reconstruct; all
results are numpy arrays.
"""

import functools
from collections.abc import Iterator, Sequence

import numpy as np

from cvn import blending, carving, metrics, reconstruct
from cvn.errors import UserError
from cvn.grid import GRID_SIZE

# From which score on a voxel is occupied, unless a threshold was chosen on a validation split.
THRESHOLDS = {
  'shape': metrics.OCCUPIED,
  'joint': metrics.OCCUPIED,
  'r2n2': metrics.JOINT_OCCUPIED,
}
SHAPE_KINDS = (*THRESHOLDS,)
COLOR_KINDS = ('color', 'regression', 'flow', 'joint', 'r2n2')
BLENDING_KINDS = ('color', 'joint')  # whose colours depend on alpha


def score(
  kind: str,
  variables,
  views: np.ndarray,
  *,
  flip: bool = False,
  carve: Sequence[float] = (),
  grid_size: int = GRID_SIZE,
) -> np.ndarray:
  """How occupied voxels are [V, X, Y, Z]: occupied is what lies above a threshold.

  A probability or, of the joint baseline's volume, the lowest channel: it is above a threshold
  where all channels are.

  Args:
    kind: one of `SHAPE_KINDS`.
    variables: of the network.
    views: [V, H, W, 4 or 3].
    flip: whether to take the mean with what it says of the mirrored views, mirrored back.
    carve: azimuths in degrees that the views may have been taken from: shapes are then carved by
      the silhouettes, see cvn.carving; or none.
    grid_size: of the network.

  Raises:
    UserError: the joint baseline, which has no probabilities, is to be carved.
  """
  if carve:
    if kind == 'r2n2':
      raise UserError('the adapted R2N2 says no probabilities, which carving needs')
    found = score(kind, variables, views, flip=flip, grid_size=grid_size)
    return np.asarray(carving.carve(found, reconstruct.foreground_of(views), tuple(carve)))
  if flip:
    return _with_mirrored(functools.partial(score, kind, variables, grid_size=grid_size), views)
  if kind == 'shape':
    found = reconstruct.estimate_shape(variables, views, grid_size=grid_size)
  elif kind == 'joint':
    found = reconstruct.estimate_joint(variables, views, grid_size=grid_size).probability
  else:
    found = reconstruct.estimate_r2n2(variables, views, grid_size=grid_size).min(-1)
  return np.asarray(found)


def colors(
  kind: str,
  variables,
  views: np.ndarray,
  *,
  alpha: float = blending.ALPHA,
  threshold: float = THRESHOLDS['r2n2'],
  flip: bool = False,
  grid_size: int = GRID_SIZE,
) -> np.ndarray:
  """The colours of all voxels [V, X, Y, Z, 3] in [0, 1].

  Args:
    kind: one of `COLOR_KINDS`.
    variables: of the network.
    views: [V, H, W, 4 or 3].
    alpha: in (0, 1], of networks that blend (section 3.5).
    threshold: of the joint baseline, whose colours depend on it (equation 9).
    flip: as of `score`.
    grid_size: of the network.
  """
  if flip:
    options = {'alpha': alpha, 'threshold': threshold, 'grid_size': grid_size}
    return _with_mirrored(functools.partial(colors, kind, variables, **options), views)
  if kind == 'color':
    found = reconstruct.estimate_color(variables, views, alpha=alpha, grid_size=grid_size).blended
  elif kind == 'joint':
    found = reconstruct.estimate_joint(variables, views, alpha=alpha, grid_size=grid_size).blended
  elif kind == 'regression':
    found = reconstruct.estimate_regression(variables, views, grid_size=grid_size)
  elif kind == 'flow':
    found = reconstruct.estimate_flow(variables, views, grid_size=grid_size)[1]
  else:
    volume = reconstruct.estimate_r2n2(variables, views, grid_size=grid_size)
    found = blending.adjust_color(volume, threshold)[1]
  return np.asarray(found)


def blends(
  kind: str,
  variables,
  views: np.ndarray,
  alphas: Sequence[float],
  *,
  flip: bool = False,
  grid_size: int = GRID_SIZE,
) -> Iterator[np.ndarray]:
  """What `colors` says for each of several alphas, from one run of the network.

  Args:
    kind: one of `BLENDING_KINDS`.
    variables: of the network.
    views: [V, H, W, 4 or 3].
    alphas: each in (0, 1].
    flip: as of `score`.
    grid_size: of the network.

  Yields:
    [V, X, Y, Z, 3] in [0, 1] for each alpha.
  """
  estimate = {'color': reconstruct.estimate_color, 'joint': reconstruct.estimate_joint}[kind]
  seen = [views, views[:, :, ::-1]] if flip else [views]
  found = [estimate(variables, v, grid_size=grid_size) for v in seen]
  for alpha in alphas:
    plain, *other = (
      np.asarray(
        blending.blend(
          x.sampled, x.regressed, blending.recalculate_weight(x.weight, alpha)[..., None]
        )
      )
      for x in found
    )
    yield (plain + other[0][:, ::-1]) / 2 if flip else plain


def _with_mirrored(estimate, views):
  """The mean of what is estimated of the views and, mirrored back in x, of the mirrored views."""
  return (estimate(views) + estimate(views[:, :, ::-1])[:, ::-1]) / 2
