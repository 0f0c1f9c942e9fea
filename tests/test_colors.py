"""Colours all the way: files of every kind -> pixels of their views and colours of their voxels.

The object is a square sheet that faces +z with a colour in each quarter, or a cube. No colour is a
corner of the RGB cube, so that one that was taken for linear would not pass.
"""

import numpy as np
import PIL.Image
import pytest
import trimesh
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from cvn.camera import camera_at, project
from cvn.grid import OBJECT_EXTENT, world_to_grid
from datagen.geometry.mesh import NO_COLOR
from datagen.pipeline import Settings, make_record
from datagen.reading import read_mesh
from datagen.reading.files import folder_files

RUST, MOSS, NAVY, CREAM = (200, 60, 30), (40, 140, 60), (20, 50, 120), (240, 230, 200)
GREY = (round(NO_COLOR * 255),) * 3
HOLE = None
CENTERS = {'tl': (-0.5, 0.5), 'tr': (0.5, 0.5), 'bl': (-0.5, -0.5), 'br': (0.5, -0.5)}
COLORS = dict(zip(CENTERS, (RUST, MOSS, NAVY, CREAM), strict=True))
QUARTERS = {CENTERS[name]: color for name, color in COLORS.items()}  # (x, y) in [-1, 1]^2 -> colour


def look_at(mesh, points, azimuths=(0.0, 180.0)):
  """What is seen of points from each azimuth, and their voxels; HOLE where nothing is.

  Returns:
    (a list of colours for each azimuth, a list of colours).
  """
  record, _ = make_record(mesh, Settings(azimuths=azimuths, image_size=64, grid_size=16))
  points = np.array(points) * OBJECT_EXTENT / 2
  pixels = []
  for view, azimuth in zip(record.views, azimuths, strict=True):
    column, row = project(points, camera_at(azimuth, image_size=64))[0].astype(int).T
    pixels.append([tuple(p[:3]) if p[3] else HOLE for p in view[row, column].tolist()])
  voxels = np.floor(world_to_grid(points * (1 - 1e-6), size=16)).tolist()
  colors = dict(zip(map(tuple, record.surface_index.tolist()), record.surface_color, strict=True))
  return pixels, [tuple(colors[tuple(v)].tolist()) if tuple(v) in colors else HOLE for v in voxels]


def assert_sheet(mesh, expected, atol=1):
  """Front, back and voxels of a sheet have the colours {(x, y): colour}."""
  pixels, voxels = look_at(mesh, [(x, y, 0) for x, y in expected])
  for what, colors in (('front', pixels[0]), ('back', pixels[1]), ('voxel', voxels)):
    for place, found, color in zip(expected, colors, expected.values(), strict=True):
      if found is HOLE or color is HOLE:
        assert found is color, (what, place, found, color)
      else:
        np.testing.assert_allclose(found, color, atol=atol, err_msg=f'{what} at {place}')


def read(path):
  return read_mesh(folder_files(str(path.parent)), path.name)


def picture(colors=COLORS):
  """An image of four quarters; HOLE has no alpha."""
  rgba = [(*c, 255) if c is not HOLE else (*NAVY, 0) for c in colors.values()]
  quarters = np.array(rgba, np.uint8).reshape(2, 2, 4)
  return PIL.Image.fromarray(quarters.repeat(16, 0).repeat(16, 1))


def write_obj(folder, mtl, faces, *, tiles=1, offset=(0, 0), vertices=''):
  """Writes a sheet as OBJ; faces use v and vt 1 to 4, counter-clockwise from the lower left."""
  (folder / 'a.mtl').write_text(mtl)
  corners = [(0, 0), (1, 0), (1, 1), (0, 1)]
  lines = [f'v {2 * x - 1} {2 * y - 1} 0' for x, y in corners]
  lines += [f'vt {tiles * x + offset[0]} {tiles * y + offset[1]}' for x, y in corners]
  (folder / 'a.obj').write_text('\n'.join(['mtllib a.mtl', *lines, vertices, faces]) + '\n')
  return folder / 'a.obj'


SHEET = 'f 1/1 2/2 3/3\nf 1/1 3/3 4/4\n'
BACK = 'f 3/3 2/2 1/1\nf 4/4 3/3 1/1\n'


def kd(name, color, *more):
  return '\n'.join([f'newmtl {name}', 'Kd ' + ' '.join(str(c / 255) for c in color), *more]) + '\n'


def quarter(name, first):
  """Vertices and faces of one quarter of the sheet; `first` is the index of its first vertex."""
  x, y = CENTERS[name]
  corners = [(x - 0.5, y - 0.5), (x + 0.5, y - 0.5), (x + 0.5, y + 0.5), (x - 0.5, y + 0.5)]
  vertices = [f'v {a} {b} 0' for a, b in corners]
  i = [first + k for k in range(4)]
  return '\n'.join(
    [*vertices, f'usemtl {name}', f'f {i[0]} {i[1]} {i[2]}', f'f {i[0]} {i[2]} {i[3]}']
  )


