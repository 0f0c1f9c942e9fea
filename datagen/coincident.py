"""Faces in the very same place: which of them is seen.

Modellers' programs export sheets twice, once for either side, often with a colour of its own for
the inside, and models hold faces that are there twice. What a ray meets first among them is left to
rounding, and a voxel would be their mean. One is kept, so that views and voxels agree.
"""

import numpy as np

_FLAT = 1e-6  # of the mesh's size times the face's: nearer to the middle than this is no side


def seen_faces(vertices: np.ndarray, faces: np.ndarray, textured: np.ndarray) -> np.ndarray:
  """Keeps one of all faces that have the same three corners, whichever way they go round.

  It is the one that looks outwards, away from the middle of the mesh's bounding box, before one
  that looks inwards; of several, one with a texture, and of these the first.

  Args:
    vertices: [V, 3] float64, finite or not.
    faces: [F, 3] integers into vertices, none without area.
    textured: [F] bool.

  Returns:
    [F] bool, the faces to keep.
  """
  keep = np.ones(len(faces), bool)
  if not len(faces):
    return keep
  # The order of the corners has no part in a sum.
  _, place, count = np.unique(
    _hash(vertices)[faces].sum(1), return_inverse=True, return_counts=True
  )
  again = np.flatnonzero(count[place] > 1)
  if not len(again):
    return keep
  corners = vertices[faces]
  low, high = corners.min((0, 1)), corners.max((0, 1))
  a, b, c = np.moveaxis(corners[again] - (low + high) / 2, 1, 0)
  normal = np.cross(b - a, c - a)
  outwards = np.einsum('nk,nk->n', normal, a)
  scale = np.linalg.norm(normal, axis=-1) * (high - low).max()
  side = np.where(np.abs(outwards) > _FLAT * scale, np.sign(outwards), 0)
  rank = 6 * place[again] + 2 * (1 - side.astype(np.int64)) + ~textured[again]
  order = np.argsort(rank, kind='stable')
  first = np.diff(place[again[order]], prepend=-1) != 0
  keep[again] = False
  keep[again[order[first]]] = True
  return keep


def _hash(vertices):
  """[V] uint64 of positions, the same for the same position and for no other in practice."""
  bits = (vertices + 0.0).view(np.uint64)  # + 0.0: of zero there are two
  h = np.zeros(len(vertices), np.uint64)
  for k in range(3):
    h = (h ^ bits[:, k]) * np.uint64(0x9E3779B97F4A7C15)
    h ^= h >> np.uint64(29)
    h *= np.uint64(0xBF58476D1CE4E5B9)
    h ^= h >> np.uint64(32)
  return h
