"""PLY files of every kind: text and binary, with all sorts of properties."""

import io
import struct

import numpy as np
import PIL.Image
import pytest

from cvn.errors import UserError
from datagen.reading import notes, read_mesh
from datagen.reading.files import folder_files

ROWS = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]


def header(form, *elements, comments=()):
  lines = ['ply', f'format {form} 1.0', *(f'comment {c}' for c in comments)]
  for name, count, *properties in elements:
    lines += [f'element {name} {count}', *(f'property {p}' for p in properties)]
  return ('\n'.join([*lines, 'end_header']) + '\n').encode()


def text(rows):
  return '\n'.join(' '.join(map(str, row)) for row in rows).encode() + b'\n'


def read(folder, content, **others):
  (folder / 'a.ply').write_bytes(content)
  for name, data in others.items():
    (folder / name.replace('__', '.')).write_bytes(data)
  return read_mesh(folder_files(str(folder)), 'a.ply')


def png(color):
  stream = io.BytesIO()
  PIL.Image.new('RGB', (4, 4), color).save(stream, 'PNG')
  return stream.getvalue()


XYZ = ('float x', 'float y', 'float z')
FACE = ('face', 1, 'list uchar int vertex_indices')
QUAD = [(4, 0, 1, 2, 3)]


@pytest.mark.parametrize('order', ['<', '>'])
def test_binary_faces_of_several_lengths(tmp_path, order):
  form = 'binary_little_endian' if order == '<' else 'binary_big_endian'
  faces = ('face', 3, 'uchar flags', 'list uchar int vertex_index', 'list uchar float weights')
  body = b''.join(struct.pack(order + 'fff', *row) for row in ROWS)
  body += struct.pack(order + 'BB3iB', 9, 3, 0, 1, 2, 0)
  body += struct.pack(order + 'BB4iBff', 9, 4, 0, 1, 2, 3, 2, 0.5, 0.5)
  body += struct.pack(order + 'BB2iB', 9, 2, 0, 1, 0)
  mesh = read(tmp_path, header(form, ('vertex', 4, *XYZ), faces) + body)
  assert mesh.faces.tolist() == [[0, 1, 2], [0, 1, 2], [0, 2, 3]]
  with pytest.raises(UserError, match='holds fewer'):
    read(tmp_path, header(form, ('vertex', 4, *XYZ), faces) + body[:-1])


def test_text_faces_of_several_lengths(tmp_path):
  faces = ('face', 3, 'list uchar int vertex_indices', 'uchar flags')
  content = header('ascii', ('vertex', 4, *XYZ), faces) + text(ROWS)
  mesh = read(tmp_path, content + b'3 0 1 2 9 4 0 1\n2 3 9 2 0 1 9')
  assert mesh.faces.tolist() == [[0, 1, 2], [0, 1, 2], [0, 2, 3]]
  with pytest.raises(UserError, match='holds fewer'):
    read(tmp_path, content + b'3 0 1 2 9 4 0 1\n2 3 9 2 0 1')
  with pytest.raises(UserError, match='not a number'):
    read(tmp_path, content + b'3 0 1 x 9 4 0 1\n2 3 9 2 0 1 9')


@pytest.mark.parametrize(
  ('names', 'kind', 'color', 'guessed'),
  [
    ('red green blue', 'uchar', (255, 51, 0), False),
    ('r g b', 'uchar', (255, 51, 0), False),
    ('diffuse_red diffuse_green diffuse_blue', 'uchar', (255, 51, 0), False),
    ('red green blue', 'ushort', (65535, 13107, 0), False),
    ('red green blue', 'ushort', (255, 51, 0), True),
    ('red green blue', 'float', (1, 0.2, 0), False),
    ('red green blue', 'double', (255, 51, 0), True),
    ('red green blue', 'int', (255, 51, 0), True),
  ],
)
@pytest.mark.parametrize('alpha', [False, True])
def test_colors(tmp_path, names, kind, color, guessed, alpha):
  """Alpha has no say: nothing tells what it is for."""
  properties = [f'{kind} {name}' for name in [*names.split(), *['alpha'] * alpha]]
  rows = [(*row, *color, *[0] * alpha) for row in ROWS]
  for where in ('vertex', 'face'):
    vertex = ('vertex', 4, *XYZ, *(properties if where == 'vertex' else []))
    face = (*FACE, *(properties if where == 'face' else []))
    body = text(rows if where == 'vertex' else ROWS)
    body += text(QUAD if where == 'vertex' else [(*QUAD[0], *color, *[0] * alpha)])
    mesh = read(tmp_path, header('ascii', vertex, face) + body)
    np.testing.assert_allclose(mesh.corner_colors[0, 0], [1, 0.2, 0, 1], atol=1e-3)
    assert (notes.COLOR_RANGE_GUESSED in mesh.notes) == guessed


