"""Sees to it that polygons of OBJ files that are not convex keep their shape as triangles.

Readers cut a polygon by the diagonals of its first corner. That fills the notch of an L and the
space between a chair's legs: such polygons are cut here, by other diagonals.
"""

import re
from array import array
from itertools import pairwise

import numpy as np

MAX_CORNERS = 1024  # of a polygon that is cut here: the time grows with their square
_FLAT = 1e-4  # areas as a share of the polygon's that do not count
_VERTEX = re.compile(rb'^[ \t]*v[ \t]+(\S+)[ \t]+(\S+)[ \t]+(\S+)', re.MULTILINE)
_POLYGON = re.compile(rb'^[ \t]*f((?:[ \t]+\d[\d/]*){4,})[ \t\r]*$', re.MULTILINE)
_OTHER_INDICES = re.compile(rb'/[\d/]*')


def cut_concave(content: bytes) -> bytes:
  """Replaces polygons out of which their first corner's diagonals lead by triangles.

  A quad stays one and begins with another corner, so that it is cut by its other diagonal.

  Args:
    content: an OBJ file in which indices are absolute.

  Raises:
    ValueError: a vertex whose coordinates are no numbers.
  """
  if not _POLYGON.search(content):
    return content
  vertices = np.array(_VERTEX.findall(content), 'S').astype(np.float64).reshape(-1, 3)
  index, count, span = array('q'), array('q'), array('q')
  for match in _POLYGON.finditer(content):
    corners = _OTHER_INDICES.sub(b'', match[1]).split()
    if len(corners) <= MAX_CORNERS:
      index.extend(map(int, corners))
      count.append(len(corners))
      span.extend(match.span(1))
  index, count, span = np.array(index) - 1, np.array(count), np.reshape(span, (-1, 2))
  start = np.cumsum(count) - count
  parts, end = [], 0
  for polygon in np.flatnonzero(_spilling(vertices, index, start, count)):
    first, last = span[polygon]
    corners = content[first:last].split()
    faces = [(1, 2, 3, 0)]
    if len(corners) > 4:
      faces = triangulate(_flattened(vertices[index[start[polygon] :][: len(corners)]]))
    lines = (b' '.join(corners[k] for k in face) for face in faces)
    parts += [content[end:first], b' ' + b'\nf '.join(lines)]
    end = last
  return b''.join([*parts, content[end:]])


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


def _spilling(vertices, index, start, count):
  """[P] bool: polygons one of whose first corner's triangles looks the other way."""
  spilling = np.zeros(len(count), bool)
  for n in np.unique(count):
    of_n = np.flatnonzero(count == n)
    corners = index[start[of_n, None] + np.arange(n)]
    known = (corners >= 0).all(1) & (corners < len(vertices)).all(1)
    points = vertices[corners[known]]
    fan = np.cross(points[:, 1:-1] - points[:, :1], points[:, 2:] - points[:, :1])
    normal = fan.sum(1, keepdims=True)
    along = (fan * normal).sum(-1)
    spilling[of_n[known]] = (along < -_FLAT * (normal**2).sum(-1)).any(1)
  return spilling


def _flattened(points):
  """[N, 3] corners of a polygon -> [N, 2] in its plane, anticlockwise."""
  normal = np.cross(points[1:-1] - points[0], points[2:] - points[0]).sum(0)
  normal /= np.linalg.norm(normal)
  across = np.cross(np.eye(3)[np.abs(normal).argmin()], normal)
  across /= np.linalg.norm(across)
  return (points - points[0]) @ np.stack([across, np.cross(normal, across)], 1)


def _cross(a, b):
  return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
