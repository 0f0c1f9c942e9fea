"""OBJ files as programs write them, with the materials of their MTL files -> a part.

A texture replaces the material's colour. The MTL format says that `Kd` multiplies `map_Kd`, but
exporters write there what the texture replaces (0 0 0, a grey, the texture's mean), and the product
is far too dark. Vertex colours replace both, because a material beside them is an exporter's
default; vertex colours that are white everywhere are ignored.
"""

from collections import defaultdict
from typing import NamedTuple

import numpy as np

from cvn.errors import UserError
from datagen.reading import headers
from datagen.reading import notes as notes_lib
from datagen.reading.colors import as_rgba, grey
from datagen.reading.obj_materials import dressed, named_materials
from datagen.reading.parts import Part
from datagen.reading.polygons import cut_mixed
from datagen.reading.surroundings import Surroundings, read_text

PIECE = 1 << 22  # bytes of text taken apart at a time
SHOWN = 60  # characters of a line in a message


class _Faces(NamedTuple):
  """P polygons with N corners; indices count from 1, 0 means none, -1 is the last one so far."""

  line: np.ndarray  # [P] its line in the file
  material: np.ndarray  # [P]
  corner: np.ndarray  # [P, N, 2] vertex and texture coordinate


def read_obj(content: bytes, around: Surroundings) -> Part:
  """Reads a file.

  Args:
    content: the file's bytes.
    around: the file's surroundings, where MTL files and images are searched for.

  Raises:
    UserError: an invalid number, a face with vertices that do not exist, or too many faces. Errors
      of `find_named` are passed on.
  """
  content = read_text(content, around.notes)
  if b'\\\n' in content:
    content = content.replace(b'\\\n', b' ')  # lines that go on
  points, coordinates, faces = [], [], []
  names, libraries = [], []  # as they are met
  material, line_number, counts = -1, 0, [0, 0]
  start, total = 0, 0
  while start < len(content):
    end = content.find(b'\n', start + PIECE) + 1 or len(content)
    vertex, texture = [], []
    groups = defaultdict(list)
    for line in content[start:end].split(b'\n'):
      line_number += 1
      head = line[:2]
      if head not in (b'v ', b'f ', b'vt', b'vn'):  # the usual ones, at once
        line = line.strip()
        head = line[:2].replace(b'\t', b' ')
      if head == b'v ':
        vertex.append(line)
      elif head == b'f ':
        words = line.partition(b'#')[0].split()[1:]
        relative = b'-' in line
        group = (len(words), line.count(b'/'), b'//' in line, relative)
        so_far = (counts[0] + len(vertex), counts[1] + len(texture)) if relative else None
        groups[group].append((line_number, material, words, so_far))
        total += max(0, len(words) - 2)
      elif head == b'vt':
        texture.append(line)
      elif head in (b'us', b'mt'):
        key, _, rest = line.replace(b'\t', b' ').partition(b' ')
        if key.lower() == b'usemtl':
          material = len(names)
          names.append(rest.strip().decode(errors='replace'))
        elif key.lower() == b'mtllib':
          libraries.append(rest.strip().decode(errors='replace'))
    if total > headers.MAX_FACES:
      raise UserError(f'it has {total} faces, more than {headers.MAX_FACES}')
    points += _numbers(vertex, 3, 7)
    coordinates += _numbers(texture, 1, 3)
    counts[0] += len(vertex)
    counts[1] += len(texture)
    faces += [_parsed(group, lines) for group, lines in groups.items() if group[0] >= 3]
    start = end
  return _part(points, coordinates, faces, names, libraries, around)


def _numbers(lines, least, most):
  """Lines of numbers after a keyword -> arrays [n, width] in order, one for each run of a width."""
  if not lines:
    return []
  rows = [line.partition(b'#')[0].split()[1:] for line in lines]
  widths = np.array([len(row) for row in rows])
  if widths.min() < least:
    raise UserError(f'{_shown(lines[int(widths.argmin())])} has too few numbers')
  runs = np.flatnonzero(np.diff(widths)) + 1
  if len(runs) > 1000:  # line by line, they are no runs: the longer ones are cut
    runs, widths = [], np.full(len(rows), widths.min())
  found = []
  for first, last in zip([0, *runs], [*runs, len(rows)], strict=True):
    width = min(int(widths[first]), most)
    words = [word for row in rows[first:last] for word in row[:width]]
    try:
      values = np.array(words, dtype=np.float64)
    except ValueError:
      values = None
    if values is None:
      bad = next(n for n in range(first, last) if not _are_numbers(rows[n][:width]))
      raise UserError(f'{_shown(lines[bad])} is not a line of numbers')
    found.append(values.reshape(-1, width))
  return found


def _are_numbers(words):
  try:
    np.array(words, dtype=np.float64)
  except ValueError:
    return False
  return True


def _shown(line):
  return repr(line.decode(errors='replace').strip()[:SHOWN])


