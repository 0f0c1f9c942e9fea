"""Coloured triangle meshes: one form for all file formats.

Colours are sRGB RGBA values as stored in files, in [0, 1], never linearised. A face has a colour at
each corner (the product of material, vertex and face colour) and optionally a texture that
multiplies it. Texture coordinates are (u, v), u right, v up: v = 1 is the top of the image, which
is row 0. Outside [0, 1] an image is repeated, mirrored or clamped, along u and v.

Every face is surface, glass included (a corner alpha below 1 means glass and removes nothing),
except where the texture's alpha is below `CUTOUT_ALPHA`: there it has a hole.
"""

from typing import NamedTuple

import numpy as np

from cvn.errors import UserError
from cvn.grid import OBJECT_EXTENT

CUTOUT_ALPHA = 0.5
NO_COLOR = 0.6  # the grey of a mesh that has no colour at all
WRAPS = ('repeat', 'mirror', 'clamp')
REPEAT = ('repeat', 'repeat')  # along u and v
MAX_COORDINATE = 1e100  # products of some of them are still finite


class TexturedMesh(NamedTuple):
  """V vertices, F triangles, the colours of the triangles' corners, and textures."""

  vertices: np.ndarray  # [V, 3] float64
  faces: np.ndarray  # [F, 3] int64 into vertices
  corner_colors: np.ndarray  # [F, 3, 4] float32 RGBA
  corner_uv: np.ndarray  # [F, 3, 2] float32; 0 where a face has no texture
  texture: np.ndarray  # [F] int32 into textures; -1 where a face has none
  textures: tuple[np.ndarray, ...]  # [H, W, 4] uint8 RGBA each
  missing: tuple[str, ...] = ()  # files and materials that are named but not there
  wraps: tuple[tuple[str, str], ...] = ()  # of each texture, along u and v; () repeats all
  notes: tuple[str, ...] = ()  # of datagen.reading.notes: what its reader ignored or guessed


def albedo(mesh: TexturedMesh, face: np.ndarray, barycentric: np.ndarray) -> np.ndarray:
  """Colour of surface points: the bilinear texture times the colour of the corners.

  Args:
    mesh: the mesh.
    face: [N] indices of faces.
    barycentric: [N, 3] weights of the face's three corners.

  Returns:
    [N, 4] float32 RGBA in [0, 1].
  """
  color = _interpolate(mesh.corner_colors, face, barycentric)
  for at, texel in _texels(mesh, face, barycentric):
    color[at] *= texel
  return color


def is_surface(mesh: TexturedMesh, face: np.ndarray, barycentric: np.ndarray) -> np.ndarray:
  """Whether points of faces are surface and not in a hole of a texture: [N] bool."""
  present = np.ones(len(face), bool)
  holed = [t for t, image in enumerate(mesh.textures) if image[..., 3].min() < 255 * CUTOUT_ALPHA]
  for at, texel in _texels(mesh, face, barycentric, only=holed):
    present[at] = texel[:, 3] >= CUTOUT_ALPHA
  return present


def _interpolate(corners, face, barycentric):
  """Interpolates [F, 3, C] values of corners at [N] points of faces: [N, C] float32."""
  corner, w = corners[face], barycentric.astype(np.float32)
  return corner[:, 0] * w[:, :1] + corner[:, 1] * w[:, 1:2] + corner[:, 2] * w[:, 2:]


def _texels(mesh, face, barycentric, only=None):
  """Yields (indices into the points, their [n, 4] texels) for each texture."""
  texture = mesh.texture[face]
  for t in range(len(mesh.textures)) if only is None else only:
    at = np.flatnonzero(texture == t)
    if len(at):
      uv = _interpolate(mesh.corner_uv, face[at], barycentric[at])
      yield at, _sample(mesh.textures[t], uv, mesh.wraps[t] if mesh.wraps else REPEAT)


def _sample(image: np.ndarray, uv: np.ndarray, wrap: tuple[str, str] = REPEAT) -> np.ndarray:
  """Bilinear lookup: [H, W, 4] uint8 at [N, 2] -> [N, 4] float32 in [0, 1].

  Texel (row, column) has its centre at u = (column + 0.5) / W, v = 1 - (row + 0.5) / H.
  """
  height, width = image.shape[:2]
  left, right, fx = _texel_pair(uv[:, 0], width, wrap[0])
  top, bottom, fy = _texel_pair(-uv[:, 1] if wrap[1] == 'repeat' else 1 - uv[:, 1], height, wrap[1])
  fx, fy = fx[:, None], fy[:, None]
  upper = image[top, left] * (1 - fx) + image[top, right] * fx
  lower = image[bottom, left] * (1 - fx) + image[bottom, right] * fx
  return (upper * (1 - fy) + lower * fy) / np.float32(255)


def _texel_pair(at, size, wrap):
  """The two texels beside each of [N] positions along one side, and the share of the second."""
  if wrap == 'mirror':
    at = 1 - np.abs(at % 2 - 1)
  x = (at % 1 if wrap == 'repeat' else at) * size - np.float32(0.5)
  first = np.floor(x)
  share = x - first
  first = first.astype(np.int64)
  if wrap == 'repeat':
    first = first % size
    return first, (first + 1) % size, share
  return first.clip(0, size - 1), (first + 1).clip(0, size - 1), share


def check(mesh: TexturedMesh) -> None:
  """Rejects a mesh that cannot be normalised.

  Raises:
    UserError: no faces, coordinates that are not finite or too large, or no extent.
  """
  if not len(mesh.faces):
    raise UserError('the mesh has no faces')
  used = mesh.vertices[np.unique(mesh.faces)]
  if not np.isfinite(used).all():
    raise UserError('the mesh has coordinates that are not finite (NaN or infinite)')
  if np.abs(used).max() > MAX_COORDINATE:
    raise UserError(f'the mesh has coordinates beyond {MAX_COORDINATE:g}')
  if not np.ptp(used, axis=0).max() > 0:
    raise UserError('the mesh has no extent: all its faces shrink to one point')


def normalize(mesh: TexturedMesh) -> TexturedMesh:
  """Centres the bounding box at the origin and scales its longest side to `OBJECT_EXTENT`.

  The box holds the vertices that faces use.
  """
  used = mesh.vertices[np.unique(mesh.faces)]
  low, high = used.min(0), used.max(0)
  scale = OBJECT_EXTENT / (high - low).max()
  return mesh._replace(vertices=(mesh.vertices - (low + high) / 2) * scale)