def test_obj_texture(tmp_path):
  picture().save(tmp_path / 'a.png')
  path = write_obj(tmp_path, kd('m', GREY, 'map_Kd a.png'), f'usemtl m\n{SHEET}')
  assert_sheet(read(path), QUARTERS)


@pytest.mark.parametrize('offset', [(0, 0), (-7, 3), (100, -100)])
def test_obj_texture_repeats(tmp_path, offset):
  picture().save(tmp_path / 'a.png')
  mtl = kd('m', GREY, 'map_Kd a.png')
  path = write_obj(tmp_path, mtl, f'usemtl m\n{SHEET}', tiles=2, offset=offset)
  tiles = {
    (x / 2 + a, y / 2 + b): color
    for (x, y), color in QUARTERS.items()
    for a in (-0.5, 0.5)
    for b in (-0.5, 0.5)
  }
  assert_sheet(read(path), tiles)


def test_obj_material_colors(tmp_path):
  mtl = ''.join(kd(name, color) for name, color in COLORS.items())
  parts = [quarter(name, 5 + 4 * n) for n, name in enumerate(COLORS)]
  assert_sheet(read(write_obj(tmp_path, mtl, '\n'.join(parts))), QUARTERS)


def test_obj_missing_texture_is_the_material_color_and_missing_mtl_grey(tmp_path):
  mtl = kd('tl', RUST, 'map_Kd gone.png') + kd('tr', MOSS)
  parts = [quarter(name, 5 + 4 * n) for n, name in enumerate(COLORS)]
  mesh = read(write_obj(tmp_path, mtl, '\n'.join(parts)))
  grey = {CENTERS['bl']: GREY, CENTERS['br']: GREY}  # materials that the MTL file does not have
  assert_sheet(mesh, QUARTERS | grey)
  assert mesh.missing == ('gone.png', 'material bl', 'material br')


def test_obj_paths_of_windows(tmp_path):
  (tmp_path / 'My images').mkdir()
  picture().save(tmp_path / 'My images' / 'A.PNG')
  mtl = kd('m', GREY, 'map_Kd my images\\a.png')
  assert_sheet(read(write_obj(tmp_path, mtl, f'usemtl m\n{SHEET}')), QUARTERS)


def test_obj_glass_is_surface_of_its_color(tmp_path):
  path = write_obj(tmp_path, kd('m', NAVY, 'd 0.3'), f'usemtl m\n{SHEET}')
  assert_sheet(read(path), dict.fromkeys(QUARTERS, NAVY))


def test_obj_texture_with_holes(tmp_path):
  holed = COLORS | {'tr': HOLE}
  picture(holed).save(tmp_path / 'a.png')
  path = write_obj(tmp_path, kd('m', GREY, 'map_Kd a.png'), f'usemtl m\n{SHEET}')
  assert_sheet(read(path), QUARTERS | {CENTERS['tr']: HOLE})


def test_obj_vertex_colors(tmp_path):
  lines, faces = [], []
  for n, (name, color) in enumerate(COLORS.items()):
    *vertices, _, one, two = quarter(name, 1 + 4 * n).split('\n')
    lines += [f'{v} {" ".join(str(c / 255) for c in color)}' for v in vertices]
    faces += [one, two]
  (tmp_path / 'a.obj').write_text('\n'.join(lines + faces))
  assert_sheet(read(tmp_path / 'a.obj'), QUARTERS)


@pytest.mark.parametrize('order', ['picture first', 'picture last'])
@pytest.mark.parametrize('twin', [SHEET, BACK])
def test_of_faces_in_one_place_the_textured_one_is_seen_from_both_sides(tmp_path, order, twin):
  picture().save(tmp_path / 'a.png')
  faces = [f'usemtl m\n{SHEET}', f'usemtl n\n{twin}']
  mtl = kd('m', GREY, 'map_Kd a.png') + kd('n', GREY)
  path = write_obj(tmp_path, mtl, ''.join(faces if order == 'picture first' else faces[::-1]))
  assert_sheet(read(path), QUARTERS)


@pytest.mark.parametrize('order', [1, -1])
def test_of_a_double_sided_box_the_outside_is_seen(tmp_path, order):
  """Sides and insides in the very same places: no view and no voxel shows the inside's colour."""
  box = trimesh.creation.box((2, 2, 2))
  lines = [f'v {x} {y} {z}' for x, y, z in box.vertices]
  outside = [f'f {a} {b} {c}' for a, b, c in box.faces + 1]
  inside = [f'f {c} {b} {a}' for a, b, c in box.faces + 1]
  parts = ['\n'.join(['usemtl out', *outside]), '\n'.join(['usemtl in', *inside])][::order]
  (tmp_path / 'a.mtl').write_text(kd('out', MOSS) + kd('in', CREAM))
  (tmp_path / 'a.obj').write_text('\n'.join(['mtllib a.mtl', *lines, *parts]))
  pixels, voxels = look_at(
    read(tmp_path / 'a.obj'),
    [(x, y, z) for x in (-0.7, 0.1, 0.6) for y in (-0.9, 0.3) for z in (-1, 1)],
    azimuths=(0.0, 90.0, 180.0, 270.0),
  )
  assert {color for view in pixels for color in view} | set(voxels) == {MOSS}


