"""PLY files, text and binary, with the property names that programs use -> a part.

A texture replaces other colours, and vertex colours replace face colours unless they are a single
colour. Alpha is ignored, because no PLY file says what it means.
"""

from itertools import pairwise

import numpy as np

from cvn.errors import UserError
from datagen.reading import headers
from datagen.reading import notes as notes_lib
from datagen.reading.colors import as_rgba, grey
from datagen.reading.parts import Part, Picture
from datagen.reading.ply_columns import read_columns
from datagen.reading.polygons import cut_mixed
from datagen.reading.surroundings import Surroundings, find_named

COLORS = (
  ('red', 'green', 'blue'),
  ('r', 'g', 'b'),
  ('diffuse_red', 'diffuse_green', 'diffuse_blue'),
)
COORDINATES = (('texture_u', 'texture_v'), ('u', 'v'), ('s', 't'), ('texture_s', 'texture_t'))
CORNERS = ('vertex_indices', 'vertex_index')


def read_ply(content: bytes, around: Surroundings) -> Part:
  """Reads a file.

  Args:
    content: the file's bytes.
    around: the file's surroundings, where images are searched for.

  Raises:
    UserError: it is not a PLY file, or holds less than it declares. Errors of `find_named` are
      passed on.
  """
  found, pictures = read_columns(content)
  return _part(found, pictures, around)


def _part(found, pictures, around):
  """Assembles the elements."""
  vertex, face = found.get('vertex'), found.get('face') or {}
  if vertex is None or not all(axis in vertex for axis in 'xyz'):
    raise UserError('it has no vertices with x, y and z')
  if any(isinstance(values, tuple) for values in vertex.values()):
    vertex = {name: v for name, v in vertex.items() if not isinstance(v, tuple)}
  vertices = np.stack([np.asarray(vertex[axis], np.float64) for axis in 'xyz'], -1)
  place, triangles, corner, lists = _triangles(found, face, vertices)
  if not len(triangles):
    raise UserError('the mesh has no faces: it is a cloud of points')
  colors = _chosen_colors(vertex, face, place, triangles, around.notes)
  uv, texture, shown = _texture(vertex, face, place, triangles, corner, lists, pictures, around)
  if shown and texture is not None:
    if colors is not None and not (colors[..., :3] == 1).all():
      around.notes.add(notes_lib.COLORS_IGNORED)
    bare = texture < 0
    white = np.ones((len(triangles), 3, 4), np.float32)
    white[bare] = grey(int(bare.sum())) if colors is None else colors[bare]
    return Part(vertices, triangles, white, uv, texture, shown)
  return Part(vertices, triangles, grey(len(triangles)) if colors is None else colors)


def _triangles(found, face, vertices):
  """(face [T], vertices [T, 3], the face's corners [T, 3], starts of the faces' lists [F])."""
  lists = next((face[n] for n in CORNERS if isinstance(face.get(n), tuple)), None)
  if lists is None:
    lists = next(
      (v for v in face.values() if isinstance(v, tuple) and v[1].dtype.kind in 'iu'), None
    )
  if lists is not None and len(lists[0]):
    lengths, index = lists
    index = index.astype(np.int64)
    if len(index) and not 0 <= index.min() <= index.max() < len(vertices):
      raise UserError(f'a face names a vertex that is out of bounds: there are {len(vertices)}')
    if np.maximum(lengths - 2, 0).sum() > headers.MAX_FACES:
      raise UserError(f'it has more than {headers.MAX_FACES} faces')
    starts = np.cumsum(lengths) - lengths
    polygons = []
    for n in np.unique(lengths[lengths >= 3]):
      rows = np.flatnonzero(lengths == n)
      polygons.append((rows, index[starts[rows, None] + np.arange(n)]))
    place, corner = cut_mixed(vertices, polygons)
    return place, index[starts[place][:, None] + corner], corner, starts
  strips = next((v for v in (found.get('tristrip') or {}).values() if isinstance(v, tuple)), None)
  triangles = np.zeros((0, 3), np.int64) if strips is None else _strips(*strips)
  if len(triangles) and triangles.max() >= len(vertices):
    raise UserError(f'a strip names a vertex that is out of bounds: there are {len(vertices)}')
  return np.full(len(triangles), -1), triangles, triangles, None


def _strips(lengths, index):
  """[T, 3] of strips; -1 begins another one."""
  if index.dtype.kind == 'u':
    index = index.view(index.dtype.str.replace('u', 'i'))
  index, found = index.astype(np.int64), [np.zeros((0, 3), np.int64)]
  ends = np.cumsum(lengths)
  breaks = np.flatnonzero(index < 0)
  edges = np.unique(np.concatenate([[0], ends, breaks, breaks + 1]))
  for first, last in pairwise(edges):
    strip = index[first:last]
    if last - first < 3 or strip[0] < 0:
      continue
    faces = np.stack([strip[:-2], strip[1:-1], strip[2:]], 1)
    faces[1::2] = faces[1::2][:, [1, 0, 2]]
    found.append(faces)
  return np.concatenate(found)


def _colors(columns, notes):
  """[n, 4] of an element's colours, or None."""
  by_name = {name.lower(): values for name, values in columns.items()}
  for names in COLORS:
    if all(name in by_name and not isinstance(by_name[name], tuple) for name in names):
      rgba = as_rgba(np.stack([by_name[name] for name in names], -1), notes)
      return rgba
  return None


def _chosen_colors(vertex, face, place, triangles, notes):
  """[T, 3, 4] of the vertices or of the faces; None if neither have any."""
  of_vertex = _colors(vertex, notes)
  of_face = _colors(face, notes) if len(place) and place[0] >= 0 else None
  if of_vertex is not None and of_face is not None:
    notes.add(notes_lib.COLORS_IGNORED)
    if (of_vertex == of_vertex[:1]).all() and not (of_face == of_face[:1]).all():
      of_vertex = None
  if of_vertex is not None:
    return of_vertex[triangles]
  return None if of_face is None else np.repeat(of_face[place][:, None], 3, 1)


def _texture(vertex, face, place, triangles, corner, starts, pictures, around):
  """(uv [T, 3, 2], texture [T], images); three None without an image."""
  shown, slots = [], []
  for name in pictures:
    found = find_named(around, name)
    slots.append(-1 if found is None else len(shown))
    if found is not None:
      shown.append(Picture(found[1], found[0]))
  if not shown:
    return None, None, ()
  uv = None
  lists = face.get('texcoord')
  if isinstance(lists, tuple) and starts is not None:
    lengths, values = lists
    first = np.cumsum(lengths) - lengths
    at = first[place][:, None] + 2 * corner
    known = (2 * corner.max(1) + 1 < lengths[place])[:, None]
    at = np.where(known, at, 0)
    if len(values) > 1:
      uv = np.stack([values[at], values[at + 1]], -1).astype(np.float64)
      uv[~known[:, 0]] = np.nan
  else:
    for u, v in COORDINATES:
      if u in vertex and v in vertex:
        uv = np.stack([vertex[u], vertex[v]], -1).astype(np.float64)[triangles]
        break
  texture = np.full(len(triangles), slots[0], np.int32)
  number = face.get('texnumber')
  if number is not None and not isinstance(number, tuple) and starts is not None:
    at = np.asarray(number)[place].astype(np.int64)
    texture = np.where(
      (at >= 0) & (at < len(slots)), np.array(slots)[at.clip(0, len(slots) - 1)], -1
    ).astype(np.int32)
  return uv, texture, tuple(shown)
