"""Mesh files of strangers: read right, or refused in one line, at a bounded price."""

import base64
import io
import json
import struct
import tracemalloc
import zipfile
import zlib

import numpy as np
import PIL.Image
import pytest

from cvn.errors import UserError
from cvn.grid import OBJECT_EXTENT
from datagen.geometry.mesh import albedo, normalize
from datagen.reading import headers, notes, read_mesh
from datagen.reading import parts as parts_lib
from datagen.reading.files import Files, archive_files, folder_files

POINTS = 'v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\n'
TEXTURED = 'mtllib a.mtl\n' + POINTS + 'usemtl m\nf 1/1 2/2 3/3\n'
PLY = """ply
format {format} 1.0
comment TextureFile {picture}
element vertex {vertices}
property float x
property float y
property float z
element face {faces}
property list uchar int vertex_indices
end_header
"""
PLY_BODY = '0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n'
RED = (255, 0, 0)


def png(color=RED, size=(8, 8)):
  stream = io.BytesIO()
  PIL.Image.new('RGB', size, color).save(stream, 'PNG')
  return stream.getvalue()


def ply(body=PLY_BODY, format='ascii', picture='a.png', vertices=3, faces=1):
  header = PLY.format(format=format, picture=picture, vertices=vertices, faces=faces).encode()
  return header + (body.encode() if isinstance(body, str) else body)


def gltf(uri=None, picture=None):
  """A glTF file of one triangle, its buffer within it unless `uri` names another file."""
  data = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32).tobytes()
  data += np.array([[0, 0], [1, 0], [0, 1]], np.float32).tobytes()
  uri = uri or 'data:application/octet-stream;base64,' + base64.b64encode(data).decode()
  view = {'buffer': 0, 'byteLength': 36}
  accessor = {'bufferView': 0, 'componentType': 5126, 'count': 3, 'type': 'VEC3'}
  primitive = {'attributes': {'POSITION': 0, 'TEXCOORD_0': 1}, 'material': 0}
  return json.dumps(
    {
      'asset': {'version': '2.0'},
      'scenes': [{'nodes': [0]}],
      'nodes': [{'mesh': 0}],
      'meshes': [{'primitives': [primitive]}],
      'materials': [
        {'pbrMetallicRoughness': {'baseColorTexture': {'index': 0}} if picture else {}}
      ],
      'textures': [{'source': 0}],
      'images': [{'uri': picture}] if picture else [],
      'accessors': [accessor, accessor | {'bufferView': 1, 'type': 'VEC2'}],
      'bufferViews': [view, view | {'byteOffset': 36, 'byteLength': 24}],
      'buffers': [{'uri': uri, 'byteLength': 60}],
    }
  )


def read(folder, name, content, **others):
  """Reads a file written into a folder, with others, whose names have `__` for the dot."""
  for file, data in {name: content, **others}.items():
    path = folder / file.replace('__', '.')
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
  return read_mesh(folder_files(str(folder)), name)


def color(mesh, face=0):
  return (255 * albedo(mesh, np.array([face]), np.full((1, 3), 1 / 3))[0]).round()[:3].tolist()


def refused(folder, name, content, reason=None, **others):
  with pytest.raises(UserError, match=reason) as e:
    read(folder, name, content, **others)
  assert name in str(e.value) and '\n' not in str(e.value)


OUTSIDE = ['../secret.png', '..\\secret.png', 'x/../../secret.png']
ELSEWHERE = [
  '/etc/passwd',
  '{folder}/../secret.png',
  'C:\\secret.png',
  '\\\\host\\share\\secret.png',
  'file:///etc/passwd',
  'http://a.b/secret.png',
]


@pytest.mark.parametrize('outside', OUTSIDE)
def test_files_outside_are_refused(tmp_path, outside):
  folder = tmp_path / 'in'
  folder.mkdir()
  (tmp_path / 'secret.png').write_bytes(png())
  reason = 'leads out of'
  refused(folder, 'a.obj', TEXTURED, reason, a__mtl=f'newmtl m\nmap_Kd {outside}\n')
  refused(folder, 'b.obj', TEXTURED.replace('a.mtl', outside), reason)
  refused(folder, 'a.ply', ply(picture=outside), reason)
  outside = outside.replace('\\', '/')
  refused(folder, 'a.gltf', gltf(uri=outside), reason)
  refused(folder, 'b.gltf', gltf(picture=outside), reason)
  refused(folder, 'c.gltf', gltf(picture=outside.replace('..', '%2e%2e')), reason)


