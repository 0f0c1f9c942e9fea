"""OBJ files as programs write them."""

import io

import numpy as np
import PIL.Image
import pytest

from cvn.errors import UserError
from datagen.geometry.mesh import NO_COLOR
from datagen.reading import notes, obj, read_mesh
from datagen.reading.files import folder_files

POINTS = b'v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nvn 0 0 1\n'
GREY = [NO_COLOR] * 3


def read(folder, content, **others):
  for name, data in {'a.obj': content, **others}.items():
    path = folder / name.replace('__', '.')
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
  return read_mesh(folder_files(str(folder)), 'a.obj')


def png(color=(255, 0, 0)):
  stream = io.BytesIO()
  PIL.Image.new('RGB', (4, 4), color).save(stream, 'PNG')
  return stream.getvalue()


def faces(folder, content):
  return read(folder, content).faces.tolist()


def colors(mesh):
  """Of each face's first corner."""
  return np.round(mesh.corner_colors[:, 0, :3].astype(float), 3).tolist()


def test_indices_count_back_from_the_face(tmp_path):
  content = POINTS + b'f -3 -2 -1\n' + POINTS.replace(b'1', b'2') + b'f -3 -2 -1\nf 1 -5 6\n'
  assert faces(tmp_path, content) == [[0, 1, 2], [3, 4, 5], [0, 1, 5]]


@pytest.mark.parametrize('piece', [1, 30, 1 << 22])
def test_corners_of_every_form(tmp_path, monkeypatch, piece):
  monkeypatch.setattr(obj, 'PIECE', piece)
  content = POINTS + (
    b'v 1 1 1\nf -4/-3/-1 -3//-1 4/-1\nf 1/1/1 2/2/1 3/3/1\n\tf\t1//1 2//1\t3//1 # no\r\n'
    b'f 1/1 2/2 3/3\nf 1/ 2/ 3/\nf 1/1/ 2/2/ 3/3/\nf 1 2 \\\n4\nf 1/1 2 3//1\nf 1 2'
  )
  expected = [[0, 1, 3], *[[0, 1, 2]] * 5, [0, 1, 3], [0, 1, 2]]
  assert faces(tmp_path, content) == expected


@pytest.mark.parametrize('face', ['0 1 2', '-4 1 2', '1//0 2//0 0//0', '1 2 4', '1/1 2/2 9/3'])
def test_vertices_that_are_not_there(tmp_path, face):
  with pytest.raises(UserError, match=r'names a vertex that (does not exist|is out of bounds)'):
    read(tmp_path, POINTS + f'f {face}'.encode())


@pytest.mark.parametrize(
  ('line', 'reason'),
  [
    (b'f -x 1 2', 'not a corner'),
    (b'f 1 2 x', 'not a corner'),
    (b'v 0,5 0,7 0,3', "'v 0,5 0,7 0,3' is not a line of numbers"),
    (b'v 0 0', 'too few'),
    (b'vt x', 'not a line of numbers'),
  ],
)
def test_words_for_numbers(tmp_path, line, reason):
  with pytest.raises(UserError, match=reason):
    read(tmp_path, POINTS + line + b'\nf 1 2 3\n')


