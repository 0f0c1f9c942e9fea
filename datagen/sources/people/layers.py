"""Surfaces of a dressed person: faces of the helpers and the body, cut, lifted and painted.

A layer is where a field over the vertices is not negative. Triangles are cut along the field's
zero, so that hems and hairlines are smooth; a rim closes the gap between such a hem and the surface
that the layer was lifted from. Triangles are also cut where seams are zero, without a rim, because
the next panel of the same cloth continues there.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from datagen.geometry.mesh import TexturedMesh
from datagen.sources.people.data import BodyData
from datagen.sources.people.rig import skin

NO_AREA = 1e-12  # dm^2: faces with less are left out


class Paint(NamedTuple):
  """A colour, or an image with texture coordinates."""

  color: np.ndarray  # [3] sRGB in [0, 1]; not used where there is a picture
  picture: np.ndarray | None = None  # [H, W, 4] uint8
  uv: np.ndarray | None = None  # [V, 2]
  wraps: bool = False  # u is a share of a turn: a face across the seam continues beyond 1


class Layer(NamedTuple):
  """One surface of the person."""

  faces: np.ndarray  # [F, 4] quads of one group of the body's data
  field: np.ndarray  # [V]; the surface is where it is >= 0
  lift: np.ndarray  # [V] how far it lies off the group's surface, dm
  paint: Paint
  seams: tuple[np.ndarray, ...] = ()  # [V] each; the surface is where all are >= 0


class Prop(NamedTuple):
  """A solid object attached to one bone."""

  vertices: np.ndarray  # [N, 3] at rest
  faces: np.ndarray  # [F, 3]
  bone: str
  paint: Paint


class Cut(NamedTuple):
  """The rest of cut triangles over V vertices, and the positions of the new vertices V + k."""

  faces: np.ndarray  # [G, 3]
  edges: np.ndarray  # [E, 2] the new vertex k lies on edges[k],
  shares: np.ndarray  # [E] so far from its first end towards its second
  rim: np.ndarray  # [R, 2] new edges, in the direction that the faces have them


def triangles(quads: np.ndarray) -> np.ndarray:
  """Quads [F, 4] -> triangles [2 F, 3]."""
  return quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)


def normals(vertices: np.ndarray, quads: np.ndarray) -> np.ndarray:
  """Unit normals [V, 3] at the vertices of quads, weighted by area; 0 at other vertices."""
  a, b, c, d = (vertices[quads[:, k]] for k in range(4))
  face = np.cross(c - a, d - b)
  total = np.zeros_like(vertices)
  for axis in range(3):
    weight = np.repeat(face[:, axis], 4)
    total[:, axis] = np.bincount(quads.ravel(), weight, minlength=len(vertices))
  return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12)


def clip(faces: np.ndarray, field: np.ndarray) -> Cut:
  """Cuts triangles [F, 3] where a field [V], linear in them, is 0; keeps the nonnegative part."""
  inside = field[faces] >= 0
  count = inside.sum(1)
  kept, edges, rim, start = [faces[count == 3]], [], [], len(field)
  for corners in (1, 2):
    cut = faces[count == corners]
    odd = np.argmax(inside[count == corners] == (corners == 1), axis=1)
    a, b, c = (np.take_along_axis(cut, ((odd + k) % 3)[:, None], 1)[:, 0] for k in range(3))
    ab = start + np.arange(len(cut))
    ac = ab + len(cut)
    start += 2 * len(cut)
    edges += [np.stack([a, b], 1), np.stack([a, c], 1)]
    if corners == 1:
      kept.append(np.stack([a, ab, ac], 1))
      rim.append(np.stack([ab, ac], 1))
    else:
      kept += [np.stack([ab, b, c], 1), np.stack([ab, c, ac], 1)]
      rim.append(np.stack([ac, ab], 1))
  edge = np.concatenate(edges)
  first, second = field[edge[:, 0]], field[edge[:, 1]]
  return Cut(np.concatenate(kept), edge, first / (first - second), np.concatenate(rim))


def assemble(
  data: BodyData,
  layers: Sequence[Layer],
  props: Sequence[Prop],
  vertices: np.ndarray,
  outward: np.ndarray,
  transforms: np.ndarray,
) -> TexturedMesh:
  """Cuts, lifts, poses and joins.

  Args:
    data: weights and bones.
    layers: surfaces; at least one of them has faces that are not cut away.
    props: solid objects.
    vertices: [V, 3] the body at rest.
    outward: [V, 3] normals at rest.
    transforms: [B, 4, 4] transforms of the bones.
  """
  posed = skin(vertices, data.weights, transforms)
  parts, textures = [], []
  for layer in layers:
    used = np.unique(layer.faces)
    lifted = np.zeros_like(posed)
    off = vertices[used] + layer.lift[used, None] * outward[used]
    lifted[used] = skin(off, data.weights[used], transforms)
    points, uv, faces = _cut_out(layer, lifted, posed)
    if len(faces):
      parts.append(_part(points, faces, layer.paint, uv, textures))
  for prop in props:
    m = transforms[data.bones.index(prop.bone)]
    points = prop.vertices @ m[:3, :3].T + m[:3, 3]
    parts.append(_part(points, prop.faces, prop.paint, None, textures))
  offsets = np.cumsum([0] + [len(p[0]) for p in parts[:-1]])
  return TexturedMesh(
    vertices=np.concatenate([p[0] for p in parts]),
    faces=np.concatenate([p[1] + o for p, o in zip(parts, offsets, strict=True)]),
    corner_colors=np.concatenate([p[2] for p in parts]),
    corner_uv=np.concatenate([p[3] for p in parts]),
    texture=np.concatenate([p[4] for p in parts]),
    textures=tuple(textures),
  )


def _cut_out(layer, lifted, posed):
  """The layer's posed (points [N, 3], uv [N, 2], faces [G, 3]), including unused points."""
  uv = np.zeros((len(posed), 2)) if layer.paint.uv is None else layer.paint.uv
  values = np.column_stack([lifted, posed, uv, layer.field, *layer.seams])
  faces = triangles(layer.faces)
  for k in range(len(layer.seams)):
    cut = clip(faces, values[:, 9 + k])
    faces, values = cut.faces, _with_new(values, cut, layer.paint.wraps)
  cut = clip(faces, values[:, 8])
  faces, values = cut.faces, _with_new(values, cut, layer.paint.wraps)
  points, low, uv = values[:, :3], values[:, 3:6], values[:, 6:8]
  if not layer.lift.any():
    return points, uv, faces
  (a, b), below = cut.rim.T, cut.rim.T + len(points)
  rim = np.concatenate([np.stack([b, a, below[0]], 1), np.stack([b, below[0], below[1]], 1)])
  return np.concatenate([points, low]), np.tile(uv, (2, 1)), np.concatenate([faces, rim])


