"""Parts: solids with a material, moved into place and joined to one mesh."""

from typing import NamedTuple

import numpy as np

from datagen.geometry.mesh import TexturedMesh
from datagen.sources.shapes.cutting import exposed
from datagen.sources.shapes.materials import Material
from datagen.sources.shapes.solids import Solid

# The axes that run right and up on faces across each axis.
_RIGHT, _ABOVE = np.array([2, 0, 0]), np.array([1, 2, 1])


class Part(NamedTuple):
  """A solid with its colours; moving it keeps its texture coordinates."""

  vertices: np.ndarray  # [V, 3]
  faces: np.ndarray  # [F, 3]
  uv: np.ndarray  # [F, 3, 2]
  material: Material


def paint(solid: Solid, material: Material, *, axis: int | None = None) -> Part:
  """Applies a material to a solid, each face by the axis closest to its normal.

  Seen from outside, u runs right and v up (on horizontal faces, v runs away from a viewer in
  front), so nothing is mirrored. A material with a period repeats; one without is stretched over
  the solid's bounding box. Grain runs along the box's longest side.

  Args:
    solid: in its present position; later moves carry the image along.
    material: the material.
    axis: 0, 1 or 2 projects along that axis everywhere.
  """
  corners = solid.vertices[solid.faces]
  middle, reach = _box(solid)
  normal = _normals(solid)
  major = np.abs(normal).argmax(1) if axis is None else np.full(len(normal), axis)
  sign = np.where(normal[np.arange(len(normal)), major] < 0, -1.0, 1.0)
  t = (corners - middle) / (material.period or reach)
  u = np.take_along_axis(t, _RIGHT[major][:, None, None], 2)[..., 0]
  v = np.take_along_axis(t, _ABOVE[major][:, None, None], 2)[..., 0]
  u = u * np.where(major == 1, 1, np.where(major == 0, -sign, sign))[:, None]
  v = v * np.where(major == 1, -1.0, 1.0)[:, None]
  if material.grain:
    across = (_RIGHT[major] == reach.argmax())[:, None]
    u, v = np.where(across, v, u), np.where(across, u, v)
  return Part(solid.vertices, solid.faces, np.stack([u, v], -1) + 0.5, material)


def texels(solid: Solid, axis: int, sign: int, size: int) -> tuple[np.ndarray, np.ndarray]:
  """Positions of a stretched image's texels on one side of a solid.

  Args:
    solid: the solid; the image spans its whole box.
    axis: 0, 1 or 2.
    sign: 1 or -1, the side that looks along the axis or against it.
    size: side of the image, which is square.

  Returns:
    Coordinates [size, size] along z, x, x and along y, z, y for axis 0, 1, 2.
  """
  middle, reach = _box(solid)
  t = (np.arange(size) + 0.5) / size - 0.5
  u, v = np.meshgrid(t, -t)
  u, v = u * (-sign, 1, sign)[axis], v * (1, -1, 1)[axis]
  right, above = _RIGHT[axis], _ABOVE[axis]
  return middle[right] + u * reach[right], middle[above] + v * reach[above]


def facing(solid: Solid, axes, sign: int = 0) -> Solid:
  """Only the faces whose normals are closest to some axes, or to one direction of them.

  The extent of the whole is kept.
  """
  normal = _normals(solid)
  major = np.abs(normal).argmax(1)
  along = normal[np.arange(len(normal)), major]
  return solid._replace(faces=solid.faces[np.isin(major, axes) & (along * sign >= 0)])


def ahead(solid: Solid) -> tuple[Solid, Solid]:
  """The faces that look to +z, however slightly, and the others; the extent stays known."""
  front = _normals(solid)[:, 2] > 0
  return solid._replace(faces=solid.faces[front]), solid._replace(faces=solid.faces[~front])


def _box(solid: Solid):
  """The bounding box's middle [3], and how far pictures reach [3]: a little over its edges."""
  low, high = solid.vertices.min(0), solid.vertices.max(0)
  return (low + high) / 2, np.maximum(high - low, 1e-9) * 1.02  # at a picture's edge it wraps


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
  """Joins the visible parts to one mesh; shared images are kept once.

  Parts are closed solids, or sides of one (`facing`) that are all among the parts. Surface inside
  other solids and faces of zero area are removed.
  """
  parts = [without_slivers(part) for part in parts]
  corners = np.concatenate([p.vertices[p.faces] for p in parts])
  part_of = np.repeat(np.arange(len(parts)), [len(p.faces) for p in parts])
  boxes = [np.concatenate([p.vertices.min(0), p.vertices.max(0)]) for p in parts]
  # Sides of one solid have one box.
  solid = np.unique(np.round(boxes, 9), axis=0, return_inverse=True)[1].ravel()
  pieces = exposed(corners, solid[part_of])
  uv = np.concatenate([p.uv for p in parts])[pieces.face]
  color = np.stack([np.append(p.material.color, 1.0) for p in parts])[part_of[pieces.face]]
  slots, pictures = [], []
  for part in parts:
    picture = part.material.picture
    slot = next((k for k, p in enumerate(pictures) if p is picture), len(pictures))
    slots.append(-1 if picture is None else slot)
    if picture is not None and slot == len(pictures):
      pictures.append(picture)
  texture = np.array(slots, np.int32)[part_of[pieces.face]]
  count = len(pieces.face)
  return TexturedMesh(
    vertices=(pieces.weights @ corners[pieces.face]).reshape(-1, 3),
    faces=np.arange(3 * count).reshape(-1, 3),
    corner_colors=np.repeat(color[:, None], 3, axis=1).astype(np.float32),
    corner_uv=(pieces.weights @ uv * (texture >= 0)[:, None, None]).astype(np.float32),
    texture=texture,
    textures=tuple(pictures),
  )


def without_slivers(part: Part) -> Part:
  """The part without its faces of zero area."""
  keep = np.linalg.norm(_normals(part), axis=1) > 1e-12
  return part._replace(faces=part.faces[keep], uv=part.uv[keep])
