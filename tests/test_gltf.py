"""Shapes of glTF files: every kind of number, place and pose, and what is refused."""

import struct

import numpy as np
import pytest
from gltf_files import (
  GREEN,
  LEFT,
  RED,
  RIGHT,
  TRIANGLE,
  UV,
  Builder,
  colors,
  one,
  read,
  textured,
)

from cvn.errors import UserError
from datagen.reading import notes
from datagen.reading.headers import MAX_FACES


@pytest.mark.parametrize('dtype', ['u1', 'u2', 'i2', 'f4'])
def test_texture_coordinates_of_every_type(dtype):
  b = textured()
  top = 1 if dtype == 'f4' else np.iinfo(dtype).max
  index = b.accessor((UV * top).astype(dtype), normalized=dtype != 'f4')
  b.header['meshes'][0]['primitives'][0]['attributes']['TEXCOORD_0'] = index
  mesh, noted = read(b)
  np.testing.assert_allclose(mesh.corner_uv[0], [[0, 1], [1, 1], [0, 0]], atol=1e-6)
  assert colors(mesh, LEFT, RIGHT) == [[*RED], [*GREEN]] and not noted


@pytest.mark.parametrize('dtype', ['i1', 'i2', 'u1', 'u2'])
@pytest.mark.parametrize('normalized', [True, False])
def test_quantised_positions(dtype, normalized):
  """A node's scale and place undo it, as gltfpack writes it."""
  top = np.iinfo(dtype).max
  b = Builder()
  index = b.accessor((TRIANGLE * top).astype(dtype), normalized=normalized)
  scale = [2.0 if normalized else 2.0 / top] * 3
  one(b, {'POSITION': index}, [{'mesh': 0, 'scale': scale, 'translation': [1, 0, 0]}])
  np.testing.assert_allclose(read(b)[0].vertices, 2 * TRIANGLE + [1, 0, 0], atol=1e-6)


def test_interleaved_and_sparse_values():
  b = Builder()
  rows = np.concatenate([TRIANGLE, TRIANGLE * 9], 1)
  interleaved = b.accessor(rows[:, :3])
  b.header['bufferViews'][0] = {'buffer': 0, 'byteOffset': 36, 'byteLength': 72, 'byteStride': 24}
  b.data += rows.astype('<f4').tobytes()
  np.testing.assert_allclose(read(one(b, {'POSITION': interleaved}))[0].vertices, TRIANGLE)
  for base in (True, False):  # upon values, and upon zeros
    b = Builder()
    sparse = {
      'count': 2,
      'indices': {'bufferView': b.view(np.array([1, 2], '<u2').tobytes()), 'componentType': 5123},
      'values': {'bufferView': b.view((5 * TRIANGLE[1:]).tobytes())},
    }
    more = {'bufferView': b.view(TRIANGLE.tobytes())} if base else {}
    index = b.accessor(TRIANGLE, sparse=sparse, **more)
    np.testing.assert_allclose(read(one(b, {'POSITION': index}))[0].vertices, 5 * TRIANGLE)


@pytest.mark.parametrize(
  ('mode', 'faces'), [(4, [[0, 1, 2]]), (5, [[0, 1, 2], [2, 1, 3]]), (6, [[0, 1, 2], [0, 2, 3]])]
)
@pytest.mark.parametrize('indexed', [True, False])
def test_modes(mode, faces, indexed):
  points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 1]], np.float32)
  b = Builder()
  primitive = {'mode': mode} | (
    {'indices': b.accessor(np.arange(4, dtype='u1'))} if indexed else {}
  )
  mesh, _ = read(one(b, {'POSITION': b.accessor(points)}, **primitive))
  assert mesh.faces.tolist() == faces


def test_points_and_lines_are_left_out_and_noted():
  b = one(Builder())
  b.header['meshes'][0]['primitives'].append({'attributes': {'POSITION': 0}, 'mode': 1})
  mesh, noted = read(b)
  assert len(mesh.faces) == 1 and noted == {notes.NOT_TRIANGLES}


