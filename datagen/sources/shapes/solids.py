"""Closed surfaces made of few numbers: lofts, slabs, lathes, tubes, bent sheets.

Every function returns a `Solid`: a closed triangle mesh with outward faces, in metres or any other
unit. Outlines are closed polygons [M, 2] in a plane seen from its front, counter-clockwise or not:
`loft` turns faces outward by the sign of the enclosed volume.
"""

from typing import NamedTuple

import numpy as np
from scipy.spatial import Delaunay


class Solid(NamedTuple):
  """A closed triangle mesh."""

  vertices: np.ndarray  # [V, 3] float64
  faces: np.ndarray  # [F, 3] int64


def ellipse(width: float, depth: float, *, power: float = 2.0, taper: float = 0.0, sides: int = 24):
  """A superellipse [sides, 2]: power 2 is an ellipse, 4 and more a rounded rectangle.

  `taper` widens the far end of the second axis by that fraction and narrows the near end (a
  trapezoid seat).
  """
  a = 2 * np.pi * (np.arange(sides) + 0.5) / sides
  # Nearly square outlines spend their points on the corners when the angle itself is bent.
  a = a - min(1.0, (power - 2) / 8) * 0.25 * np.sin(4 * a)
  c, s = np.cos(a), np.sin(a)
  r = (np.abs(c) ** power + np.abs(s) ** power) ** (-1 / power)
  x, y = r * c, r * s
  return np.stack([x * 0.5 * width * (1 + taper * y), y * 0.5 * depth], -1)


def rectangle(width: float, depth: float, *, taper: float = 0.0) -> np.ndarray:
  """A rectangle or trapezoid [4, 2], centred."""
  corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], float)
  scale = 1 + taper * corners[:, 1:]
  return corners * 0.5 * np.array([width, depth]) * np.concatenate([scale, scale * 0 + 1], 1)


def smooth(points, *, rounds: int = 2, closed: bool = False) -> np.ndarray:
  """Cuts the corners of a polyline [N, D] (Chaikin); open ends stay where they are."""
  p = np.asarray(points, float)
  for _ in range(rounds):
    q = np.roll(p, -1, 0) if closed else p[1:]
    a = p if closed else p[:-1]
    cut = np.stack([0.75 * a + 0.25 * q, 0.25 * a + 0.75 * q], 1).reshape(-1, p.shape[1])
    p = cut if closed else np.concatenate([p[:1], cut[1:-1], p[-1:]])
  return p


def outward(solid: Solid) -> Solid:
  """Turns all faces around when the enclosed volume is negative."""
  a, b, c = np.moveaxis((solid.vertices - solid.vertices.mean(0))[solid.faces], 1, 0)
  if np.einsum('ij,ij', a, np.cross(b, c)) < 0:
    return solid._replace(faces=solid.faces[:, ::-1])
  return solid


def loft(rings) -> Solid:
  """A skin over rings [N, M, 3], both ends closed by fans around the rings' centres."""
  rings = np.asarray(rings, float)
  n, m = rings.shape[:2]
  vertices = np.concatenate([rings.reshape(-1, 3), rings[[0, -1]].mean(1)])
  i, j = np.meshgrid(np.arange(n - 1), np.arange(m), indexing='ij')
  k = (j + 1) % m
  a, b, c, d = (x.ravel() for x in (i * m + j, i * m + k, (i + 1) * m + k, (i + 1) * m + j))
  j = np.arange(m)
  k = (j + 1) % m
  faces = np.concatenate(
    [
      np.stack([a, b, c], 1),
      np.stack([a, c, d], 1),
      np.stack([k, j, np.full(m, n * m)], 1),
      np.stack([j, k, np.full(m, n * m + 1)], 1) + np.array([1, 1, 0]) * (n - 1) * m,
    ]
  )
  return outward(Solid(vertices, faces))


