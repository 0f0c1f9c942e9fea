"""Coloured triangle meshes: one plain form for every file type.

Colours are sRGB RGBA values as stored in files, in [0, 1]. A face has a colour at each corner
(material, vertex or face colour) and, maybe, a texture that multiplies it. Texture coordinates are
(u, v), u right, v up: v = 1 is the top of the image, which is row 0, and images repeat without end.
"""

from typing import NamedTuple

import numpy as np

from cvn.errors import UserError
from cvn.grid import OBJECT_EXTENT


class TexturedMesh(NamedTuple):
  """V vertices, F triangles, and the colours of the triangles' corners and images."""

  vertices: np.ndarray  # [V, 3] float64
  faces: np.ndarray  # [F, 3] int64 into vertices
  corner_colors: np.ndarray  # [F, 3, 4] float32 RGBA
  corner_uv: np.ndarray  # [F, 3, 2] float32; 0 where a face has no texture
  texture: np.ndarray  # [F] int32 into textures; -1 where a face has none
  textures: tuple[np.ndarray, ...]  # [H, W, 4] uint8 RGBA each


def albedo(mesh: TexturedMesh, face: np.ndarray, barycentric: np.ndarray) -> np.ndarray:
  """Colour of surface points: the texture, bilinear and repeating, times the corners' colour.

  Args:
    mesh: the mesh.
    face: [N] faces' indices.
    barycentric: [N, 3] weights of the face's three corners.

  Returns:
    [N, 4] float32 RGBA in [0, 1].
  """
  w = barycentric.astype(np.float32)
  color = np.einsum('nk,nkc->nc', w, mesh.corner_colors[face])
  uv = np.einsum('nk,nkc->nc', w, mesh.corner_uv[face])
  texture = mesh.texture[face]
  for t in np.unique(texture[texture >= 0]):
    at = texture == t
    color[at] *= _sample(mesh.textures[t], uv[at])
  return color


def _sample(image: np.ndarray, uv: np.ndarray) -> np.ndarray:
  """Bilinear, repeating lookup: [H, W, 4] uint8 at [N, 2] -> [N, 4] float32 in [0, 1].

  Texel (row, column) has its centre at u = (column + 0.5) / W, v = 1 - (row + 0.5) / H. The
  fraction of u and v is taken first: far from 0, float32 has no digits left for it.
  """
  height, width = image.shape[:2]
  x = (uv[:, 0] - np.floor(uv[:, 0])) * width - 0.5
  y = (np.ceil(uv[:, 1]) - uv[:, 1]) * height - 0.5
  x0, y0 = np.floor(x), np.floor(y)
  fx, fy = (x - x0)[:, None], (y - y0)[:, None]
  left, top = x0.astype(np.int64) % width, y0.astype(np.int64) % height
  right, bottom = (left + 1) % width, (top + 1) % height
  upper = image[top, left] * (1 - fx) + image[top, right] * fx
  lower = image[bottom, left] * (1 - fx) + image[bottom, right] * fx
  return (upper * (1 - fy) + lower * fy) / np.float32(255)


def normalize(mesh: TexturedMesh) -> TexturedMesh:
  """Centres the bounding box at the origin and scales its longest side to `OBJECT_EXTENT`.

  The box is that of the vertices that faces use.
  """
  used = mesh.vertices[np.unique(mesh.faces)]
  low, high = used.min(0), used.max(0)
  scale = OBJECT_EXTENT / (high - low).max()
  return mesh._replace(vertices=(mesh.vertices - (low + high) / 2) * scale)


def check(mesh: TexturedMesh) -> None:
  """Rejects a mesh that cannot be normalised.

  Raises:
    UserError: no faces, coordinates that are not finite, no extent, or not a single visible face.
  """
  if not len(mesh.faces):
    raise UserError('the mesh has no faces')
  used = mesh.vertices[np.unique(mesh.faces)]
  if not np.isfinite(used).all():
    raise UserError('the mesh has coordinates that are not finite (NaN or infinite)')
  if not (np.ptp(used, axis=0).max() > 0):
    raise UserError('the mesh has no extent: all its faces shrink to one point')