def _with_new(values, cut, wraps):
  """Appends the values [V, C] of new vertices; columns 6 and 7 are u and v."""
  first, second = values[cut.edges[:, 0]], values[cut.edges[:, 1]]
  if wraps:
    second[:, 6] -= np.round(second[:, 6] - first[:, 6])
  return np.concatenate([values, first + cut.shares[:, None] * (second - first)])


def _part(points, faces, paint, uv, textures):
  """A part's (vertices, faces, corner colours, uv, texture), without faces of zero area."""
  a, b, c = (points[faces[:, k]] for k in range(3))
  faces = faces[np.linalg.norm(np.cross(b - a, c - a), axis=1) > NO_AREA]
  slot, corner_uv = -1, np.zeros((len(faces), 3, 2), np.float32)
  color = np.append(paint.color, 1.0)
  if paint.picture is not None:
    color = np.ones(4)
    slot = next((k for k, t in enumerate(textures) if t is paint.picture), len(textures))
    if slot == len(textures):
      textures.append(paint.picture)
    corner_uv = uv[faces]
    if paint.wraps:
      u = corner_uv[..., 0]
      u -= np.round(u - u[:, :1])
    corner_uv = corner_uv.astype(np.float32)
  used, faces = np.unique(faces, return_inverse=True)
  faces = faces.reshape(-1, 3)
  colors = np.tile(color.astype(np.float32), (len(faces), 3, 1))
  return points[used], faces, colors, corner_uv, np.full(len(faces), slot, np.int32)
