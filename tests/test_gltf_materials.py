"""Colours of glTF files: materials, textures and where they lie."""

import base64
import io

import numpy as np
import PIL.Image
import pytest
from gltf_files import (
  BLUE,
  GREEN,
  LEFT,
  RED,
  RIGHT,
  TRIANGLE,
  UV,
  WHITE,
  Builder,
  colors,
  linear,
  one,
  png,
  read,
  textured,
)

from cvn.errors import UserError
from datagen.reading import notes


@pytest.mark.parametrize(
  ('wrap', 'expected'), [(10497, GREEN), (33071, RED), (33648, RED), (None, GREEN)]
)
def test_samplers(wrap, expected):
  """Beside its left border: its right half, the border itself, or its left half, mirrored."""
  b = textured(UV - [0.35, 0])
  b.header['samplers'] = [{} if wrap is None else {'wrapS': wrap}]
  b.header['textures'][0]['sampler'] = 0
  assert colors(read(b)[0], (0.8, 0.1, 0.1)) == [[*expected]]


TRANSFORM = 'KHR_texture_transform'


@pytest.mark.parametrize(
  ('transform', 'uv'),
  [
    ({'offset': [0.5, 0.25]}, [[0.5, 0.25], [1.5, 0.25], [0.5, 1.25]]),
    ({'scale': [0.5, 2]}, [[0, 0], [0.5, 0], [0, 2]]),
    # A quarter against the clock, in coordinates of which v goes down.
    ({'rotation': np.pi / 2}, [[0, 0], [0, -1], [1, 0]]),
    ({'rotation': np.pi / 2, 'scale': [2, 1], 'offset': [0, 3]}, [[0, 3], [0, 1], [1, 3]]),
  ],
)
def test_texture_transforms(transform, uv):
  b = textured(texture={'extensions': {TRANSFORM: transform}})
  b.header['samplers'] = [{'wrapS': 33071, 'wrapT': 33071}]  # so that nothing is moved to a tile
  b.header['textures'][0]['sampler'] = 0
  expected = np.array(uv, float) * [1, -1] + [0, 1]
  np.testing.assert_allclose(read(b)[0].corner_uv[0], expected, atol=1e-6)


def test_other_sets_of_coordinates():
  for texture in ({'texCoord': 1}, {'texCoord': 7, 'extensions': {TRANSFORM: {'texCoord': 1}}}):
    mesh, _ = read(textured(np.zeros((3, 2), 'f4'), texture=texture, TEXCOORD_1=UV))
    assert colors(mesh, LEFT, RIGHT) == [[*RED], [*GREEN]]
  mesh, noted = read(textured(texture={'texCoord': 3}))
  assert colors(mesh, LEFT)[0] == [128, 128, 0] and noted == {notes.NO_COORDINATES}


@pytest.mark.parametrize('dtype', ['u1', 'u2', 'f4'])
@pytest.mark.parametrize('width', [3, 4])
def test_vertex_colors_are_linear(dtype, width):
  values = np.tile(np.append(linear((188, 128, 64)), 1.0)[:width], (3, 1))
  values = (
    values.astype('f4') if dtype == 'f4' else np.round(values * np.iinfo(dtype).max).astype(dtype)
  )
  b = Builder()
  index = b.accessor(values, **({} if dtype == 'f4' else {'normalized': True}))
  mesh, _ = read(one(b, {'COLOR_0': index}))
  np.testing.assert_allclose(colors(mesh, LEFT), [[188, 128, 64]], atol=1 if dtype != 'u1' else 3)


def test_factors_vertex_colors_and_textures_multiply():
  half = [*linear((128, 255, 255)), 1.0]
  b = textured(
    picture=png((200, 100, 50)), COLOR_0=np.tile(linear((255, 128, 255)), (3, 1)).astype('f4')
  )
  b.header['materials'][0]['pbrMetallicRoughness']['baseColorFactor'] = half
  np.testing.assert_allclose(colors(read(b)[0], LEFT), [[100, 50, 50]], atol=1)


@pytest.mark.parametrize(
  ('mode', 'faces', 'hole'),
  [({}, 1, False), ({'alphaMode': 'MASK'}, 1, True), ({'alphaMode': 'BLEND'}, 1, True)],
)
def test_alpha_of_textures(mode, faces, hole):
  b = textured(picture=png((255, 0, 0, 255), (0, 255, 0, 9), mode='RGBA'), material=mode)
  mesh, _ = read(b)
  assert len(mesh.faces) == faces
  assert (mesh.textures[0][..., 3].min() == 0) == hole


def test_blended_alpha_is_glass_and_masked_alpha_is_cut():
  """A car's window of alpha 0.3 in a texture is surface with BLEND, as it is by a factor."""
  picture = png((255, 0, 0, 255), (0, 255, 0, 77), mode='RGBA')
  for mode, solid in (('BLEND', True), ('MASK', False)):
    mesh, _ = read(textured(picture=picture, material={'alphaMode': mode}))
    assert (mesh.textures[0][..., 3].min() == 255) == solid
  mesh, _ = read(textured(picture=picture, material={'alphaMode': 'MASK', 'alphaCutoff': 0.2}))
  assert mesh.textures[0][..., 3].min() == 255
  b = textured(picture=picture, material={'alphaMode': 'MASK'})
  b.header['materials'][0]['pbrMetallicRoughness']['baseColorFactor'] = [1, 1, 1, 0.5]
  assert (read(b)[0].textures[0][..., 3] == 255).mean() == 0.5  # 0.5 of it is 0.5


