"""Polygons of any shape -> triangles.

A fan from a polygon's first corner fills the notch of an L and the space between a chair's legs. So
polygons whose fan leaves the polygon are cut differently.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

MAX_CORNERS = 1024  # of a polygon that is cut otherwise: the time grows with their square
_FLAT = 1e-4  # areas as a share of the polygon's that do not count


def cut(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
  """Cuts polygons with the same number of corners into triangles.

  A quad is cut along its other diagonal if necessary.

  Args:
    points: [P, N, 3] corners.

  Returns:
    (polygon [T], corner [T, 3]): the polygon of each triangle and its three corners there, in the
    order of the polygons.
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
  """Cuts polygons with different numbers of corners.

  Args:
    vertices: [V, 3].
    polygons: for each N, (positions [P] in the file, vertices of the corners [P, N]).

  Returns:
    (position [T], corner [T, 3]) in the order of positions: the polygon of each triangle and its
    three corners there.

  Raises:
    IndexError: a vertex does not exist.
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
  """Cuts a polygon into triangles by ear clipping.

  Args:
    points: [N, 2] corners, anticlockwise. Holes are joined to the outline by edges there and back.

  Returns:
    N - 2 triangles of corner indices. If a polygon crosses itself and has no ear, the rest is cut
    as a fan.
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
  """Whether the corner b is convex and no other corner lies in its triangle."""
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
  """[P] bool: polygons whose fan from the first corner has a triangle of opposite orientation."""
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
