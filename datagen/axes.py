"""Which way a volume's axes run, told from where the views show its voxels.

Where an axis points to the right of a view, the flows of the voxels along it run to the right. What
is right and down in each view our cameras (cvn/camera.py) say, in the world's axes. The one of the
48 ways to lay a volume's axes along the world's by which flows and voxels agree best is taken.
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
  agreement: float  # correlation of flows with where their voxels are expected, 1 at best

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
  places, with_flow, flow_square = np.zeros((3, 3)), np.zeros((len(azimuths), 3, 2)), 0.0
  for index, flow in zip(indices, flows, strict=True):
    place, flow = index - index.mean(0), flow - flow.mean(1, keepdims=True)
    places += place.T @ place / len(place)
    with_flow += place.T @ flow / len(place)
    flow_square += float(np.square(flow).sum() / len(place))
  shown = np.stack([camera_at(a).R[:2].T for a in azimuths])  # [V, 3, 2] right, down in the world

  def agreement(order, signs):
    laid = shown[:, order] * np.array(signs)[:, None]
    expected_square = (laid * (places @ laid)).sum()
    scale = np.sqrt(flow_square * expected_square)
    return float((with_flow * laid).sum() / scale) if scale else 0.0

  ways = itertools.product(itertools.permutations(range(3)), itertools.product((1, -1), repeat=3))
  order, signs = max(ways, key=lambda way: agreement(*way))
  names = tuple(('-' if s < 0 else '') + OURS[axis] for axis, s in zip(order, signs, strict=True))
  return Axes(names, agreement(order, signs))