@pytest.mark.parametrize('outside', ELSEWHERE)
@pytest.mark.parametrize('there', [False, True])
def test_of_paths_from_elsewhere_the_last_part_is_looked_for(tmp_path, outside, there):
  """Among the model's own files: what the path leads to is never read."""
  folder = tmp_path / 'in'
  folder.mkdir()
  (tmp_path / 'secret.png').write_bytes(b'secret')
  outside = outside.format(folder=folder)
  if there:
    (folder / 'textures').mkdir()
    (folder / 'textures' / outside.replace('\\', '/').split('/')[-1]).write_bytes(png())
  missing = () if there else (outside,)
  mtl = f'newmtl m\nKd 0 1 0\nmap_Kd {outside}\n'
  mesh = read(folder, 'a.obj', TEXTURED, a__mtl=mtl)
  assert mesh.missing == missing and color(mesh) == (list(RED) if there else [0, 255, 0])
  assert (notes.PICTURE_GUESSED in mesh.notes) == there
  assert read(folder, 'a.ply', ply(picture=outside)).missing == missing
  uri = outside.replace('\\', '/')
  assert read(folder, 'a.gltf', gltf(picture=uri)).missing == (() if there else (uri,))
  if not there:
    assert read(folder, 'b.obj', TEXTURED.replace('a.mtl', outside)).missing == (outside,)
    refused(folder, 'b.gltf', gltf(uri=uri), 'does not exist')


def test_missing_pictures_are_counted(tmp_path):
  mesh = read(tmp_path, 'a.obj', TEXTURED, a__mtl='newmtl m\nKd 0 1 0\nmap_Kd Gone.png\n')
  assert mesh.missing == ('Gone.png',) and color(mesh) == [0, 255, 0]
  assert read(tmp_path, 'b.obj', TEXTURED.replace('a.mtl', 'b.mtl')).missing == ('b.mtl',)
  assert read(tmp_path, 'a.ply', ply(picture='gone.png')).missing == ('gone.png',)
  assert read(tmp_path, 'a.gltf', gltf(picture='gone.png')).missing == ('gone.png',)
  refused(tmp_path, 'b.gltf', gltf(uri='gone.bin'), r'it names gone\.bin, which does not exist')


@pytest.mark.parametrize('picture', [b'', b'GIF rubbish', png()[:-30]])
def test_broken_pictures_are_refused(tmp_path, picture):
  mtl = 'newmtl m\nmap_Kd a.png\n'
  refused(tmp_path, 'a.obj', TEXTURED, None, a__mtl=mtl, a__png=picture)
  refused(tmp_path, 'a.gltf', gltf(picture='a.png'), None, a__png=picture)


def test_a_picture_of_many_pixels_is_refused_unread(tmp_path):
  mtl = 'newmtl m\nmap_Kd a.png\n'
  chunk = b'IHDR' + struct.pack('>IIBBBBB', 12000, 12000, 8, 2, 0, 0, 0)
  picture = b'\x89PNG\r\n\x1a\n' + struct.pack('>I', 13) + chunk
  picture += struct.pack('>II4s', zlib.crc32(chunk), 0, b'IDAT')
  refused(tmp_path, 'a.obj', TEXTURED, '12000 x 12000', a__mtl=mtl, a__png=picture)


def test_one_picture_of_many_materials_is_one_texture(tmp_path, monkeypatch):
  mtl = 'newmtl m\nmap_Kd a.png\nnewmtl n\nmap_Kd ./a.png\nnewmtl o\nmap_Kd b.png\n'
  faces = TEXTURED + 'v 0 0 1\nusemtl n\nf 1/1 2/2 4/3\nusemtl o\nf 1/1 3/2 4/3\n'
  files = {'a__mtl': mtl, 'a__png': png(), 'b__png': png((0, 0, 255))}
  mesh = read(tmp_path, 'a.obj', faces, **files)
  assert len(mesh.textures) == 2
  monkeypatch.setattr(parts_lib, 'MAX_TEXTURES', 300)
  refused(tmp_path, 'a.obj', faces, 'its textures take more', **files)


