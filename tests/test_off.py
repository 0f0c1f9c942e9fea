"""OFF files and their kinds."""

import numpy as np
import pytest

from cvn.errors import UserError
from datagen.geometry.mesh import NO_COLOR
from datagen.reading.off import read_off

POINTS = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]


def off(keyword='OFF', more='', faces=('4 0 1 2 3',), counts=True):
  lines = [f'{x} {y} {z} {more}' for x, y, z in POINTS]
  lines = [keyword, f'4 {len(faces)} 0' if counts else '', '# no', *lines, *faces]
  return '\n'.join(line for line in lines if line).encode()


def color(part, face=0):
  return np.round(part.colors[face, 0].astype(float), 3).tolist()


def read(content):
  return read_off(content, set())


@pytest.mark.parametrize(
  ('keyword', 'more', 'expected'),
  [
    ('OFF', '', [NO_COLOR] * 3),
    ('OFF', '255 51 0', [1, 0.2, 0]),  # as some write it
    ('COFF', '255 51 0 0', [1, 0.2, 0]),
    ('COFF', '1.0 0.2 0.0 1.0', [1, 0.2, 0]),
    ('COFF', '1 0 0 1', [1, 0, 0]),
    ('NOFF', '0 0 1', [NO_COLOR] * 3),
    ('CNOFF', '0 0 1 255 51 0 255', [1, 0.2, 0]),
    ('STOFF', '0.5 0.5', [NO_COLOR] * 3),
    ('STCOFF', '255 51 0 255 0.5 0.5', [1, 0.2, 0]),
  ],
)
def test_kinds(keyword, more, expected):
  part = read(off(keyword, more))
  assert part.vertices.tolist() == [list(map(float, p)) for p in POINTS]
  assert part.faces.tolist() == [[0, 1, 2], [0, 2, 3]]
  assert color(part) == [*expected, 1]


def test_weights_divide():
  part = read(b'4OFF\n3 1 0\n0 0 0 1\n2 0 0 2\n0 3 0 3\n3 0 1 2\n')
  assert part.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0]]


def test_face_colors():
  faces = ['3 0 1 2 255 51 0', '3 0 2 3 0 255 0 9', '3 0 1 3', '4 0 1 2 3 7']
  part = read(off(faces=faces))
  assert [color(part, n)[:3] for n in range(5)] == [
    [1, 0.2, 0], [0, 1, 0], *[[NO_COLOR] * 3] * 3
  ]  # fmt: skip
  part = read(off(faces=['3 0 1 2 1.0 0.2 0.0']))
  assert color(part)[:3] == [1, 0.2, 0]
  assert color(read(off('COFF', '0 0 255', faces)))[:3] == [0, 0, 1]


def test_counts_in_the_first_line():
  assert len(read(off('OFF4 1 0', counts=False)).faces) == 2
  assert len(read(b'\xef\xbb\xbf' + off().replace(b'\n', b'\r\n')).faces) == 2


@pytest.mark.parametrize(
  ('content', 'reason'),
  [
    (b'', 'no header'),
    (b'PLY\n', 'no header'),
    (b'OFF BINARY\n', 'save it as OFF text'),
    (b'nOFF\n4\n3 1 0\n', 'not three-dimensional'),
    (b'OFF\n', 'does not say'),
    (b'OFF\n3 x 0\n', 'does not say'),
    (b'OFF\n-3 1 0\n', 'holds fewer'),
    (off(faces=['3 0 1 4']), 'out of bounds'),
    (off(faces=['3 0 1 -1']), 'out of bounds'),
    (off(faces=['4 0 1 2']), 'has fewer'),
    (off(faces=['x 0 1 2']), 'not a number of corners'),
    (off(faces=['3 0 1 x']), 'not a number'),
    (b'OFF\n1 1 0\n0 0\n3 0 0 0\n', 'too few numbers'),
  ],
)
def test_what_is_refused(content, reason):
  with pytest.raises(UserError, match=reason):
    read(content)
