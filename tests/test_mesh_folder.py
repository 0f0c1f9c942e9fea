"""The folder source on miniature files of every format, with known colours at known places."""

import json
import os
import pickle

import numpy as np
import PIL.Image
import pytest
import trimesh
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from cvn.errors import UserError
from datagen.geometry.mesh import NO_COLOR, albedo
from datagen.sources import SOURCES, SourceModel, mesh_folder, source

QUAD_OBJ = """mtllib {mtl}
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
vt 0 0
vt 1 0
vt 1 1
vt 0 1
usemtl {material}
f 1/1 2/2 3/3
f 1/1 3/3 4/4
"""
QUAD = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
QUAD_FACES = np.array([[0, 1, 2], [0, 2, 3]])
RED, GREEN, BLUE, WHITE = [255, 0, 0], [0, 255, 0], [0, 0, 255], [255, 255, 255]


def picture():
  """Red and green above blue and white."""
  pixels = np.array([[RED, GREEN], [BLUE, WHITE]], np.uint8)
  return PIL.Image.fromarray(np.repeat(np.repeat(pixels, 8, 0), 8, 1))


def load(path, folder=None):
  """Loads a file, of which `folder` is the input folder; its own where that is not given."""
  detail = str(folder or path.parent)
  return mesh_folder.load(SourceModel(id='it', category='chair', path=str(path), detail=detail))


def color_at(mesh, point):
  """Albedo, 0..255, of the face's centre or corner nearest to a point."""
  corners = mesh.vertices[mesh.faces]
  weights = np.array([[1, 1, 1], [4, 1, 1], [1, 4, 1], [1, 1, 4]]) / [[3], [6], [6], [6]]
  places = np.einsum('wk,fkc->fwc', weights, corners)
  face, w = np.unravel_index(np.linalg.norm(places - point, axis=-1).argmin(), places.shape[:2])
  return 255 * albedo(mesh, np.array([face]), weights[[w]])[0]


def assert_color(mesh, point, expected, atol=0.6):
  np.testing.assert_allclose(color_at(mesh, point)[: len(expected)], expected, atol=atol)


def assert_picture(mesh):
  assert_color(mesh, [0.8, 0.2, 0], WHITE)
  assert_color(mesh, [0.2, 0.8, 0], RED)
  assert_color(mesh, [0.9, 0.8, 0], GREEN)
  assert_color(mesh, [0.1, 0.1, 0], BLUE)


def write_obj(folder, mtl, *, name='quad.obj', mtl_name='quad.mtl', material='wood'):
  (folder / mtl_name).write_text(mtl)
  (folder / name).write_text(QUAD_OBJ.format(mtl=mtl_name, material=material))
  return folder / name


def test_obj_with_texture(tmp_path):
  picture().save(tmp_path / 'a.png')
  assert_picture(load(write_obj(tmp_path, 'newmtl wood\nKd 0.5 0.2 0.1\nmap_Kd a.png\n')))


def test_obj_with_odd_names(tmp_path):
  """Spaces, folders beside the mesh's, backslashes, other cases, options before the name."""
  (tmp_path / 'Models').mkdir()
  (tmp_path / 'images').mkdir()
  picture().save(tmp_path / 'images' / 'größe 1.png')
  for reference in (
    '../images/größe 1.png',
    '..\\images\\größe 1.png',
    '-s 1 1 1 -clamp on ../images/Größe 1.PNG',
  ):
    mtl = f'newmtl fine wood\nmap_Kd {reference}\n'
    path = write_obj(
      tmp_path / 'Models', mtl, name='Stühle.OBJ', mtl_name='my chair.mtl', material='fine wood'
    )
    assert_picture(load(path, tmp_path))


def test_obj_repeats_its_texture(tmp_path):
  picture().save(tmp_path / 'a.png')
  path = write_obj(tmp_path, 'newmtl wood\nmap_Kd a.png\n')
  path.write_text(path.read_text().replace('vt 1', 'vt 6').replace('vt 0', 'vt 5'))
  path.write_text(path.read_text().replace('vt 6 1', 'vt 6 -3').replace('vt 5 1', 'vt 5 -3'))
  path.write_text(path.read_text().replace('vt 6 0', 'vt 6 -4').replace('vt 5 0', 'vt 5 -4'))
  assert_picture(load(path))