def test_faces_keep_their_order_whatever_their_form(tmp_path):
  content = POINTS + b'v 1 1 0\nf 1 2 3\nf 1/1 2/2 4/3\nf 1 2 4 3\nf 2 3 4\n'
  expected = [[0, 1, 2], [0, 1, 3], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
  assert faces(tmp_path, content) == expected


@pytest.mark.parametrize(
  ('rows', 'expected'),
  [
    (['1 0 0.5', '1 0 0.5', '1 0 0.5'], [1, 0, 0.5]),
    (['255 0 51', '255 0 51', '255 0 51'], [1, 0, 0.2]),
    (['255 0 51 255'] * 3, [1, 0, 0.2]),
    (['1 0 0.5', '', ''], [1, 0, 0.5]),  # the others take its colour
    (['0 0 0'] * 3, [0, 0, 0]),
    (['1 1 1'] * 3, GREY),
    (['0.5'] * 3, GREY),  # a weight
    ([''] * 3, GREY),
  ],
)
def test_vertex_colors(tmp_path, rows, expected):
  lines = [f'v {p} {row}' for p, row in zip(('0 0 0', '1 0 0', '0 1 0'), rows, strict=True)]
  mesh = read(tmp_path, '\n'.join([*lines, 'f 1 2 3']))
  np.testing.assert_allclose(mesh.corner_colors[0, :, :3], [expected] * 3, atol=1e-3)
  # Beside a material they stand alone; white ones leave it to the material.
  mesh = read(tmp_path, '\n'.join(['mtllib a.mtl', *lines, 'f 1 2 3']), a__mtl='newmtl m\nKd 0 1 0')
  beside = [0, 1, 0] if expected == GREY else expected
  np.testing.assert_allclose(mesh.corner_colors[0, :, :3], [beside] * 3, atol=1e-3)


def test_faces_of_vertices_without_color_among_others_take_the_material(tmp_path):
  content = 'mtllib a.mtl\nusemtl m\n' + ''.join(
    f'v {x} {y} 0 {color}\n' for color in ('1 0 0', '') for x, y in ((0, 0), (1, 0), (0, 1))
  )
  mesh = read(tmp_path, content + 'f 1 2 3\nf 4 5 6\n', a__mtl='newmtl m\nKd 0 1 0\n')
  assert colors(mesh) == [[1, 0, 0], [0, 1, 0]]


LIBRARIES = {'one__mtl': 'newmtl a\nKd 1 0 0\n', 'two__mtl': 'newmtl b\nKd 0 1 0\n'}
TWO = POINTS + b'usemtl a\nf 1 2 3\nusemtl b\nf 3 2 1\n'


@pytest.mark.parametrize(
  'lines',
  [
    b'mtllib one.mtl\nmtllib two.mtl\n',
    b'mtllib one.mtl two.mtl\n',
    b'\tmtllib  "one.mtl"\ttwo.mtl\r\n',
  ],
)
def test_several_libraries(tmp_path, lines):
  for content in (lines + TWO, TWO + lines):
    mesh = read(tmp_path, content, **LIBRARIES)
    assert colors(mesh) == [[1, 0, 0], [0, 1, 0]] and not mesh.missing


def test_materials_that_are_nowhere_are_missing(tmp_path):
  mesh = read(tmp_path, b'mtllib one.mtl\n' + TWO + b'usemtl unused\n', **LIBRARIES)
  assert colors(mesh) == [[1, 0, 0], GREY] and mesh.missing == ('material b',)
  (tmp_path / 'b').mkdir()
  assert read(tmp_path / 'b', TWO).missing == ('material a', 'material b')
  # Where a whole file is missing, nothing is known of what it held.
  assert read(tmp_path, b'mtllib three.mtl\n' + TWO, **LIBRARIES).missing == ('three.mtl',)


def test_a_library_of_the_mesh_s_own_name(tmp_path):
  mtl = 'newmtl a\nKd 1 0 0\nnewmtl b\nKd 0 1 0\n'
  mesh = read(tmp_path, b'mtllib old.mtl\n' + TWO, a__mtl=mtl)
  assert colors(mesh) == [[1, 0, 0], [0, 1, 0]]
  assert mesh.missing == ('old.mtl',) and mesh.notes == (notes.MATERIAL_GUESSED,)


def test_pictures_beside_the_library(tmp_path):
  (tmp_path / 'mtl').mkdir()
  (tmp_path / 'mtl' / 'a.png').write_bytes(png())
  (tmp_path / 'mtl' / 'b.mtl').write_text('newmtl m\nmap_Kd a.png\n')
  mesh = read(tmp_path, b'mtllib mtl/b.mtl\n' + POINTS + b'usemtl m\nf 1/1 2/2 3/3\n')
  assert len(mesh.textures) == 1 and not mesh.missing and not mesh.notes


def test_texture_options(tmp_path):
  mtl = 'newmtl m\nmap_Kd -s 2 3 -o 0.5 0.25 -clamp on a.png\n'
  content = b'mtllib a.mtl\n' + POINTS + b'usemtl m\nf 1/1 2/2 3/3\n'
  mesh = read(tmp_path, content, a__mtl=mtl, a__png=png())
  assert mesh.corner_uv[0].tolist() == [[0.5, 0.25], [2.5, 0.25], [0.5, 3.25]]
  assert mesh.wraps == (('clamp', 'clamp'),)


def test_faces_without_coordinates_among_others(tmp_path):
  content = b'mtllib a.mtl\n' + POINTS + b'usemtl m\n'
  content += b'f 1/1 2/2 3/3\nf 3 2 1\nf 3/1 2 1\nf 1/1 2/2 3/9\n'
  mesh = read(tmp_path, content, a__mtl='newmtl m\nmap_Kd a.png\n', a__png=png((255, 0, 51)))
  assert mesh.texture.tolist() == [0, -1, -1, -1] and mesh.notes == (notes.BAD_COORDINATES,)
  np.testing.assert_allclose(colors(mesh)[1], [1, 0, 0.2], atol=1e-3)


@pytest.mark.parametrize('encoding', ['utf-8-sig', 'utf-16', 'latin-1'])
@pytest.mark.parametrize('end', ['\n', '\r\n', '\r'])
def test_encodings_and_line_ends(tmp_path, encoding, end):
  content = f'mtllib a.mtl\n{POINTS.decode()}usemtl Grün\nf 1/1 2/2 3/3\n'.replace('\n', end)
  mtl = 'newmtl Grün\nKd 0 1 0\n'.replace('\n', end)
  mesh = read(tmp_path, content.encode(encoding), a__mtl=mtl.encode(encoding))
  assert colors(mesh) == [[0, 1, 0]] and not mesh.missing


def test_a_broken_utf_16_file_says_so(tmp_path):
  with pytest.raises(UserError, match='UTF-16'):
    read(tmp_path, POINTS.decode().encode('utf-16')[:-1])
