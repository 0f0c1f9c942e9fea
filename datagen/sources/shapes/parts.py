"""Parts: solids with a material, moved into place and joined to one mesh."""

from typing import NamedTuple

import numpy as np

from datagen.mesh import TexturedMesh
from datagen.sources.shapes.materials import Material
from datagen.sources.shapes.solids import Solid


class Part(NamedTuple):
  """A solid with its colours; moving it keeps its texture coordinates."""

  vertices: np.ndarray  # [V, 3]
  faces: np.ndarray  # [F, 3]
  uv: np.ndarray  # [F, 3, 2]
  material: Material


def paint(solid: Solid, material: Material, *, axis: int | None = None) -> Part:
  """Lays a material on a solid, each face by the axis its normal is closest to.

  Seen from outside, u runs right and v up (on horizontal faces, v runs away from a viewer in
  front), so nothing is mirrored. A material with a period repeats; one without is stretched over
  the solid's bounding box.

  Args:
    solid: where it lies now; later moves carry the picture along.
    material: what to lay on.
    axis: 0, 1 or 2 looks along that axis everywhere instead.
  """
  corners = solid.vertices[solid.faces]
  low, high = solid.vertices.min(0), solid.vertices.max(0)
  normal = _normals(solid)
  major = np.abs(normal).argmax(1) if axis is None else np.full(len(normal), axis)
  sign = np.where(normal[np.arange(len(normal)), major] < 0, -1.0, 1.0)
  t = (corners - (low + high) / 2) / (
    material.period or np.maximum(high - low, 1e-9) * 1.02
  )  # a little inside the picture: its edges wrap
  right = np.array([2, 0, 0])[major]
  above = np.array([1, 2, 1])[major]
  u = np.take_along_axis(t, right[:, None, None], 2)[..., 0]
  v = np.take_along_axis(t, above[:, None, None], 2)[..., 0]
  u = u * np.where(major == 1, 1, np.where(major == 0, -sign, sign))[:, None]
  v = v * np.where(major == 1, -1.0, 1.0)[:, None]
  return Part(solid.vertices, solid.faces, np.stack([u, v], -1) + 0.5, material)


def facing(solid: Solid, axes) -> Solid:
  """Only the faces whose normals are closest to one of some axes; the extent stays known."""
  keep = np.isin(np.abs(_normals(solid)).argmax(1), axes)
  return solid._replace(faces=solid.faces[keep])


def _normals(solid: Solid | Part) -> np.ndarray:
  """Normals [F, 3] as long as twice the area."""
  a, b, c = np.moveaxis(solid.vertices[solid.faces], 1, 0)
  return np.cross(b - a, c - a)


def move(part, offset):
  """Shifts a solid or part."""
  return part._replace(vertices=part.vertices + np.asarray(offset, float))


def scale(part, factor):
  """Scales a solid or part about the origin; factors are positive."""
  return part._replace(vertices=part.vertices * np.asarray(factor, float))


def rotation(axis: int, degrees: float) -> np.ndarray:
  """The right-handed turn [3, 3] about x, y or z."""
  c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
  m = np.eye(3)
  i, j = (axis + 1) % 3, (axis + 2) % 3
  m[[i, i, j, j], [i, j, i, j]] = [c, -s, s, c]
  return m


def turn(part, axis: int, degrees: float):
  """Turns a solid or part about a coordinate axis through the origin."""
  return part._replace(vertices=part.vertices @ rotation(axis, degrees).T)


def mirror(part: Part) -> Part:
  """The part's mirror image in the plane x = 0, faces still outward."""
  return part._replace(
    vertices=part.vertices * [-1, 1, 1], faces=part.faces[:, ::-1], uv=part.uv[:, ::-1]
  )


def assemble(parts) -> TexturedMesh:
  """Joins parts to one mesh; a picture that several share is kept once; faces of no area go."""
  vertices, faces, colors, uvs, texture = [], [], [], [], []
  pictures: list[np.ndarray] = []
  start = 0
  for part in parts:
    keep = np.linalg.norm(_normals(part), axis=1) > 1e-12
    picture = part.material.picture
    slot = -1
    if picture is not None:
      slot = next((k for k, p in enumerate(pictures) if p is picture), len(pictures))
      if slot == len(pictures):
        pictures.append(picture)
    count = int(keep.sum())
    vertices.append(part.vertices)
    faces.append(part.faces[keep] + start)
    rgba = np.append(part.material.color, 1.0).astype(np.float32)
    colors.append(np.broadcast_to(rgba, (count, 3, 4)))
    uvs.append((part.uv[keep] if slot >= 0 else np.zeros((count, 3, 2))).astype(np.float32))
    texture.append(np.full(count, slot, np.int32))
    start += len(part.vertices)
  return TexturedMesh(
    vertices=np.concatenate(vertices),
    faces=np.concatenate(faces).astype(np.int64),
    corner_colors=np.concatenate(colors),
    corner_uv=np.concatenate(uvs),
    texture=np.concatenate(texture),
    textures=tuple(pictures),
  )
