"""The axis order of a volume, estimated from its flows.

If an axis of the volume points to the right in a view, flows along that axis increase in u. The
cameras of cvn/camera.py know the direction of each world axis in each view. Of the 48 possible axis
orders, the one whose projections correlate best with the flows is chosen.
"""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cvn.camera import camera_at

OURS = ('x', 'y', 'z')


class Axes(NamedTuple):
  """The orientation of a volume in the world."""

  names: tuple[str, str, str]  # each axis's direction in the world, as 'x' or '-z'
  agreement: float  # correlation of flows with where their voxels are expected, 1 at best

  @property
  def is_mirrored(self) -> bool:
    """Whether the axes are left-handed, or the azimuths run the other way: both look the same."""
    order = [name[-1] for name in self.names]
    swaps = sum(a > b for a, b in itertools.combinations(order, 2))
    return (swaps + sum(name.startswith('-') for name in self.names)) % 2 == 1


def find_axes(
  indices: Sequence[np.ndarray], flows: Sequence[np.ndarray], azimuths: Sequence[float]
) -> Axes:
  """Estimates the axes that the volumes of several models share.

  Several models are better than one: hidden voxels take their colour from elsewhere, and a single
  model may be flat.

  Args:
    indices: voxels [S, 3] of each model.
    flows: flows [V, S, 2] of each model.
    azimuths: azimuths of the views, degrees.
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
