"""OFF files and their variants (COFF, NOFF, STOFF, 4OFF) -> a part.

Vertex colours win over face colours; alpha is ignored.
"""

import re

import numpy as np

from cvn.errors import UserError
from datagen.reading import headers
from datagen.reading import notes as notes_lib
from datagen.reading.colors import as_rgba, grey
from datagen.reading.parts import Part
from datagen.reading.polygons import cut_mixed
from datagen.reading.surroundings import read_text

_KEYWORD = re.compile(rb'(ST)?(C)?(N)?(4)?(n)?OFF')


def read_off(content: bytes, notes: set[str]) -> Part:
  """Reads a file.

  Args:
    content: the file's bytes.
    notes: set that gets notes of guesses.

  Raises:
    UserError: it is not a three-dimensional OFF file in text form, or holds less than it declares.
  """
  lines = [line.partition(b'#')[0].strip() for line in read_text(content, notes).split(b'\n')]
  lines = [line for line in lines if line]
  match = _KEYWORD.match(lines[0]) if lines else None
  if match is None:
    raise UserError('it has no header')
  rest = lines[0][match.end() :].strip()
  if rest.startswith(b'BINARY') or match[5]:
    raise UserError('it is a binary OFF file, or not three-dimensional: save it as OFF text')
  lines = lines[1:] if not rest else [rest, *lines[1:]]
  try:
    vertex_count, face_count = (int(word) for word in lines[0].split()[:2])
  except (IndexError, ValueError) as e:
    raise UserError('it does not say how many vertices and faces it has') from e
  if min(vertex_count, face_count) < 0 or vertex_count + face_count > len(lines) - 1:
    raise UserError(f'it declares {vertex_count} vertices and {face_count} faces and holds fewer')
  if face_count > headers.MAX_FACES:
    raise UserError(f'it has {face_count} faces, more than {headers.MAX_FACES}')
  vertices, vertex_colors = _vertices(lines[1 : 1 + vertex_count], match, notes)
  rows = [line.split() for line in lines[1 + vertex_count :][:face_count]]
  return _part(vertices, vertex_colors, rows, notes)


def _vertices(lines, match, notes):
  """([V, 3], colours [V, 4] or None)."""
  rows = [line.split() for line in lines]
  width = min(map(len, rows), default=3)
  values = _numbers([word for row in rows for word in row[:width]]).reshape(len(rows), width)
  at = 4 if match[4] else 3
  if width < at:
    raise UserError('its vertices have too few numbers')
  points = values[:, :3]
  if match[4]:
    points = points / np.where(values[:, 3:4] == 0, 1, values[:, 3:4])
  at += 3 if match[3] else 0
  left = width - at - (2 if match[1] else 0)
  if left < 3 or not (match[2] or (left in (3, 4) and not match[3])):
    return points, None
  written = [row[at : at + 3] for row in rows]
  return points, _rgba(written, notes)


def _rgba(words, notes):
  """[n, 4] from three words each, divided by 255 if all are integers and one exceeds 1."""
  values = _numbers([word for row in words for word in row]).reshape(-1, 3)
  whole = not any(b'.' in word or b'e' in word for row in words for word in row)
  if whole and values.max(initial=0) > 1:
    values = values / 255
  return as_rgba(values, notes)


def _part(vertices, vertex_colors, rows, notes):
  kinds: dict[int, list[int]] = {}
  for n, row in enumerate(rows):
    try:
      kinds.setdefault(int(row[0]), []).append(n)
    except ValueError as e:
      raise UserError(f'{row[0].decode(errors="replace")[:20]!r} is not a number of corners') from e
  polygons = []
  for count, places in kinds.items():
    if count < 3:
      continue
    if any(len(rows[n]) < 1 + count for n in places):
      raise UserError(f'one of its faces of {count} corners has fewer')
    index = _numbers([word for n in places for word in rows[n][1 : 1 + count]]).astype(np.int64)
    if not 0 <= index.min() <= index.max() < len(vertices):
      raise UserError(f'a face names a vertex that is out of bounds: there are {len(vertices)}')
    polygons.append((np.array(places), index.reshape(-1, count)))
  place, corner = cut_mixed(vertices, polygons)
  triangles = np.zeros((len(place), 3), np.int64)
  for places, index in polygons:
    row = np.searchsorted(places, place).clip(0, len(places) - 1)
    mine = np.flatnonzero(places[row] == place)
    triangles[mine] = index[row[mine, None], corner[mine]]
  colors = grey(len(triangles))
  of_face = _face_colors(rows, notes)
  if vertex_colors is not None:
    if of_face is not None:
      notes.add(notes_lib.COLORS_IGNORED)
    colors = vertex_colors[triangles]
  elif of_face is not None:
    has_color = of_face[place, 3] > 0
    colors[has_color] = of_face[place][has_color, None]
  return Part(vertices, triangles, colors)


def _face_colors(rows, notes):
  """[F, 4], 0 for a face without a colour; None if no face has one."""
  words = [row[1 + int(row[0]) :] for row in rows]
  colored = [n for n, row in enumerate(words) if len(row) >= 3]
  if not colored:
    return None
  result = np.zeros((len(rows), 4), np.float32)
  result[colored] = _rgba([words[n][:3] for n in colored], notes)
  return result


def _numbers(words):
  try:
    return np.array(words, np.float64) if words else np.zeros(0)
  except ValueError as e:
    raise UserError('it contains something that is not a number') from e