def linear(color):
  """The inverse of sRGB's curve: 0..255 -> 0..1."""
  x = np.array(color) / 255
  return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)


QUAD = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
QUAD_FACES = np.array([[0, 1, 2], [0, 2, 3]])


def write_glb(folder, **material):
  visual = TextureVisuals(uv=(QUAD[:, :2] + 1) / 2, material=PBRMaterial(**material))
  mesh = trimesh.Trimesh(QUAD, QUAD_FACES, visual=visual, process=False)
  (folder / 'a.glb').write_bytes(mesh.export(file_type='glb'))
  return folder / 'a.glb'


def test_glb_base_color_texture(tmp_path):
  """Neither metal nor roughness change what the base colour is."""
  path = write_glb(tmp_path, baseColorTexture=picture(), metallicFactor=1.0, roughnessFactor=0.2)
  assert_sheet(read(path), QUARTERS)


def test_glb_base_color_factor_is_linear(tmp_path):
  path = write_glb(tmp_path, baseColorFactor=[*linear(RUST), 1.0])
  # trimesh writes eight bits, which are wide apart in the dark.
  assert_sheet(read(path), dict.fromkeys(QUARTERS, RUST), atol=8)


def test_glb_factor_and_texture_multiply(tmp_path):
  path = write_glb(tmp_path, baseColorTexture=picture(), baseColorFactor=[1.0, 0.0, 1.0, 1.0])
  assert_sheet(read(path), {place: (r, 0, b) for place, (r, _, b) in QUARTERS.items()})


@pytest.mark.parametrize(('mode', 'seen'), [('MASK', HOLE), ('BLEND', HOLE), ('OPAQUE', NAVY)])
def test_glb_alpha_cuts_as_its_mode_says(tmp_path, mode, seen):
  holed = picture(COLORS | {'bl': HOLE})
  path = write_glb(tmp_path, baseColorTexture=holed, alphaMode=mode)
  assert_sheet(read(path), QUARTERS | {CENTERS['bl']: seen})


def four_quarters():
  """(vertices [16, 3], faces [8, 3]), four and two a quarter."""
  corners = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
  xy = np.concatenate([corners + center for center in CENTERS.values()])
  vertices = np.insert(xy, 2, 0.0, axis=1)
  return vertices, np.concatenate([QUAD_FACES + 4 * k for k in range(4)])


@pytest.mark.parametrize('encoding', ['ascii', 'binary'])
@pytest.mark.parametrize('per', ['vertex', 'face'])
def test_ply_colors(tmp_path, per, encoding):
  vertices, faces = four_quarters()
  colors = np.array([(*c, 255) for c in COLORS.values()], np.uint8)
  colors = {f'{per}_colors': colors.repeat(4 if per == 'vertex' else 2, 0)}
  mesh = trimesh.Trimesh(vertices, faces, process=False, **colors)
  (tmp_path / 'a.ply').write_bytes(mesh.export(file_type='ply', encoding=encoding))
  assert_sheet(read(tmp_path / 'a.ply'), QUARTERS)


def test_dae_texture(tmp_path):
  picture().save(tmp_path / 'a.png')
  (tmp_path / 'a.dae').write_text(DAE)
  assert_sheet(read(tmp_path / 'a.dae'), QUARTERS)


DAE = """<?xml version="1.0" encoding="utf-8"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><created>2020-01-01T00:00:00Z</created><modified>2020-01-01T00:00:00Z</modified>
<up_axis>Y_UP</up_axis></asset>
<library_images><image id="i"><init_from>a.png</init_from></image></library_images>
<library_effects><effect id="e"><profile_COMMON>
<newparam sid="su"><surface type="2D"><init_from>i</init_from></surface></newparam>
<newparam sid="sa"><sampler2D><source>su</source></sampler2D></newparam>
<technique sid="t"><lambert><diffuse><texture texture="sa" texcoord="UV"/></diffuse></lambert>
</technique></profile_COMMON></effect></library_effects>
<library_materials><material id="m"><instance_effect url="#e"/></material></library_materials>
<library_geometries><geometry id="g"><mesh>
<source id="p"><float_array id="pa" count="12">-1 -1 0 1 -1 0 1 1 0 -1 1 0</float_array>
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
