"""Cuts away the surface inside other solids, which nobody sees.

Objects are made of closed solids that intersect. Hidden surface would occupy voxels inside the
object, and tint voxels at the joints.

A point just outside a face is hidden if solids contain it: if a ray from it leaves more solids than
it enters. Faces are tested at a few points each, those along a cut in pieces of a voxel's size. A
piece that is partly visible stays whole, so cuts leave no gap.
"""

from typing import NamedTuple

import numpy as np

# The longest edges of pieces, of the object's longest side; the last are of a voxel's size.
STEPS = (1 / 6, 1 / 25, 1 / 50)
COLUMNS = 128  # of the grid, along either side, in which the faces that a ray may meet are found
LIFT = 1e-4  # of the longest side: how far outside its face a point is tested

# Rays run along this direction, axes turned: none of them runs along the side of an upright box.
_RAY = np.array([0.0831, 0.0517, 1.0])
# Where a piece is tested: weights of its corners.
_SAMPLES = np.array([[0.9, 0.05, 0.05], [0.05, 0.9, 0.05], [0.05, 0.05, 0.9], [1 / 3] * 3])


class Pieces(NamedTuple):
  """P triangles cut out of faces."""

  face: np.ndarray  # [P] the face each was cut out of
  weights: np.ndarray  # [P, 3, 3] for each corner, the barycentric weights in that face


def exposed(corners: np.ndarray, solid: np.ndarray) -> Pieces:
  """The visible part of closed solids.

  Args:
    corners: [F, 3, 3] of the faces of all solids; they look outwards.
    solid: [F] the solid of each face, from 0.

  Returns:
    The pieces, whole faces where nothing had to be cut, in the order of the faces.
  """
  size = np.ptp(corners.reshape(-1, 3), axis=0).max()
  boxes = _boxes(corners, solid, LIFT * size)
  uncut = np.ones(len(corners), bool)
  pieces, kept = _whole(len(corners)), []
  for step in STEPS:
    pieces = _split(pieces, corners, step * size)
    hidden = _hidden(pieces, corners, size, solid, boxes)
    some, every = hidden.any(1), hidden.all(1)
    kept.append(_pick(pieces, ~some if step > STEPS[-1] else ~every))
    # Larger pieces may show something between the points.
    gone = every & (_edges(pieces, corners).max(1) <= STEPS[1] * size)
    uncut[pieces.face[gone]] = False
    pieces = _pick(pieces, some & ~gone)
  kept = [_pick(p, ~uncut[p.face]) for p in kept]
  face, weights = map(np.concatenate, zip(_pick(_whole(len(corners)), uncut), *kept, strict=True))
  order = np.argsort(face, kind='stable')
  return Pieces(face[order], weights[order])


