"""Polygons of any shape -> triangles.

The diagonals of a polygon's first corner fill the notch of an L and the space between a chair's
legs. Polygons out of which one of these leads are cut by other diagonals.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

MAX_CORNERS = 1024  # of a polygon that is cut otherwise: the time grows with their square
_FLAT = 1e-4  # areas as a share of the polygon's that do not count


def cut(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
  """Cuts polygons of as many corners each into triangles.

  A quad is cut by its other diagonal where it has to be.

  Args:
    points: [P, N, 3] corners.

  Returns:
    (polygon [T], corner [T, 3]): of each triangle, its polygon and which of its corners it has; in
    the polygons' order.
  """
  count, n = points.shape[:2]
  fan = np.stack([np.zeros(n - 2, np.int64), np.arange(1, n - 1), np.arange(2, n)], 1)
  polygon = np.repeat(np.arange(count), n - 2)
  corner = np.tile(fan, (count, 1))
  if 3 < n <= MAX_CORNERS:
    for p in np.flatnonzero(_spilling(points)):
      triangles = [(1, 2, 3), (1, 3, 0)] if n == 4 else triangulate(_flattened(points[p]))
      corner[p * (n - 2) : (p + 1) * (n - 2)] = triangles
  return polygon, corner


def cut_mixed(
  vertices: np.ndarray, polygons: Sequence[tuple[np.ndarray, np.ndarray]]
) -> tuple[np.ndarray, np.ndarray]:
  """Cuts polygons of several numbers of corners.

  Args:
    vertices: [V, 3].
    polygons: (places [P] in the file, corners' vertices [P, N]) of those with N corners each.

  Returns:
    (place [T], corner [T, 3]), in the order of places: of each triangle, the place of its polygon
    and which of its corners it has.

  Raises:
    IndexError: a vertex that is not there.
  """
  places, corners = [np.zeros(0, np.int64)], [np.zeros((0, 3), np.int64)]
  for place, index in polygons:
    polygon, corner = cut(vertices[index])
    places.append(place[polygon])
    corners.append(corner)
  place, corner = np.concatenate(places), np.concatenate(corners)
  order = np.argsort(place, kind='stable')
  return place[order], corner[order]


def triangulate(points: np.ndarray) -> list[tuple[int, int, int]]:
  """Cuts a polygon into triangles by clipping its ears, one after the other.

  Args:
    points: [N, 2] corners, anticlockwise. Holes are joined to the outline by edges there and back.

  Returns:
    N - 2 triangles of corners' indices. Where a polygon crosses itself and has no ear, the rest is
    cut by the diagonals of one corner.
  """
  left, triangles, at, tried = list(range(len(points))), [], 0, 0
  while len(left) > 3 and tried < len(left):
    a, b, c = (left[(at + k) % len(left)] for k in (-1, 0, 1))
    if _is_ear(points, left, a, b, c):
      triangles.append((a, b, c))
      left.pop(at % len(left))
      tried = 0
    else:
      at, tried = at + 1, tried + 1
  return triangles + [(left[0], b, c) for b, c in pairwise(left[1:])]


def _is_ear(points, left, a, b, c):
  """Whether the corner b juts out and no other corner lies in its triangle."""
  corners = points[[a, b, c]]
  if _cross(corners[1] - corners[0], corners[2] - corners[1]) <= 0:
    return False
  others = points[left]
  inside = np.ones(len(others), bool)
  for k in range(3):
    inside &= _cross(corners[(k + 1) % 3] - corners[k], others - corners[k]) >= 0
    inside &= (others != corners[k]).any(-1)  # its own corners, there again where a hole is joined
  return not inside.any()


def _spilling(points):
  """[P] bool: polygons one of whose first corner's triangles looks the other way."""
  with np.errstate(invalid='ignore', over='ignore'):
    fan = np.cross(points[:, 1:-1] - points[:, :1], points[:, 2:] - points[:, :1])
    normal = fan.sum(1, keepdims=True)
    along = (fan * normal).sum(-1)
    return (along < -_FLAT * (normal**2).sum(-1)).any(1)


def _flattened(points):
  """[N, 3] corners of a polygon -> [N, 2] in its plane, anticlockwise."""
  normal = np.cross(points[1:-1] - points[0], points[2:] - points[0]).sum(0)
  normal /= np.linalg.norm(normal)
  across = np.cross(np.eye(3)[np.abs(normal).argmin()], normal)
  across /= np.linalg.norm(across)
  return (points - points[0]) @ np.stack([across, np.cross(normal, across)], 1)


def _cross(a, b):
  return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
