"""Which way a volume's axes run, told from where the views show its voxels.

Where an axis points to the right of a view, flows to its voxels grow to the right along it: a
straight line fitted to a view's flows gives the directions that the view calls right and down, in
the volume's axes. Our cameras (cvn/camera.py) say what they are in the world. The one of the 48
ways to lay a volume's axes along the world's that brings the two together is the volume's.
"""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cvn.camera import camera_at

OURS = ('x', 'y', 'z')


class Axes(NamedTuple):
  """How a volume lies in the world."""

  names: tuple[str, str, str]  # each axis's direction in the world, as 'x' or '-z'
  agreement: float  # 1 where flows follow the voxels just so; other axes come to 0.6 at best

  @property
  def is_mirrored(self) -> bool:
    """Whether they are left-handed, or the azimuths run the other way: one looks like the other."""
    order = [name[-1] for name in self.names]
    swaps = sum(a > b for a, b in itertools.combinations(order, 2))
    return (swaps + sum(name.startswith('-') for name in self.names)) % 2 == 1


def find_axes(
  indices: Sequence[np.ndarray], flows: Sequence[np.ndarray], azimuths: Sequence[float]
) -> Axes:
  """Finds the axes of some models' volumes, which have them in common.

  Hidden voxels fetch their colour from elsewhere, and one model may be flat: several say more.

  Args:
    indices: of each model, its voxels [S, 3].
    flows: of each model, [V, S, 2].
    azimuths: of the views, degrees.
  """
  covariance = np.zeros((3, 3))
  with_flow = np.zeros((len(azimuths), 3, 2))
  for index, flow in zip(indices, flows, strict=True):
    place = index - index.mean(0)
    covariance += place.T @ place / len(place)
    with_flow += place.T @ (flow - flow.mean(1, keepdims=True)) / len(place)
  slope = np.linalg.pinv(covariance) @ with_flow  # [V, 3, 2]
  cameras = [camera_at(a) for a in azimuths]
  expected = np.stack([c.R[:2].T for c in cameras])  # [V, 3, 2] right and down in the world

  def agreement(order, signs):
    laid = expected[:, order] * np.array(signs)[:, None]
    scale = np.linalg.norm(slope) * np.linalg.norm(laid)
    return float((slope * laid).sum() / scale) if scale else 0.0

  ways = itertools.product(itertools.permutations(range(3)), itertools.product((1, -1), repeat=3))
  order, signs = max(ways, key=lambda way: agreement(*way))
  names = tuple(('-' if s < 0 else '') + OURS[axis] for axis, s in zip(order, signs, strict=True))
  return Axes(names, agreement(order, signs))
