"""Scenes without end, or that pretend to be more than there is, are refused unread."""

import base64
import json
import struct
import time

import pytest

from cvn.errors import UserError
from datagen.headers import MAX_FACES, check_dae, check_gltf, count_instances


def no_files(name):
  raise FileNotFoundError(name)


def gltf(nodes, count=3, **more):
  """A glTF file of one mesh of `count` corners, which are said to be in a buffer."""
  header = {
    'asset': {'version': '2.0'},
    'nodes': nodes,
    'meshes': [{'primitives': [{'attributes': {'POSITION': 0}}]}],
    'accessors': [{'bufferView': 0, 'count': count, 'componentType': 5126, 'type': 'VEC3'}],
  }
  return json.dumps(header | more).encode()


def dae(nodes, declaration=''):
  return f'<?xml version="1.0"?>{declaration}<c:COLLADA xmlns:c="x">{nodes}</c:COLLADA>'.encode()


def test_counts_each_use():
  children = {'a': ['b', 'b', 'c'], 'b': ['c'] * 10}
  assert count_instances(children, {'c': 1}) == 21
  assert count_instances(children, {'c': 1, 'a': 5, 'alone': 3}) == 26
  assert count_instances({}, {}) == 0


def test_counts_quickly():
  """Ten nodes ten times below one another, thirty times; a chain of many."""
  start = time.process_time()
  assert count_instances({i: [i + 1] * 10 for i in range(30)}, {30: 1}) == 10**30
  assert count_instances({i: [i + 1] for i in range(100_000)}, {100_000: 1}) == 1
  assert time.process_time() - start < 5


@pytest.mark.parametrize(
  'children', [{0: [0]}, {0: [1], 1: [2], 2: [1]}, {5: [], 0: [1, 1], 1: [0]}]
)
def test_scenes_without_end(children):
  with pytest.raises(UserError, match='no end'):
    count_instances(children, {})


def test_gltf_that_is_right():
  check_gltf(gltf([{'children': [1, 2]}, {'mesh': 0}, {'mesh': 0}]), no_files)
  check_gltf(json.dumps({'asset': {}}).encode(), no_files)


@pytest.mark.parametrize(
  ('content', 'reason'),
  [
    (gltf([{'mesh': 0, 'children': [0]}]), 'no end'),
    (gltf([{'mesh': 0}], count=3 * 10**9), '1000000000 faces'),
    (gltf([{'mesh': 0}] * 2 + [{'children': [0, 1] * 20}], count=3_000_000), '40000000 faces'),
    (gltf([], accessors=[{'count': 10**9, 'type': 'MAT4'}]), '1000000000 values and holds none'),
    (gltf([], extensionsRequired=['KHR_draco_mesh_compression']), 'KHR_draco_mesh_compression'),
    (struct.pack('<4sIIII', b'glTF', 2, 100, 2**31, 0x4E4F534A) + b'{}', 'cut off'),
    (b'[]', 'no JSON object'),
  ],
)
def test_gltf_that_is_refused(content, reason):
  with pytest.raises(UserError, match=reason):
    check_gltf(content, no_files)


def test_triangle_strips_have_a_face_a_corner():
  strip = [{'primitives': [{'attributes': {'POSITION': 0}, 'mode': 5}]}]
  with pytest.raises(UserError, match=f'{MAX_FACES + 1} faces'):
    check_gltf(gltf([{'mesh': 0}], count=MAX_FACES + 1, meshes=strip), no_files)
  check_gltf(gltf([{'mesh': 0}], count=MAX_FACES + 1), no_files)


def textured(image, **more):
  materials = [{'pbrMetallicRoughness': {'baseColorTexture': {'index': 0}}}]
  return gltf([], **{'materials': materials, 'textures': [{'source': 0}], 'images': [image]} | more)


@pytest.mark.parametrize('where', ['data', 'buffer', 'data buffer', 'file'])
def test_pictures_of_gltf_that_cannot_be_read(where):
  broken = b'not a picture'
  data = 'data:image/png;base64,' + base64.b64encode(broken).decode()
  view = {'buffer': 0, 'byteOffset': 2, 'byteLength': len(broken)}
  content = {
    'data': textured({'uri': data}),
    'buffer': textured({'bufferView': 0}, bufferViews=[view], buffers=[{'uri': 'a.bin'}]),
    'data buffer': textured(
      {'bufferView': 0}, bufferViews=[view | {'byteOffset': 0}], buffers=[{'uri': data}]
    ),
    'file': textured({'uri': 'a.png'}),
  }[where]
  files = {'a.png': broken, 'a.bin': b'..' + broken}
  with pytest.raises(UserError, match='its image 0 is no picture'):
    check_gltf(content, files.__getitem__)


def test_pictures_of_other_materials_and_extensions():
  older = {'KHR_materials_pbrSpecularGlossiness': {'diffuseTexture': {'index': 0}}}
  webp = {'EXT_texture_webp': {'source': 0}}
  images, files = [{'uri': 'a.png'}], {'a.png': b'no picture'}
  for extensions, texture in ((older, {'source': 0}), (older, {'extensions': webp})):
    content = gltf([], materials=[{'extensions': extensions}], textures=[texture], images=images)
    with pytest.raises(UserError, match='its image 0'):
      check_gltf(content, files.__getitem__)


def test_pictures_of_gltf_that_are_missing_or_not_used():
  check_gltf(textured({'uri': 'a.png'}, textures=[{}]), no_files)
  check_gltf(textured({'uri': 'a.png'}), no_files)
  check_gltf(gltf([], images=[{'uri': 'normals.ktx2'}]), no_files)


def test_dae_that_is_right():
  check_dae(dae('<c:node id="a"><node><instance_geometry url="#g"/></node></c:node>' * 2))


LAUGHS = ''.join(
  f'<node id="k{i}">' + f'<instance_node url="#k{i + 1}"/>' * 10 + '</node>' for i in range(8)
)


@pytest.mark.parametrize(
  ('content', 'reason'),
  [
    (dae('<node id="a"><instance_node url="#a"/></node>'), 'no end'),
    (dae('<c:node id="a"><node><c:instance_node url="#a"/></node></c:node>'), 'no end'),
    (
      dae(LAUGHS + '<node id="k8"><instance_geometry url="#g"/></node>'),
      '111111111 parts',
    ),
    (dae('<node>' * 300 + '</node>' * 300), 'nested'),
    (dae('&a;', '<!DOCTYPE c [<!ENTITY a "b">]>'), 'DOCTYPE'),
    (dae('', '<!DOCTYPE c SYSTEM "file:///etc/passwd">'), 'DOCTYPE'),
    (dae('', '<!DOCTYPE c>').decode().encode('utf-16'), 'DOCTYPE'),
  ],
)
def test_dae_that_is_refused(content, reason):
  with pytest.raises(UserError, match=reason):
    check_dae(content)


def test_dae_in_an_encoding_that_could_hide_a_doctype():
  content = b'<?xml version="1.0" encoding="utf-7"?>+ADw-!DOCTYPE c+AD4-<c/>'
  with pytest.raises(ValueError, match='encodings'):
    check_dae(content)