def test_node_matrices_and_the_scene():
  turn = [0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1, 0, 5, 0, 0, 1]  # a quarter about z, in columns
  nodes = [
    {'children': [1], 'translation': [0, 0, 7]},
    {'mesh': 0, 'matrix': turn},
    {'mesh': 0},  # in another scene
  ]
  b = one(Builder(scenes=[{'nodes': [2]}, {'nodes': [0]}], scene=1), nodes=nodes)
  mesh, _ = read(b)
  np.testing.assert_allclose(mesh.vertices, [[5, 0, 7], [5, 1, 7], [4, 0, 7]], atol=1e-9)
  half = np.sqrt(0.5)
  nodes = [{'mesh': 0, 'rotation': [0, 0, half, half], 'scale': [2, 1, 1]}]
  np.testing.assert_allclose(
    read(one(Builder(), nodes=nodes))[0].vertices, [[0, 0, 0], [0, 2, 0], [-1, 0, 0]], atol=1e-7
  )


def test_hidden_nodes_have_no_say():
  hidden = {'KHR_node_visibility': {'visible': False}}
  b = one(Builder(), nodes=[{'mesh': 0}, {'extensions': hidden, 'children': [2]}, {'mesh': 0}])
  assert len(read(b)[0].faces) == 1


def test_skins_move_vertices_as_their_joints_stand():
  b = Builder()
  attributes = {
    'POSITION': b.accessor(TRIANGLE),
    'JOINTS_0': b.accessor(np.array([[0, 1, 0, 0]] * 3, 'u1')),
    'WEIGHTS_0': b.accessor(
      np.array([[255, 0, 0, 0], [0, 255, 0, 0], [51, 204, 0, 0]], 'u1'), normalized=True
    ),
  }
  shift = np.eye(4, dtype='f4')
  shift[3, 0] = -1.0  # in columns
  b.header['skins'] = [
    {
      'joints': [1, 2],
      'inverseBindMatrices': b.accessor(np.stack([np.eye(4, dtype='f4'), shift]).reshape(2, 16)),
    }
  ]
  nodes = [
    {'mesh': 0, 'skin': 0, 'translation': [100, 0, 0]},
    {'translation': [0, 0, 2], 'children': [2]},
    {'translation': [0, 5, 0]},
  ]
  mesh, noted = read(one(b, attributes, nodes))
  np.testing.assert_allclose(mesh.vertices, [[0, 0, 2], [0, 5, 2], [-0.8, 5, 2]], atol=1e-6)
  assert noted == {notes.POSE}


def test_morph_weights_of_the_mesh_and_of_the_node():
  b = Builder()
  target = {'POSITION': b.accessor(np.array([[0, 0, 1]] * 3, 'f4'))}
  one(b, nodes=[{'mesh': 0}], targets=[target])
  b.header['meshes'][0]['weights'] = [0.5]
  assert read(b)[0].vertices[:, 2].tolist() == [0.5] * 3
  b.header['nodes'] = [{'mesh': 0, 'weights': [2.0]}, {'mesh': 0}]
  assert read(b)[0].vertices[:, 2].tolist() == [2.0] * 3 + [0.5] * 3


def test_gpu_instances():
  b = Builder(extensionsRequired=['EXT_mesh_gpu_instancing'])
  attributes = {
    'TRANSLATION': b.accessor(np.array([[0, 0, 0], [0, 0, 3]], 'f4')),
    'SCALE': b.accessor(np.array([[1, 1, 1], [2, 2, 2]], 'f4')),
  }
  node = {'mesh': 0, 'translation': [1, 0, 0]}
  node['extensions'] = {'EXT_mesh_gpu_instancing': {'attributes': attributes}}
  mesh, _ = read(one(b, nodes=[node]))
  expected = [*(TRIANGLE + [1, 0, 0]), *(2 * TRIANGLE + [1, 0, 3])]
  np.testing.assert_allclose(mesh.vertices, expected)