def _plane(outline, y) -> np.ndarray:
  """An outline [M, 2] of (x, z) lifted to the height y: [M, 3]."""
  return np.insert(np.asarray(outline, float), 1, y, axis=1)


def slab(outline, low: float, high: float, *, bevel: float = 0.0) -> Solid:
  """An outline in (x, z) extruded from y = low to y = high, edges cut by `bevel`."""
  outline = np.asarray(outline, float)
  if bevel <= 0:
    return loft([_plane(outline, low), _plane(outline, high)])
  half = np.abs(outline - outline.mean(0)).max(0)
  inner = outline.mean(0) + (outline - outline.mean(0)) * (1 - bevel / half)
  steps = [(inner, low), (outline, low + bevel), (outline, high - bevel), (inner, high)]
  return loft([_plane(o, y) for o, y in steps])


def pillow(outline, low: float, high: float, *, power: float = 3.0, rings: int = 7) -> Solid:
  """An outline in (x, z) swollen between two heights: 2 is an ellipsoid, 6 nearly a slab."""
  outline = np.asarray(outline, float)
  t = np.sin(np.linspace(-0.5, 0.5, rings) * np.pi)
  scale = np.maximum(1 - np.abs(t) ** power, 0.02) ** (1 / power)
  center = outline.mean(0)
  heights = low + (t + 1) / 2 * (high - low)
  return loft(
    [_plane(center + (outline - center) * s, y) for s, y in zip(scale, heights, strict=True)]
  )


def box(size, center=(0.0, 0.0, 0.0)) -> Solid:
  """A box of edge lengths `size` [3]."""
  w, h, d = size
  solid = slab(rectangle(w, d), -h / 2, h / 2)
  return solid._replace(vertices=solid.vertices + np.asarray(center, float))


def lathe(profile, *, sides: int = 16) -> Solid:
  """A profile [N, 2] of (radius, y) turned around the y axis."""
  profile = np.maximum(np.asarray(profile, float), [1e-4, -np.inf])
  ring = ellipse(2, 2, sides=sides)
  return loft([_plane(ring * r, y) for r, y in profile])