def test_obj_with_several_materials_and_glass(tmp_path):
  mtl = 'newmtl a\nKd 1 0.2 0\nd 1\nnewmtl b\nKd 0.4 0.6 0.8\nd 0.2\n'
  path = write_obj(tmp_path, mtl, material='a')
  path.write_text(path.read_text().replace('f 1/1 3/3', 'usemtl b\nf 1/1 3/3'))
  mesh = load(path)
  assert_color(mesh, [0.7, 0.3, 0], [255, 51, 0, 255])
  assert_color(mesh, [0.3, 0.7, 0], [102, 153, 204, 51])


def test_obj_without_its_mtl_or_texture(tmp_path):
  path = write_obj(tmp_path, 'newmtl wood\nKd 0.4 0.6 0.8\nmap_Kd gone.png\n')
  assert_color(load(path), [0.3, 0.7, 0], [102, 153, 204])
  os.remove(tmp_path / 'quad.mtl')
  assert_color(load(path), [0.3, 0.7, 0], [NO_COLOR * 255] * 3)


def test_obj_with_vertex_colors(tmp_path):
  lines = [f'v {x} {y} 0 {x} {y} 0.2' for x, y, _ in QUAD]
  (tmp_path / 'a.obj').write_text('\n'.join([*lines, 'f 1 2 3', 'f 1 3 4']))
  assert_color(load(tmp_path / 'a.obj'), [2 / 3, 1 / 3, 0], [170, 85, 51])


@pytest.mark.parametrize('extension', ['glb', 'gltf'])
def test_gltf_with_texture_factor_and_transform(tmp_path, extension):
  material = PBRMaterial(baseColorTexture=picture())
  mesh = trimesh.Trimesh(QUAD, QUAD_FACES, visual=TextureVisuals(uv=QUAD[:, :2], material=material))
  plain = PBRMaterial(baseColorFactor=[0.2159, 0.0, 1.0, 1.0])  # linear: 128, 0, 255
  other = trimesh.Trimesh(QUAD, QUAD_FACES, visual=TextureVisuals(material=plain))
  scene = trimesh.Scene([mesh])
  scene.add_geometry(other, transform=trimesh.transformations.translation_matrix([0, 0, 5]))
  path = tmp_path / f'a.{extension}'
  if extension == 'glb':
    path.write_bytes(scene.export(file_type='glb'))
  else:
    for name, data in trimesh.exchange.gltf.export_gltf(scene).items():
      (tmp_path / name.replace('model.gltf', 'a.gltf')).write_bytes(data)
  mesh = load(path)
  assert_picture(mesh)
  assert_color(mesh, [0.3, 0.7, 5], [128, 0, 255, 255], atol=1.5)
  assert mesh.vertices.max() == 5


def test_glb_with_vertex_colors(tmp_path):
  colors = np.array([[55, 55, 55, 255]] * 4, np.uint8)  # linear 55 / 255 is sRGB 128
  mesh = trimesh.Trimesh(QUAD, QUAD_FACES, vertex_colors=colors)
  (tmp_path / 'a.glb').write_bytes(mesh.export(file_type='glb'))
  assert_color(load(tmp_path / 'a.glb'), [0.3, 0.7, 0], [128, 128, 128], atol=1)


def test_packed_gltf_says_so(tmp_path):
  path = tmp_path / 'a.gltf'
  header = {'asset': {'version': '2.0'}, 'extensionsRequired': ['KHR_draco_mesh_compression']}
  path.write_text(json.dumps(header | {'scene': 0, 'scenes': [{'nodes': []}], 'nodes': []}))
  with pytest.raises(UserError, match=r'a\.gltf.*KHR_draco_mesh_compression'):
    load(path)