@pytest.mark.parametrize(('mode', 'left'), [('OPAQUE', 2), ('MASK', 1), ('BLEND', 1)])
def test_vertex_alpha_has_a_say_where_the_mode_gives_it_one(mode, left):
  b = Builder(materials=[{'alphaMode': mode}])
  points = b.accessor(np.concatenate([TRIANGLE, TRIANGLE + 1]).astype('f4'))
  color = b.accessor(np.array([[1, 1, 1, 1]] * 3 + [[1, 1, 1, 0]] * 3, 'f4'))
  attributes = {'POSITION': points, 'COLOR_0': color}
  assert len(read(one(b, attributes, material=0))[0].faces) == left
  assert len(read(one(b, attributes))[0].faces) == 2


TEXTURE = {'index': 0}
BASE, BLACK = {'baseColorTexture': TEXTURE}, {'baseColorFactor': [0, 0, 0, 1]}
GLOW, GLOW_RED = {'emissiveFactor': [1, 1, 1]}, {'emissiveFactor': [1, 0, 0]}


def specular(**model):
  return {'extensions': {'KHR_materials_pbrSpecularGlossiness': model}}


@pytest.mark.parametrize(
  ('material', 'expected'),
  [
    (specular(diffuseTexture=TEXTURE), BLUE),
    (specular(diffuseFactor=[0, 1, 0, 1], specularFactor=[1, 0, 0]), GREEN),
    (specular(diffuseFactor=[0, 0, 0, 1], specularFactor=[1, 0, 0]), RED),  # a metal
    (specular(diffuseFactor=[0, 1, 0, 1]) | {'pbrMetallicRoughness': BASE}, BLUE),
    (GLOW | {'emissiveTexture': TEXTURE, 'pbrMetallicRoughness': BLACK}, BLUE),
    (GLOW | {'emissiveTexture': TEXTURE}, BLUE),
    (GLOW_RED | {'pbrMetallicRoughness': BLACK}, RED),
    (GLOW_RED, WHITE),
    ({'emissiveTexture': TEXTURE}, WHITE),
    (GLOW_RED | {'pbrMetallicRoughness': BASE}, BLUE),
    ({'extensions': {'KHR_materials_unlit': {}}, 'pbrMetallicRoughness': BASE}, BLUE),
  ],
)
def test_where_a_material_has_its_color(material, expected):
  b = Builder(materials=[material])
  b.picture(png(BLUE))
  assert colors(read(one(b, {'TEXCOORD_0': b.accessor(UV)}, material=0))[0], LEFT) == [[*expected]]


def test_webp_avif_and_basis():
  for name, kind in (('EXT_texture_webp', 'WEBP'), ('EXT_texture_avif', 'AVIF')):
    stream = io.BytesIO()
    PIL.Image.new('RGB', (8, 8), BLUE).save(stream, kind, quality=100)
    b = textured()
    b.header['images'].append({'bufferView': b.view(stream.getvalue())})
    b.header['textures'][0] = {'extensions': {name: {'source': 1}}}
    np.testing.assert_allclose(colors(read(b)[0], LEFT), [BLUE], atol=12)
  b = textured()
  b.header['images'].append({'bufferView': b.view(b'\xabKTX 20\xbb\r\n\x1a\n rest')})
  b.header['textures'][0]['extensions'] = {'KHR_texture_basisu': {'source': 1}}
  assert colors(read(b)[0], LEFT) == [[*RED]]  # the one to fall back on
  del b.header['textures'][0]['source']
  with pytest.raises(UserError, match=r'its image 1 is in KTX2 format .* convert it'):
    read(b)
  b.header['extensionsRequired'] = ['KHR_texture_basisu']
  with pytest.raises(UserError, match=r'KTX2 .*gltf-transform'):
    read(b)


@pytest.mark.parametrize('where', ['data', 'buffer', 'file'])
def test_pictures_that_cannot_be_read(where):
  b = textured()
  broken = b'not a picture'
  data = {'uri': 'data:image/png;base64,' + base64.b64encode(broken).decode()}
  image = {'data': data, 'buffer': {'bufferView': b.view(broken)}, 'file': {'uri': 'a.png'}}[where]
  b.header['images'] = [image]
  with pytest.raises(UserError, match='its image 0 is not a readable image'):
    read(b, {'a.png': broken}.get)


def test_pictures_that_are_missing_or_not_used():
  b = textured()
  b.header['images'] = [{'uri': 'a.png'}, {'uri': 'normals.ktx2'}]
  assert colors(read(b)[0], LEFT) == [[*WHITE]]
  b.header['textures'] = [{}]
  assert colors(read(b)[0], LEFT) == [[*WHITE]]
