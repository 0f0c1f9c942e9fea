"""Facts about the mesh behind a record, stored for `datagen.inspect`."""

import numpy as np

from cvn.dataset import Facts
from datagen.geometry.mesh import TexturedMesh
from datagen.reading.notes import to_bits

_CHUNK = 1 << 18  # faces handled at a time


def facts_of(mesh: TexturedMesh) -> Facts:
  """Counts the faces and missing files of a mesh, keeps its notes, and measures its signed volume.

  The volume is the divergence theorem's sum of (a - m) · (b - m) × (c - m) / 6 over the faces, m
  being the middle of the bounding box, divided by the box's volume. A closed surface whose faces
  look outwards has its own volume, one turned inside out the negative of it. Sheets, and faces that
  exist once for each side, contribute almost nothing.
  """
  used = mesh.vertices[np.unique(mesh.faces)]
  low, high = used.min(0), used.max(0)
  box = float(np.prod(np.maximum(high - low, 1e-3 * (high - low).max())))
  total = 0.0
  for start in range(0, len(mesh.faces), _CHUNK):
    a, b, c = np.moveaxis(
      mesh.vertices[mesh.faces[start : start + _CHUNK]] - (low + high) / 2, 1, 0
    )
    total += float(np.einsum('nk,nk->', a, np.cross(b, c))) / 6
  return Facts(len(mesh.faces), len(mesh.missing), total / box, to_bits(mesh.notes))