@pytest.mark.parametrize('encoding', ['ascii', 'binary'])
def test_ply_with_vertex_or_face_colors(tmp_path, encoding):
  colors = np.array([[*RED, 255], [*RED, 255], [*RED, 255], [*BLUE, 255]])
  mesh = trimesh.Trimesh(QUAD, QUAD_FACES, vertex_colors=colors)
  (tmp_path / 'a.ply').write_bytes(mesh.export(file_type='ply', encoding=encoding))
  assert_color(load(tmp_path / 'a.ply'), [0.7, 0.3, 0], RED)
  assert_color(load(tmp_path / 'a.ply'), [1 / 3, 2 / 3, 0], [170, 0, 85])
  mesh = trimesh.Trimesh(QUAD, QUAD_FACES, face_colors=colors[2:])
  (tmp_path / 'b.ply').write_bytes(mesh.export(file_type='ply', encoding=encoding))
  assert_color(load(tmp_path / 'b.ply'), [0.7, 0.3, 0], RED)
  assert_color(load(tmp_path / 'b.ply'), [0.3, 0.7, 0], BLUE)


@pytest.mark.parametrize(
  ('up', 'top'), [('Y_UP', [0.2, 0.8, 0]), ('Z_UP', [0.2, 0, -0.8]), ('X_UP', [-0.8, 0.2, 0])]
)
def test_dae_with_texture_and_its_up_axis(tmp_path, up, top):
  """The image's upper left corner, red, is at (0.2, 0.8, 0) of the file's own axes."""
  picture().save(tmp_path / 'a.png')
  (tmp_path / 'a.dae').write_text(DAE.replace('Y_UP', up))
  mesh = load(tmp_path / 'a.dae')
  assert_color(mesh, top, RED)


def test_off_and_stl_are_grey(tmp_path):
  mesh = trimesh.Trimesh(QUAD, QUAD_FACES)
  for extension in ('off', 'stl'):
    path = tmp_path / f'a.{extension}'
    data = mesh.export(file_type=extension)
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
    assert_color(load(path), [0.3, 0.7, 0], [NO_COLOR * 255] * 3)


@pytest.mark.parametrize(
  ('name', 'content', 'reason'),
  [
    ('a.obj', b'', 'no faces'),
    ('a.obj', b'v 0 0 0\nv 1 0 0\nv 0 1 0\n', 'no faces'),
    ('a.obj', b'v 0 0 0\nv 1 nan 0\nv 0 1 0\nf 1 2 3\n', 'not finite'),
    ('a.obj', b'v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 7\n', 'out of bounds'),
    ('a.obj', b'v 1 1 1\nv 1 1 1\nv 1 1 1\nf 1 2 3\n', 'no faces'),
    ('a.obj', b'\x00\xff\xfe rubbish \x80', 'a.obj'),
    ('a.glb', b'glTF rubbish', 'cannot be read as GLB'),
    ('a.gltf', b'{"asset": {', 'cannot be read as GLTF'),
    ('a.ply', b'ply\nformat ascii 1.0\nelement vertex 3\n', 'a.ply'),
    ('a.dae', b'<html></html>', 'not a COLLADA document'),
    ('a.off', b'OFF\n3 1 0\n0 0 0\n', 'holds fewer'),
    ('a.stl', b'solid', 'a.stl'),
  ],
)
def test_broken_files_are_user_errors_that_name_the_file(tmp_path, capfd, name, content, reason):
  (tmp_path / name).write_bytes(content)
  with pytest.raises(UserError, match=reason) as e:
    load(tmp_path / name)
  assert name in str(e.value) and '\n' not in str(e.value)
  assert capfd.readouterr() == ('', '')


def test_broken_texture_and_missing_file(tmp_path):
  picture().save(tmp_path / 'a.png')
  (tmp_path / 'a.png').write_bytes((tmp_path / 'a.png').read_bytes()[:60])
  with pytest.raises(UserError, match=r'quad\.obj'):
    load(write_obj(tmp_path, 'newmtl wood\nmap_Kd a.png\n'))
  with pytest.raises(UserError, match='gone'):
    load(tmp_path / 'gone.obj')


