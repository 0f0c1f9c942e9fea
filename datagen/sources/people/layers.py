"""Surfaces of a dressed person: parts of the helpers' and the body's faces, cut, lifted and coloured.

A layer is where a field over the vertices is not negative. Triangles that its zero runs through are
cut there, so hems and hairlines are smooth lines and not the mesh's teeth.
"""

from typing import NamedTuple

import numpy as np

from datagen.mesh import TexturedMesh
from datagen.sources.people.rig import skin


class Paint(NamedTuple):
  """A colour, or a picture that is laid on by coordinates."""

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


class Prop(NamedTuple):
  """A solid thing that goes with one bone."""

  vertices: np.ndarray  # [N, 3] at rest
  faces: np.ndarray  # [F, 3]
  bone: str
  paint: Paint


def triangles(quads: np.ndarray) -> np.ndarray:
  """Quads [F, 4] as triangles [2 F, 3]."""
  return quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)


def normals(vertices: np.ndarray, quads: np.ndarray) -> np.ndarray:
  """Unit normals [V, 3] at the vertices of quads, means by area; 0 at others."""
  a, b, c, d = (vertices[quads[:, k]] for k in range(4))
  face = np.cross(c - a, d - b)
  total = np.zeros_like(vertices)
  for axis in range(3):
    weight = np.repeat(face[:, axis], 4)
    total[:, axis] = np.bincount(quads.ravel(), weight, minlength=len(vertices))
  return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12)


def clip(faces: np.ndarray, field: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
  """Cuts triangles where a field, linear in them, is zero, and keeps what is not negative.

  Args:
    faces: [F, 3].
    field: [V].

  Returns:
    faces [G, 3], in which V + k is the k-th new vertex; edges [E, 2] and shares [E]: the new
    vertex k lies on edges[k], so far from its first end towards its second.
  """
  inside = field[faces] >= 0
  count = inside.sum(1)
  kept, edges, start = [faces[count == 3]], [], len(field)
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
    else:
      kept += [np.stack([ab, b, c], 1), np.stack([ab, c, ac], 1)]
  edge = np.concatenate(edges)
  first, second = field[edge[:, 0]], field[edge[:, 1]]
  return np.concatenate(kept), edge, first / (first - second)


def assemble(layers, props, vertices, group_normals, weights, transforms, bones) -> TexturedMesh:
  """Cuts, lifts, poses and joins.

  Args:
    layers: `Layer`s.
    props: `Prop`s.
    vertices: [V, 3] the body at rest.
    group_normals: [V, 3]; groups share no vertices.
    weights: [V, B].
    transforms: [B, 4, 4] where bones go.
    bones: their names.
  """
  parts, textures = [], []
  for layer in layers:
    faces, edge, share = clip(triangles(layer.faces), layer.field)
    if not len(faces):
      continue
    used = np.unique(layer.faces)
    posed = np.zeros_like(vertices)
    lifted = vertices[used] + layer.lift[used, None] * group_normals[used]
    posed[used] = skin(lifted, weights[used], transforms)
    points = _with_new(posed, edge, share)
    uv = None if layer.paint.uv is None else _with_new(layer.paint.uv, edge, share, layer.paint)
    parts.append(_part(points, faces, layer.paint, uv, textures))
  for prop in props:
    m = transforms[bones.index(prop.bone)]
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


def _with_new(values, edge, share, paint=None):
  """Appends the new vertices' values."""
  first, second = values[edge[:, 0]], values[edge[:, 1]]
  if paint is not None and paint.wraps:
    second = second - np.round(second - first) * [1, 0]
  return np.concatenate([values, first + share[:, None] * (second - first)])


def _part(points, faces, paint, uv, textures):
  """One part's (vertices, faces, corner colours, uv, texture), without faces of no area."""
  a, b, c = (points[faces[:, k]] for k in range(3))
  faces = faces[np.linalg.norm(np.cross(b - a, c - a), axis=1) > 1e-12]
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