def test_vertex_colors_go_before_face_colors_unless_they_are_one_color(tmp_path):
  rgb = ('uchar red', 'uchar green', 'uchar blue')
  head = header('ascii', ('vertex', 4, *XYZ, *rgb), ('face', 2, FACE[2], *rgb))
  faces = [(3, 0, 1, 2, 255, 0, 0), (3, 0, 2, 3, 0, 255, 0)]
  varied = [(*row, 0, 0, 255 * (n % 2)) for n, row in enumerate(ROWS)]
  mesh = read(tmp_path, head + text(varied) + text(faces))
  assert mesh.corner_colors[0, :, 2].tolist() == [0, 1, 0]
  mesh = read(tmp_path, head + text([(*row, 255, 255, 255) for row in ROWS]) + text(faces))
  assert mesh.corner_colors[:, 0, :3].tolist() == [[1, 0, 0], [0, 1, 0]]
  assert mesh.notes == (notes.COLORS_IGNORED,)


def test_strips_with_breaks(tmp_path):
  strips = ('tristrips', 1, 'list int int vertex_indices')
  body = b''.join(struct.pack('<fff', *row) for row in ROWS)
  body += struct.pack('<i8i', 8, 0, 1, 3, 2, -1, 3, 1, 0)
  mesh = read(tmp_path, header('binary_little_endian', ('vertex', 4, *XYZ), strips) + body)
  assert mesh.faces.tolist() == [[0, 1, 3], [3, 1, 2], [3, 1, 0]]


def test_several_pictures_and_their_numbers(tmp_path):
  faces = ('face', 3, FACE[2], 'list uchar float texcoord', 'int texnumber')
  comments = ('TextureFile a.png', 'TextureFile b.png')
  rows = [(3, 0, 1, 2, 6, 0, 0, 1, 0, 1, 1, n) for n in (0, 1, 7)]
  content = header('ascii', ('vertex', 4, *XYZ), faces, comments=comments) + text(ROWS) + text(rows)
  mesh = read(tmp_path, content, a__png=png((255, 0, 0)), b__png=png((0, 255, 0)))
  assert mesh.texture.tolist() == [0, 1, -1]
  assert mesh.corner_uv[0].tolist() == [[0, 0], [1, 0], [1, 1]]


@pytest.mark.parametrize('names', ['u v', 's t', 'texture_u texture_v'])
def test_coordinates_of_vertices(tmp_path, names):
  vertex = ('vertex', 4, *XYZ, *(f'float {name}' for name in names.split()))
  rows = [(*row, *row[:2]) for row in ROWS]
  content = header('ascii', vertex, FACE, comments=['TextureFile a.png']) + text(rows) + text(QUAD)
  mesh = read(tmp_path, content, a__png=png((255, 0, 0)))
  assert mesh.corner_uv[0].tolist() == [[0, 0], [1, 0], [1, 1]]


@pytest.mark.parametrize(
  ('content', 'reason'),
  [
    (b'ply\nformat ascii 1.0\n', 'no header'),
    (b'off\nend_header\n', 'no header'),
    (b'ply\nend_header\n', 'does not state its format'),
    (header('ascii', FACE) + text(QUAD), 'no vertices'),
    (header('ascii', ('vertex', 4, *XYZ)) + text(ROWS), 'cloud of points'),
    (header('ascii', ('vertex', -4, *XYZ)), 'declares -4'),
    (header('ascii', ('vertex', 4), FACE) + text(QUAD), 'no properties'),
  ],
)
def test_what_is_refused(tmp_path, content, reason):
  with pytest.raises(UserError, match=reason):
    read(tmp_path, content)