def _parsed(group, lines):
  """One kind of faces -> `_Faces`."""
  corners, slashes, has_empty, relative = group
  numbers, material, words, so_far = zip(*lines, strict=True)
  flat = [word for row in words for word in row]
  if slashes == 0:
    parts = 1
  elif slashes == corners and not has_empty:
    parts = 2
  elif slashes == 2 * corners:
    parts = 3
  else:
    parts = 0
  index = None
  if parts:
    text = b' '.join(flat)
    if has_empty:
      text = text.replace(b'//', b'/0/')
    try:
      index = np.array(text.replace(b'/', b' ').split(), dtype=np.int64)
    except (ValueError, OverflowError):
      index = None
    if index is not None and index.size != len(flat) * parts:
      index = None
  if index is None:  # corners of several kinds, or `1/2/`
    index, parts = np.array([_corner(word) for word in flat], np.int64).ravel(), 2
  index = index.reshape(len(lines), corners, parts)[..., :2]
  if parts == 1:
    index = np.concatenate([index, np.zeros_like(index)], -1)
  if relative:  # -1 is the vertex just before the face, not the file's last
    index = np.where(index < 0, index + np.array(so_far)[:, None] + 1, index)
    if index.min() < 0:
      index = np.where(index < 0, 0, index)
  if not index[..., 0].all():
    bad = int(np.argmin(index[..., 0].all(1)))
    line = b'f ' + b' '.join(words[bad])
    raise UserError(f'{_shown(line)} names a vertex that does not exist')
  return _Faces(np.array(numbers), np.array(material), index)


def _corner(word):
  """`1/2/3`, without any of the last two -> (vertex, texture coordinate or 0)."""
  first, _, rest = word.partition(b'/')
  second = rest.partition(b'/')[0]
  try:
    corner = int(first), int(second or 0)
  except ValueError as e:
    raise UserError(f'{_shown(word)} is not a corner of a face') from e
  if max(map(abs, corner)) >= 1 << 62:
    raise UserError(f'{_shown(word)} names a vertex that does not exist')
  return corner


def _part(points, coordinates, faces, names, libraries, around):
  """Assembles everything that was read."""
  vertices = np.concatenate([np.zeros((0, 3)), *(p[:, :3] for p in points)])
  uv = np.concatenate(
    [np.zeros((0, 2)), *(np.concatenate([c, np.zeros_like(c)], 1)[:, :2] for c in coordinates)]
  )
  for polygons in faces:
    if polygons.corner[..., 0].max() > len(vertices):
      raise UserError(f'a face names a vertex that is out of bounds: there are {len(vertices)}')
  # Lines are counted over all kinds of faces, and so give back the file's order.
  place, corner = cut_mixed(vertices, [(f.line, f.corner[..., 0] - 1) for f in faces])
  if not len(place):
    return Part(vertices, np.zeros((0, 3), np.int64), grey(0))
  index, material = _of_triangles(faces, place, corner)
  triangles, at = index[..., 0] - 1, index[..., 1] - 1
  materials = named_materials(names, libraries, material, around)
  known = (at >= 0) & (at < len(uv))
  corner_uv = None
  if len(uv):
    corner_uv = np.where(known[..., None], uv[at.clip(0, len(uv) - 1)], np.nan)
    corner_uv[~known.all(1)] = np.nan
  colors = _vertex_colors(points, triangles, around.notes)
  return dressed(Part(vertices, triangles, colors), corner_uv, material, materials, around)


def _of_triangles(faces, place, corner):
  """([T, 3, 2] indices, [T] materials) of triangles, given the lines of their polygons."""
  index = np.zeros((len(place), 3, 2), np.int64)
  material = np.zeros(len(place), np.int64)
  for polygons in faces:
    row = np.searchsorted(polygons.line, place).clip(0, len(polygons.line) - 1)
    mine = np.flatnonzero(polygons.line[row] == place)
    row = row[mine]
    index[mine] = polygons.corner[row[:, None], corner[mine]]
    material[mine] = polygons.material[row]
  return index, material


def _vertex_colors(points, triangles, notes):
  """[F, 3, 4] of the colours after the coordinates, NaN where there are none.

  A corner without a colour takes the mean of the face's other corners.
  """
  if not any(p.shape[1] >= 6 for p in points):  # a fourth number alone is a weight
    return np.full((len(triangles), 3, 4), np.nan, np.float32)
  colors = np.concatenate(
    [p[:, 3:6] if p.shape[1] >= 6 else np.full((len(p), 3), np.nan) for p in points]
  )
  has_color = ~np.isnan(colors).any(1)
  written = colors[has_color]
  top = written.max(initial=0)
  if top in (1, 255) and (written == top).all():
    return np.full((len(triangles), 3, 4), np.nan, np.float32)  # white all over
  if top > 1:
    notes.add(notes_lib.COLOR_RANGE_GUESSED)
    colors = colors / 255
  rgba = as_rgba(colors)
  rgba[~has_color] = np.nan
  of_corners = rgba[triangles]
  partly = np.isnan(of_corners[..., 0])
  some = partly.any(1) & ~partly.all(1)
  if some.any():
    mean = np.nanmean(of_corners[some], axis=1, keepdims=True)
    of_corners[some] = np.where(partly[some][..., None], mean, of_corners[some])
  return of_corners
