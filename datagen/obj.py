"""OBJ text, made plain for trimesh."""

import re

from cvn.errors import UserError

_RELATIVE = re.compile(rb'^[ \t]*f(?=[ \t])[^\n]*[ \t/][-0]', re.MULTILINE)
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