def test_texts_in_latin_1(tmp_path):
  (tmp_path / 'grün.png').write_bytes(png())
  mtl = '# Stühle\nnewmtl Grün\nmap_Kd grün.png\n'.encode('latin-1')
  obj = '# Stühle\n' + TEXTURED.replace('usemtl m', 'usemtl Grün')
  mesh = read(tmp_path, 'a.obj', obj.encode('latin-1'), a__mtl=mtl)
  assert color(mesh) == list(RED) and not mesh.missing
  read(tmp_path, 'a.off', '# Stühle\nOFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n'.encode('latin-1'))
  read(tmp_path, 'a.ply', ply(picture='grün.png').decode().encode('latin-1'))


def test_names_are_uris_in_gltf(tmp_path):
  (tmp_path / 'my picture.png').write_bytes(png())
  mesh = read(tmp_path, 'a.gltf', gltf(picture='my%20picture.png'))
  assert color(mesh) == list(RED)


def test_mtl_by_another_name(tmp_path):
  obj = TEXTURED.replace('a.mtl', 'a.txt')
  mesh = read(tmp_path, 'a.obj', obj, a__txt='newmtl m\nmap_Kd a.png\n', a__png=png())
  assert color(mesh) == list(RED)


def test_archives(tmp_path):
  path = str(tmp_path / 'a.zip')
  with zipfile.ZipFile(path, 'w') as z:
    z.writestr('x/a.obj', TEXTURED)
    z.writestr('x/a.mtl', 'newmtl m\nmap_Kd ..\\Images\\A.PNG\n')
    z.writestr('images/a.png', png())
    z.writestr('x/b.obj', TEXTURED.replace('a.mtl', '../../b.mtl'))
  with archive_files(path) as files:
    assert color(read_mesh(files, 'x/a.obj')) == list(RED)
    with pytest.raises(UserError, match='leads out of'):
      read_mesh(files, 'x/b.obj')
    with pytest.raises(UserError, match=r'has no file x/c\.obj'):
      read_mesh(files, 'x/c.obj')


def test_polygons_and_relative_indices(tmp_path):
  angles = np.linspace(0, 2 * np.pi, 1000, endpoint=False)
  points = ''.join(
    f'v {x:.9f} {y:.9f} 0\n' for x, y in zip(np.cos(angles), np.sin(angles), strict=True)
  )
  for face in (range(1, 1001), range(-1000, 0)):
    mesh = read(
      tmp_path, 'a.obj', POINTS + points + 'f ' + ' '.join(str(i + 3 * (i > 0)) for i in face)
    )
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
    np.testing.assert_allclose(area, np.pi, rtol=1e-4)


@pytest.mark.parametrize('face', ['1 2 4', '1 2 99999999999999999999', '0 1 2', '-4 1 2'])
def test_obj_faces_of_vertices_that_are_not_there(tmp_path, face):
  refused(tmp_path, 'a.obj', POINTS + f'f {face}\n')


def test_other_faces_of_vertices_that_are_not_there(tmp_path):
  for index in ('-1', '3', '2147483647'):
    refused(tmp_path, 'a.ply', ply(PLY_BODY.replace('0 1 2', f'0 1 {index}')))
    refused(tmp_path, 'a.off', f'OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 {index}\n')


