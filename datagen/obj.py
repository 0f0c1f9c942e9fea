"""OBJ text, made plain for trimesh."""

import re

from cvn.errors import UserError

_RELATIVE = re.compile(rb'^[ \t]*f(?=[ \t])[^\n]*[ \t/][-0]', re.MULTILINE)
_NORMAL = re.compile(rb'^vn[ \t][^\n]*\n', re.MULTILINE)
_CORNER = re.compile(rb'(?<=[ \t])(\d+/\d*)/\d+(?=[ \t\r\n]|$)')
_NAME_LIKE_A_CORNER = re.compile(rb'^(usemtl|mtllib)[^\n]*[ \t]\d+/\d*/\d', re.MULTILINE)
PIECE = 1 << 22  # bytes of text changed at a time
_KINDS = {b'v': 0, b'vt': 1, b'vn': 2}


def absolute_indices(content: bytes) -> bytes:
  """Replaces relative indices of faces: -1 is the vertex just before the face, not the file's last.

  Args:
    content: of the file.

  Raises:
    UserError: an index is 0, or counts back to before the first vertex.
  """
  content = content.replace(b'\\\r\n', b' ').replace(b'\\\n', b' ')  # lines that go on
  if not _RELATIVE.search(content):
    return content
  counts, lines = [0, 0, 0], []
  for line in content.split(b'\n'):
    word = line.split(None, 1)[:1]
    if word == [b'f']:
      line = b'f ' + b' '.join(_absolute(c, counts, line) for c in line.split()[1:])
    elif word and word[0] in _KINDS:
      counts[_KINDS[word[0]]] += 1
    lines.append(line)
  return b'\n'.join(lines)


def _absolute(corner, counts, line):
  indices = []
  for index, count in zip(corner.split(b'/'), counts, strict=False):
    if index:
      k = int(index)
      if k == 0 or k < -count:
        raise UserError(f'{line.decode(errors="replace").strip()[:80]!r} names what is not there')
      index = b'%d' % (count + 1 + k if k < 0 else k)
    indices.append(index)
  return b'/'.join(indices)


def without_normals(content: bytes) -> bytes:
  """Leaves out normals, which have no say here: large files need the memory.

  trimesh would also make a vertex of each pair of a position and a normal.

  Args:
    content: of a file in which indices are absolute.
  """
  if _NAME_LIKE_A_CORNER.search(content):
    return content
  pieces, start = [], 0
  while start < len(content):
    end = content.find(b'\n', start + PIECE) + 1 or len(content)
    piece = _NORMAL.sub(b'', content[start:end])
    pieces.append(_CORNER.sub(rb'\1', piece))
    start = end
  return b''.join(pieces)