def windings(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
  """How many closed solids, formed by faces [F, 3, 3], contain each of the points [N, 3]."""
  shear = _RAY[:2]
  # Rays run along the shortest side, where they meet the fewest faces.
  turned = 2 - np.ptp(corners, axis=(0, 1)).argmin()
  corners, points = np.roll(corners, turned, -1), np.roll(points, turned, -1)
  a, b, c = np.moveaxis(corners, 1, 0)
  a2, b2, c2, p2 = (x[:, :2] - x[:, 2:] * shear for x in (a, b, c, points))
  weights = _weights(a2, b2, c2)
  low, high = np.minimum(np.minimum(a2, b2), c2), np.maximum(np.maximum(a2, b2), c2)
  origin = low.min(0)
  cell = np.maximum((high.max(0) - origin) / COLUMNS, 1e-300)
  first, last = (
    np.floor((x - origin) / cell).astype(int).clip(0, COLUMNS - 1) for x in (low, high)
  )
  span = last - first + 1
  f, k = _ragged(span[:, 0] * span[:, 1])
  i, j = np.divmod(k, span[f, 1])
  bin_of = (first[f, 0] + i) * COLUMNS + first[f, 1] + j
  order = np.argsort(bin_of, kind='stable')
  member = f[order]
  start = np.searchsorted(bin_of[order], np.arange(COLUMNS**2 + 1))
  at = np.floor((p2 - origin) / cell).astype(int)
  inside_grid = ((at >= 0) & (at < COLUMNS)).all(1)
  home = np.where(inside_grid, at[:, 0] * COLUMNS + at[:, 1], 0)
  n, k = _ragged(np.where(inside_grid, start[home + 1] - start[home], 0))
  f = member[start[home[n]] + k]
  place = np.insert(p2, 2, 1.0, axis=1)
  for k in range(3):  # all three weights of a point in a triangle are positive
    met = np.einsum('nk,nk->n', weights[k].take(f, 0), place.take(n, 0)) > 0
    n, f = n[met], f[met]
  height = np.einsum('kfc,fk->fc', weights, corners[..., 2])  # z of a face: height · (x, y, 1)
  depth = np.einsum('nk,nk->n', height[f], place[n])
  leaves = np.sign(_cross(b2[f] - a2[f], c2[f] - a2[f])) * (depth > points[n, 2])
  return np.rint(np.bincount(n, leaves, len(points))).astype(int)


def _weights(a, b, c) -> np.ndarray:
  """Barycentric weights of (x, y) in triangles with corners [F, 2]: w · (x, y, 1), [3, F, 3]."""
  area = _cross(b - a, c - a)
  scale = 1 / np.where(area == 0, np.inf, area)
  rows = []
  for p, q in ((b, c), (c, a), (a, b)):
    rows.append(np.stack([p[:, 1] - q[:, 1], q[:, 0] - p[:, 0], _cross(p, q)], -1) * scale[:, None])
  return np.stack(rows)


def _whole(count) -> Pieces:
  return Pieces(np.arange(count), np.broadcast_to(np.eye(3), (count, 3, 3)))


def _pick(pieces: Pieces, which) -> Pieces:
  return Pieces(pieces.face[which], pieces.weights[which])


def _edges(pieces: Pieces, corners) -> np.ndarray:
  """[P, 3] lengths of the edges from each corner to the next."""
  points = pieces.weights @ corners[pieces.face]
  return np.linalg.norm(np.roll(points, -1, 1) - points, axis=-1)


def _split(pieces: Pieces, corners, longest) -> Pieces:
  """Halves pieces at the middle of their longest edge until no edge is longer."""
  done = [_pick(pieces, np.zeros(0, int))]
  while len(pieces.face):
    edges = _edges(pieces, corners)
    long = edges.max(1) > longest
    done.append(_pick(pieces, ~long))
    face, w = _pick(pieces, long)
    i = edges[long].argmax(1)  # from corner i to i + 1
    w = np.take_along_axis(w, ((i[:, None] + np.arange(3)) % 3)[..., None], 1)
    middle = 0.5 * (w[:, 0] + w[:, 1])
    halves = [np.stack([w[:, 0], middle, w[:, 2]], 1), np.stack([middle, w[:, 1], w[:, 2]], 1)]
    pieces = Pieces(np.concatenate([face, face]), np.concatenate(halves))
  return Pieces(*map(np.concatenate, zip(*done, strict=True)))


def _hidden(pieces: Pieces, corners, size, solid, boxes) -> np.ndarray:
  """[P, S] bool: which of a piece's test points are inside a solid."""
  whole = pieces.weights @ corners[pieces.face]
  low, high, own = whole.min(1), whole.max(1), solid[pieces.face]
  near = np.zeros(len(whole), bool)
  for k, (box_low, box_high) in enumerate(boxes):
    near |= (own != k) & ((low <= box_high) & (high >= box_low)).all(1)
  hidden = np.zeros((len(whole), len(_SAMPLES)), bool)
  a, b, c = np.moveaxis(corners[pieces.face[near]], 1, 0)
  normal = np.cross(b - a, c - a)
  normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
  points = _SAMPLES @ whole[near] + LIFT * size * normal[:, None]
  hidden[near] = (windings(points.reshape(-1, 3), corners) > 0).reshape(points.shape[:2])
  return hidden


def _boxes(corners, solid, margin) -> list[tuple[np.ndarray, np.ndarray]]:
  """The lower and upper corner of each solid's box, a little widened."""
  low, high = corners.min(1), corners.max(1)
  members = [solid == k for k in range(solid.max() + 1)]
  return [(low[own].min(0) - margin, high[own].max(0) + margin) for own in members]


def _cross(a, b):
  return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def _ragged(count):
  """All pairs (i, k), k < count[i], in order."""
  i = np.repeat(np.arange(len(count)), count)
  return i, np.arange(len(i)) - np.repeat(np.cumsum(count) - count, count)