BILLION = 10**9
DECLARED = {
  'a.ply': ply(vertices=BILLION, faces=BILLION),
  'b.ply': ply(bytes(60), format='binary_little_endian', vertices=BILLION, faces=BILLION),
  'c.ply': ply(bytes(36) + b'\xff' + bytes(12), format='binary_little_endian'),
  'a.off': b'OFF\n1000000000 1000000000 0\n0 0 0\n',
  'b.off': b'OFF\n-1 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n',
  'a.stl': bytes(80) + struct.pack('<I', BILLION) + bytes(50),
  'a.gltf': gltf().replace('"count": 3', '"count": 1000000000').encode(),
  'b.gltf': gltf().replace('"count": 3', '"count": 10000000').encode(),
  'c.gltf': gltf().replace('"byteLength": 36', '"byteLength": 1000000000').encode(),
  'a.glb': struct.pack('<4sIIII', b'glTF', 2, 2**32 - 1, 2**32 - 1, 0x4E4F534A) + b'{}',
}


@pytest.mark.parametrize('name', DECLARED)
def test_what_is_declared_and_not_there_takes_no_memory(tmp_path, name):
  tracemalloc.start()
  try:
    refused(tmp_path, name, DECLARED[name])
    assert tracemalloc.get_traced_memory()[1] < 16 * 2**20
  finally:
    tracemalloc.stop()


def test_edges_of_ply_take_no_memory(tmp_path):
  """An edge that names vertex 10^9 made trimesh count up to it."""
  content = ply(PLY_BODY + '0 1000000000\n').replace(
    b'end_header', b'element edge 1\nproperty int vertex1\nproperty int vertex2\nend_header'
  )
  assert len(read(tmp_path, 'a.ply', content).faces) == 1


def test_scenes_without_end_or_of_too_many_faces(tmp_path, monkeypatch):
  refused(
    tmp_path, 'a.gltf', gltf().replace('{"mesh": 0}', '{"mesh": 0, "children": [0]}'), 'no end'
  )
  monkeypatch.setattr(headers, 'MAX_FACES', 1)
  refused(tmp_path, 'a.obj', POINTS + 'f 1 2 3\nf 3 2 1\n', '2 faces, more than 1')


def test_json_nested_too_deeply(tmp_path):
  refused(tmp_path, 'a.gltf', '[' * 100_000, 'RecursionError')


@pytest.mark.parametrize('bad', ['nan', 'inf', '-inf', '1e999', '1e200', '-1e308'])
def test_coordinates_that_are_none(tmp_path, bad):
  refused(tmp_path, 'a.obj', POINTS.replace('v 1 0 0', f'v {bad} 0 0') + 'f 1 2 3\n', 'coordinates')
  # Of a point that no face uses it matters nothing.
  mesh = read(tmp_path, 'a.obj', POINTS + f'v {bad} 0 0\nf 1 2 3\n')
  assert np.isfinite(normalize(mesh).vertices).all()


@pytest.mark.parametrize('size', ['1e-30', '1e30', '1e90'])
def test_sizes_beyond_measure(tmp_path, size):
  mesh = normalize(read(tmp_path, 'a.obj', POINTS.replace('1', size) + 'f 1 2 3\n'))
  used = mesh.vertices[mesh.faces[0]]
  np.testing.assert_allclose(np.ptp(used, axis=0)[:2], OBJECT_EXTENT)


def test_faces_without_area(tmp_path):
  assert len(read(tmp_path, 'a.obj', POINTS + 'f 1 1 2\nf 1 2 3\nf 2 2 2\n').faces) == 1
  refused(tmp_path, 'a.obj', POINTS + 'f 1 1 2\nf 2 2 2\n', 'no faces')
  refused(tmp_path, 'a.obj', POINTS.replace('1', '1e-300') + 'f 1 2 3\n', 'no faces')


@pytest.mark.parametrize('bad', ['nan', 'inf', '1e300', '-1e300', '1e38'])
def test_texture_coordinates_that_are_none(tmp_path, bad):
  obj = TEXTURED.replace('vt 1 0', f'vt {bad} 0')
  mesh = read(tmp_path, 'a.obj', obj, a__mtl='newmtl m\nmap_Kd a.png\n', a__png=png())
  assert np.isfinite(mesh.corner_uv).all() and color(mesh) == list(RED)


def test_want_of_memory_is_no_fault_of_the_file():
  def too_much(_):
    raise MemoryError

  files = Files('somewhere', names=list, read=too_much, alike=lambda _: None)
  with pytest.raises(MemoryError):
    read_mesh(files, 'a.obj')