@pytest.mark.parametrize(
  ('header', 'reason'),
  [
    ({'extensionsRequired': ['KHR_draco_mesh_compression']}, 'packed with KHR_draco.*gltf-tr'),
    ({'extensionsRequired': ['EXT_meshopt_compression']}, 'packed with EXT_meshopt_compression'),
    ({'extensionsRequired': ['ACME_knots']}, 'requires the extension ACME_knots'),
    ({'asset': {'version': '1.0'}}, r'glTF 1\.0, not 2\.0: convert it'),
    ({'meshes': {'a': {}}}, r'glTF 1\.0'),
    ({'asset': {'version': '3.0'}}, r'glTF 3\.0'),
  ],
)  # fmt: skip
def test_what_is_refused_says_what_to_do(header, reason):
  b = one(Builder())
  b.header |= header
  with pytest.raises(UserError, match=reason):
    read(b)


def test_glb_of_the_first_version():
  with pytest.raises(UserError, match=r'glTF 1\.0'):
    read(struct.pack('<4sIIII', b'glTF', 1, 20, 0, 0))


def test_optional_extensions():
  b = one(Builder(extensionsUsed=['ACME_knots', 'KHR_materials_unlit']))
  assert read(b)[1] == {notes.EXTENSION_IGNORED}
  draco = {'KHR_draco_mesh_compression': {'bufferView': 0, 'attributes': {'POSITION': 0}}}
  b = one(Builder(extensionsUsed=list(draco)), extensions=draco)
  assert len(read(b)[0].faces) == 1  # plain data are there too
  del b.header['accessors'][0]['bufferView']
  with pytest.raises(UserError, match='KHR_draco_mesh_compression'):
    read(b)


@pytest.mark.parametrize(
  ('change', 'reason'),
  [
    ({'nodes': [{'mesh': 0, 'children': [0]}], 'scenes': [{'nodes': [0]}]}, 'no end'),
    ({'nodes': [{'mesh': 0}, {'children': [0] * 40}], 'count': 3_000_000}, '40000000 faces'),
    ({'scenes': [{'nodes': [0] * 1000}], 'count': 300_000}, '100000000 faces'),
    ({'count': 3 * 10**9}, '1000000000 faces'),
    ({'count': 9}, 'holds fewer'),
    ({'count': -3}, 'index or count'),
    ({'count': True}, 'index or count'),
    ({'byteOffset': 4}, 'holds fewer'),
    ({'byteOffset': -4}, 'index or count'),
    ({'view': {'buffer': 0, 'byteOffset': 0, 'byteLength': 10**9}}, 'beyond its buffer'),
    ({'view': {'buffer': 0, 'byteOffset': -12, 'byteLength': 12}}, 'beyond its buffer'),
  ],
)  # fmt: skip
def test_what_pretends_to_be_more_than_there_is(change, reason):
  b = one(Builder())
  for key, value in change.items():
    if key in ('nodes', 'scenes'):
      b.header[key] = value
    elif key == 'view':
      b.header['bufferViews'][0] = value
    else:
      b.header['accessors'][0][key] = value
  with pytest.raises(UserError, match=reason):
    read(b)


def test_zeros_that_are_only_declared():
  b = one(Builder())
  b.header['accessors'].append({'componentType': 5125, 'count': 10**9, 'type': 'SCALAR'})
  b.header['meshes'][0]['primitives'][0]['indices'] = 1
  with pytest.raises(UserError, match='faces'):
    read(b)
  b.header['meshes'][0]['primitives'][0] = {'attributes': {'POSITION': 0, 'COLOR_0': 1}}
  with pytest.raises(UserError, match='1000000000 values and holds none'):
    read(b)


def test_triangle_strips_have_a_face_a_corner():
  b = one(Builder(), mode=5)
  b.header['accessors'][0]['count'] = MAX_FACES + 1
  with pytest.raises(UserError, match=f'{MAX_FACES + 1} faces'):
    read(b)


def test_indices_beyond_the_vertices():
  b = Builder()
  with pytest.raises(UserError, match='out of bounds'):
    read(one(b, indices=b.accessor(np.array([0, 1, 3], 'u1'))))