def test_listing(tmp_path):
  for name in (
    'b/Chair.OBJ',
    'a.glb',
    'a.ply',
    'b/c/é 1.off',
    '.hidden/x.obj',
    'b/._y.obj',
    'n.txt',
  ):
    path = tmp_path / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(b'')
  models = mesh_folder.list_models('chair', str(tmp_path), None, 0)
  ids = [m.id for m in models]
  assert ids == sorted(set(ids)) and len(ids) == 4
  assert ids[2:] == ['b_Chair', 'b_c_é 1']
  assert all(i.startswith('a_') and len(i) == 10 for i in ids[:2])
  assert {m.category for m in models} == {'chair'} and all(os.path.isfile(m.path) for m in models)
  assert pickle.loads(pickle.dumps(models)) == models
  assert mesh_folder.list_models('chair', str(tmp_path), 2, 7) == models[:2]


def test_listing_errors(tmp_path):
  with pytest.raises(UserError, match='no mesh file'):
    mesh_folder.list_models('chair', str(tmp_path))
  for folder in (str(tmp_path / 'gone'), '', None):
    with pytest.raises(UserError, match='--input'):
      mesh_folder.list_models('chair', folder)


def test_table_of_sources():
  assert source('meshes') is mesh_folder
  for name in SOURCES:
    module = source(name)
    assert callable(module.list_models)
    assert hasattr(module, 'load') or hasattr(module, 'read_record')


DAE = """<?xml version="1.0" encoding="utf-8"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><created>2020-01-01T00:00:00Z</created><modified>2020-01-01T00:00:00Z</modified>
<unit name="meter" meter="1"/><up_axis>Y_UP</up_axis></asset>
<library_images><image id="i"><init_from>a.png</init_from></image></library_images>
<library_effects><effect id="e"><profile_COMMON>
<newparam sid="su"><surface type="2D"><init_from>i</init_from></surface></newparam>
<newparam sid="sa"><sampler2D><source>su</source></sampler2D></newparam>
<technique sid="t"><lambert><diffuse><texture texture="sa" texcoord="UV"/></diffuse></lambert>
</technique></profile_COMMON></effect></library_effects>
<library_materials><material id="m"><instance_effect url="#e"/></material></library_materials>
<library_geometries><geometry id="g"><mesh>
<source id="p"><float_array id="pa" count="12">0 0 0 1 0 0 1 1 0 0 1 0</float_array>
<technique_common><accessor source="#pa" count="4" stride="3"><param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<source id="q"><float_array id="qa" count="8">0 0 1 0 1 1 0 1</float_array>
<technique_common><accessor source="#qa" count="4" stride="2"><param name="S" type="float"/>
<param name="T" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles material="ms" count="2"><input semantic="VERTEX" source="#v" offset="0"/>
<input semantic="TEXCOORD" source="#q" offset="1" set="0"/>
<p>0 0 1 1 2 2 0 0 2 2 3 3</p></triangles></mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="s"><node id="n"><instance_geometry url="#g">
<bind_material><technique_common><instance_material symbol="ms" target="#m"/></technique_common>
</bind_material></instance_geometry></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>
"""


def test_the_checksum_is_of_all_that_belongs_to_a_mesh(tmp_path):
  """Of a mesh alone in its folder, of meshes in one folder, and of what cannot be read."""
  for folder in ('alone', 'alone/textures', 'many'):
    (tmp_path / folder).mkdir()
  for name in ('alone/a.obj', 'many/a.obj', 'many/b.obj'):
    (tmp_path / name).write_text('v 0 0 0\n')
  os.mkfifo(tmp_path / 'many' / 'pipe.obj')

  def checksums():
    return {m.id: m.content for m in mesh_folder.list_models('x', str(tmp_path))}

  first = checksums()
  assert first['many_pipe'] == '' and all(first[id] for id in ('alone_a', 'many_a', 'many_b'))
  changed = {}
  for name in ('alone/textures/a.png', 'many/a.mtl', 'many/c.txt', 'many/b.obj'):
    (tmp_path / name).write_text('new')
    now = checksums()
    changed[name] = [id for id in now if now[id] != first[id]]
    first = now
  assert changed == {
    'alone/textures/a.png': ['alone_a'],
    'many/a.mtl': ['many_a'],
    'many/c.txt': [],
    'many/b.obj': ['many_b'],
  }
