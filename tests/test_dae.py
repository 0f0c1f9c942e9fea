"""DAE files: scenes, skins, materials and their pictures."""

import io

import numpy as np
import PIL.Image
import pytest

from datagen.geometry.mesh import NO_COLOR
from datagen.reading import notes, read_mesh
from datagen.reading.files import folder_files


def source(name, values, parameters):
  values = np.asarray(values)
  count, stride = len(values), len(parameters)
  listed = ''.join(f'<param name="{p}" type="float"/>' for p in parameters)
  numbers = ' '.join(map(str, values.ravel()))
  return f"""<source id="{name}"><float_array id="{name}a" count="{values.size}">{numbers}
</float_array><technique_common><accessor source="#{name}a" count="{count}" stride="{stride}">
{listed}</accessor></technique_common></source>"""


QUAD = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
TRIANGLES = '<triangles count="2" material="ms">{inputs}<p>0 1 2 0 2 3</p></triangles>'
INPUT = '<input semantic="VERTEX" source="#v" offset="0"/>'
UV = '<input semantic="TEXCOORD" source="#t" offset="0" set="0"/>'
COLOR = '<input semantic="COLOR" source="#c" offset="0"/>'
BIND = """<bind_material><technique_common><instance_material symbol="ms" target="#m"/>
</technique_common></bind_material>"""
TEXTURE = '<diffuse><texture texture="sa" texcoord="UV"/></diffuse>'


def dae(shading, *, inputs=INPUT, faces=TRIANGLES, library='', node=None, wrap='', color=(1, 0, 0)):
  node = node or f'<instance_geometry url="#g">{BIND}</instance_geometry>'
  return f"""<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><up_axis>Y_UP</up_axis></asset>
<library_images><image id="i"><init_from>a.png</init_from></image></library_images>
<library_effects><effect id="e"><profile_COMMON>
<newparam sid="su"><surface type="2D"><init_from>i</init_from></surface></newparam>
<newparam sid="sa"><sampler2D><source>su</source>{wrap}</sampler2D></newparam>
<technique sid="t"><lambert>{shading}</lambert></technique></profile_COMMON></effect>
</library_effects>
<library_materials><material id="m"><instance_effect url="#e"/></material></library_materials>
<library_geometries><geometry id="g"><mesh>{source('p', QUAD, 'XYZ')}
{source('t', np.array(QUAD)[:, :2], 'ST')}{source('c', [color] * 4, 'RGB')}
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
{faces.format(inputs=inputs)}</mesh></geometry></library_geometries>{library}
<library_visual_scenes><visual_scene id="s"><node id="n">{node}</node></visual_scene>
</library_visual_scenes><scene><instance_visual_scene url="#s"/></scene></COLLADA>"""


def read(folder, content, picture=(0, 0, 255)):
  stream = io.BytesIO()
  PIL.Image.new('RGB', (4, 4), picture).save(stream, 'PNG')
  (folder / 'a.png').write_bytes(stream.getvalue())
  (folder / 'a.dae').write_text(content)
  return read_mesh(folder_files(str(folder)), 'a.dae')


def diffuse(r, g, b):
  return f'<diffuse><color>{r} {g} {b} 1</color></diffuse>'


@pytest.mark.parametrize(
  ('shading', 'inputs', 'expected'),
  [
    (diffuse(0, 1, 0), INPUT, [0, 1, 0]),
    (diffuse(0, 1, 0), INPUT + COLOR, [1, 0, 0]),  # vertex colours stand alone
    (diffuse(0, 0, 0), INPUT, [0, 0, 0]),
    ('<emission><color>0 1 0 1</color></emission>' + diffuse(0, 0, 0), INPUT, [0, 1, 0]),
    ('', INPUT, [NO_COLOR] * 3),
  ],
)
def test_colors(tmp_path, shading, inputs, expected):
  mesh = read(tmp_path, dae(shading, inputs=inputs))
  np.testing.assert_allclose(mesh.corner_colors[0, 0, :3], expected, atol=1e-6)


def test_white_vertex_colors_leave_it_to_the_material(tmp_path):
  mesh = read(tmp_path, dae(diffuse(0, 1, 0), inputs=INPUT + COLOR, color=(1, 1, 1)))
  np.testing.assert_allclose(mesh.corner_colors[0, 0, :3], [0, 1, 0])