def ellipsoid(radii, center=(0.0, 0.0, 0.0), *, sides: int = 14) -> Solid:
  """An ellipsoid with its pole on the y axis."""
  a = np.linspace(-0.5, 0.5, max(sides // 2, 5) + 1) * np.pi
  solid = lathe(np.stack([np.cos(a), np.sin(a)], 1), sides=sides)
  return solid._replace(vertices=solid.vertices * np.asarray(radii) + np.asarray(center, float))


def tube(path, radius, *, sides: int = 8, up=(0.0, 1.0, 0.0)) -> Solid:
  """A cross-section carried along a path without twist.

  Args:
    path: [N, 3] points.
    radius: one number, [N], or [N, 2] or [1, 2]: half widths across (`up` x direction) and
      along `up`.
    sides: corners of the section; 4 gives a square bar that follows `up`.
    up: a direction the section's second axis starts close to.
  """
  path = np.asarray(path, float)
  radius = np.asarray(radius, float)
  radius = np.broadcast_to(radius[:, None] if radius.ndim == 1 else radius, (len(path), 2))
  tangent = np.gradient(path, axis=0)
  tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
  second = np.asarray(up, float)
  if abs(second @ tangent[0]) > 0.95 * np.linalg.norm(second):
    second = np.roll(second, 1)
  angle = 2 * np.pi * (np.arange(sides) + 0.5) / sides
  stretch = np.sqrt(2) if sides == 4 else 1.0
  rings = []
  for p, t, (a, b) in zip(path, tangent, radius, strict=True):
    second = second - (second @ t) * t
    second = second / np.linalg.norm(second)
    first = np.cross(second, t)
    section = np.cos(angle)[:, None] * first * a + np.sin(angle)[:, None] * second * b
    rings.append(p + stretch * section)
  return loft(rings)


def bar(start, end, radius, *, sides: int = 8, up=(0.0, 1.0, 0.0)) -> Solid:
  """A straight tube between two points; `radius` one number or (at start, at end)."""
  r = np.broadcast_to(np.asarray(radius, float), (2,))
  return tube(np.stack([start, end]), r, sides=sides, up=up)


def sheet(points, thickness) -> Solid:
  """A bent plate: a grid of points [N, M, 3] thickened along its normals."""
  p = np.asarray(points, float)
  n, m = p.shape[:2]
  normal = np.cross(np.gradient(p, axis=0), np.gradient(p, axis=1))
  normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
  half = 0.5 * np.asarray(thickness, float)
  half = half[..., None] if half.ndim else half
  vertices = np.concatenate(
    [(p + half * normal).reshape(-1, 3), (p - half * normal).reshape(-1, 3)]
  )
  i, j = (x.ravel() for x in np.meshgrid(np.arange(n - 1), np.arange(m - 1), indexing='ij'))
  a, b, c, d = i * m + j, i * m + j + 1, (i + 1) * m + j + 1, (i + 1) * m + j
  top = np.concatenate([np.stack([a, d, c], 1), np.stack([a, c, b], 1)])
  grid = np.arange(n * m).reshape(n, m)
  edge = np.concatenate([grid[0, :-1], grid[:-1, -1], grid[-1, :0:-1], grid[:0:-1, 0]])
  after = np.roll(edge, -1)
  low = n * m
  side = np.concatenate(
    [np.stack([edge, after, after + low], 1), np.stack([edge, after + low, edge + low], 1)]
  )
  return outward(Solid(vertices, np.concatenate([top, top[:, ::-1] + low, side])))


def prism(outline, low: float, high: float) -> Solid:
  """An outline in (x, y) of any shape, extruded from z = low to z = high.

  Args:
    outline: [M, 2]; its points lie close, next to each other's distance from the other side.
    low: z of the back.
    high: z of the front.
  """
  o = np.asarray(outline, float)
  front = Delaunay(o).simplices
  front = front[contains(o, o[front].mean(1))]
  a, b, c = np.moveaxis(o[front], 1, 0)
  turned = (b - a)[:, 0] * (c - a)[:, 1] < (b - a)[:, 1] * (c - a)[:, 0]
  front[turned] = front[turned][:, ::-1]
  m = len(o)
  edges = np.concatenate([front[:, [i, (i + 1) % 3]] for i in range(3)])
  inner = {tuple(e) for e in edges.tolist()} & {tuple(e) for e in edges[:, ::-1].tolist()}
  i, j = np.array([e for e in edges.tolist() if tuple(e) not in inner]).T
  sides = np.concatenate([np.stack([i, i + m, j + m], 1), np.stack([i, j + m, j], 1)])
  vertices = np.concatenate([np.insert(o, 2, z, axis=1) for z in (high, low)])
  return Solid(vertices, np.concatenate([front, front[:, ::-1] + m, sides]))


def contains(outline, points) -> np.ndarray:
  """[N] bool: whether an outline [M, 2] goes around points [N, 2]."""
  a = np.asarray(outline, float)
  b = np.roll(a, -1, 0)
  x, y = points[:, :1], points[:, 1:]
  spans = (a[:, 1] > y) != (b[:, 1] > y)
  slope = (b[:, 0] - a[:, 0]) / np.where(a[:, 1] == b[:, 1], 1, b[:, 1] - a[:, 1])
  return (spans & (x < a[:, 0] + (y - a[:, 1]) * slope)).sum(1) % 2 == 1


def resample(outline, spacing: float) -> np.ndarray:
  """A closed outline's points at even distances of about `spacing`."""
  closed = np.concatenate([outline, outline[:1]])
  along = np.append(0, np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1)))
  at = np.linspace(0, along[-1], max(int(along[-1] / spacing), 8), endpoint=False)
  return np.stack([np.interp(at, along, closed[:, k]) for k in (0, 1)], 1)