def test_texture_and_sampler(tmp_path):
  wrap = '<wrap_s>CLAMP</wrap_s><wrap_t>MIRROR</wrap_t>'
  mesh = read(tmp_path, dae(TEXTURE, inputs=INPUT + UV, wrap=wrap))
  assert mesh.texture.tolist() == [0, 0] and mesh.wraps == (('clamp', 'mirror'),)
  np.testing.assert_allclose(mesh.corner_uv[0], [[0, 0], [1, 0], [1, 1]])


@pytest.mark.parametrize(
  ('transparent', 'alpha'),
  [
    ('', 1),
    ('<transparency><float>0.4</float></transparency>', 0.4),
    ('<transparency><float>0</float></transparency>', 1),
    ('<transparent><color>1 1 1 0.4</color></transparent>', 0.4),
    ('<transparent opaque="A_ZERO"><color>1 1 1 0.4</color></transparent>', 0.6),
    ('<transparent opaque="RGB_ZERO"><color>.4 .4 .4 1</color></transparent>', 0.6),
    ('<transparent opaque="RGB_ONE"><color>.4 .4 .4 1</color></transparent>', 0.4),
  ],
)
def test_alpha(tmp_path, transparent, alpha):
  mesh = read(tmp_path, dae(diffuse(0, 1, 0) + transparent))
  np.testing.assert_allclose(mesh.corner_colors[..., 3], alpha, atol=1e-6)


def test_polygons_that_are_not_convex(tmp_path):
  faces = '<polylist count="1" material="ms">{inputs}<vcount>4</vcount><p>1 2 3 0</p></polylist>'
  content = dae(diffuse(0, 1, 0), faces=faces).replace('1 1 0', '0.2 0.2 0')
  mesh = read(tmp_path, content)
  a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
  assert np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2 == pytest.approx(0.2)


def test_materials_that_are_not_bound_or_not_there(tmp_path):
  node = '<instance_geometry url="#g"/>'
  mesh = read(tmp_path, dae(diffuse(0, 1, 0), node=node))
  assert mesh.missing == ('material ms',)
  content = dae(diffuse(0, 1, 0), node=node).replace('material="ms"', 'material="m"')
  mesh = read(tmp_path, content)
  assert mesh.corner_colors[0, 0, :3].tolist() == [0, 1, 0]
  assert mesh.notes == (notes.MATERIAL_GUESSED,)


SKIN = f"""<library_controllers><controller id="k"><skin source="#g">
<bind_shape_matrix>2 0 0 0 0 2 0 0 0 0 2 0 0 0 0 1</bind_shape_matrix>
<source id="j"><Name_array id="ja" count="2">one two</Name_array><technique_common>
<accessor source="#ja" count="2" stride="1"><param name="JOINT" type="name"/></accessor>
</technique_common></source>
<source id="b"><float_array id="ba" count="32">{'1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1 ' * 2}
</float_array>
<technique_common><accessor source="#ba" count="2" stride="16">
<param name="TRANSFORM" type="float4x4"/></accessor></technique_common></source>
<source id="w"><float_array id="wa" count="2">1 0.5</float_array><technique_common>
<accessor source="#wa" count="2" stride="1"><param name="WEIGHT" type="float"/></accessor>
</technique_common></source>
<joints><input semantic="JOINT" source="#j"/>
<input semantic="INV_BIND_MATRIX" source="#b"/></joints>
<vertex_weights count="4"><input semantic="JOINT" source="#j" offset="0"/>
<input semantic="WEIGHT" source="#w" offset="1"/><vcount>1 1 2 1</vcount>
<v>0 0 0 0 0 1 1 1 1 0</v></vertex_weights></skin></controller></library_controllers>"""


@pytest.mark.parametrize('there', [True, False])
def test_skins(tmp_path, there):
  """The joints stand at z = 5 and z = 7; where one is not there, the shape is as it was bound."""
  joints = '</node><node sid="one"><translate>0 0 5</translate><node sid="{}">'
  joints = joints.format('two' if there else 'other') + '<translate>0 0 2</translate></node>'
  node = f'<instance_controller url="#k">{BIND}</instance_controller>{joints}'
  mesh = read(tmp_path, dae(diffuse(0, 1, 0), library=SKIN, node=node))
  depth = [5, 5, 6, 7] if there else [0] * 4
  expected = np.array([[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0]]) + np.outer(depth, [0, 0, 1])
  np.testing.assert_allclose(mesh.vertices, expected, atol=1e-9)
  assert mesh.notes == (notes.POSE,)
