"""Materials of glTF files: the colour at each corner, the texture and its coordinates.

Factors and vertex colours are linear and are converted to sRGB; textures are sRGB already. Files
written by trimesh are no exception, although it writes sRGB values there unconverted: every viewer
shows such files too light.

The material's mode decides what alpha means. OPAQUE has none, not even of vertices. MASK cuts
holes. BLEND is glass, which is surface unless it is almost invisible.
"""

import numpy as np

from cvn.errors import UserError
from datagen.reading import notes as notes_lib
from datagen.reading.colors import as_rgba, grey, linear_to_srgb
from datagen.reading.gltf_accessors import items, raw_values, read_uri, values, view
from datagen.reading.images import is_ktx2
from datagen.reading.parts import BLEND, MASK, OPAQUE, Picture

WRAPS = {10497: 'repeat', 33071: 'clamp', 33648: 'mirror'}  # of samplers, as OpenGL numbers them
SOURCES = ('EXT_texture_webp', 'EXT_texture_avif')  # extensions that name a texture's image
MODES = {'OPAQUE': OPAQUE, 'MASK': MASK, 'BLEND': BLEND}


def appearance(document, primitive, faces, get_picture, notes):
  """(corner colours [F, 3, 4], uv [F, 3, 2] or None, `Picture` or None) of a primitive."""
  attributes = primitive['attributes']
  vertex = None
  if 'COLOR_0' in attributes:
    vertex = _vertex_colors(document, attributes['COLOR_0'])
  if 'material' not in primitive:
    if vertex is None:
      return grey(len(faces)), None, None
    vertex[:, 3] = 1
    return linear_to_srgb(vertex)[faces], None, None
  material = items(document, 'materials')[primitive['material']]
  factor, texture = _color(material, vertex is not None)
  mode = MODES.get(material.get('alphaMode', 'OPAQUE'), OPAQUE)
  color = factor if vertex is None else factor * vertex
  color = np.broadcast_to(color, (1 if vertex is None else len(vertex), 4)).copy()
  cutoff = 0.5
  if mode == OPAQUE:
    color[:, 3] = 1
  elif mode == MASK:
    cutoff = material.get('alphaCutoff', 0.5)
    strongest = max(float(color[:, 3].max(initial=0)), 1e-6)
    if texture is None:
      color[:, 3] = color[:, 3] >= cutoff
    else:
      cutoff = cutoff / strongest
      color[:, 3] = 1
  color = linear_to_srgb(color)
  colors = np.tile(color, (len(faces), 3, 1)).reshape(-1, 3, 4) if vertex is None else color[faces]
  if texture is None:
    return colors, None, None
  picture = _picture(document, texture, mode, cutoff, get_picture)
  if picture is None:
    return colors, None, None
  return colors, _coordinates(document, texture, attributes, faces, notes), picture


def _vertex_colors(document, index):
  """[V, 4] linear."""
  raw = raw_values(document, index)
  if raw.dtype.kind == 'f':
    rgba = as_rgba(values(document, index))
  else:  # integers are always normalised here, whether the file says so or not
    rgba = as_rgba(raw)
  return rgba.astype(np.float64)


def _color(material, has_vertex_colors):
  """(linear RGBA [4], description of the texture or None) of a material."""
  model = material.get('pbrMetallicRoughness', {})
  older = material.get('extensions', {}).get('KHR_materials_pbrSpecularGlossiness')
  factor = _factor(model.get('baseColorFactor', (1, 1, 1, 1)))
  texture = model.get('baseColorTexture')
  if older is not None and ('diffuseTexture' in older or texture is None):
    factor = _factor(older.get('diffuseFactor', (1, 1, 1, 1)))
    texture = older.get('diffuseTexture')
    if texture is None and not factor[:3].any():  # a metal, whose colour is its mirror's
      factor[:3] = _factor((*older.get('specularFactor', (1, 1, 1)), 1))[:3]
  # Drawings and scans without shading glow: what they show is nowhere but in the emission.
  glow = _factor((*material.get('emissiveFactor', (0, 0, 0)), 1))
  light = material.get('emissiveTexture')
  plain = texture is None and not has_vertex_colors and (light is not None and factor[:3].all())
  if glow[:3].any() and (not factor[:3].any() or plain):
    glow[3] = factor[3]
    return glow, light
  return factor, texture


def _factor(value):
  factor = np.array(value, np.float64)
  if factor.shape != (4,):
    raise UserError('a colour in its materials is invalid')
  return np.nan_to_num(factor).clip(0, 1)


def _picture(document, texture, mode, cutoff, get_picture):
  """The `Picture` for a texture's description; None if it does not exist."""
  described = items(document, 'textures')[texture['index']]
  extensions = described.get('extensions', {})
  sources = [extensions[name].get('source') for name in SOURCES if name in extensions]
  source = next((s for s in (*sources, described.get('source')) if s is not None), None)
  if source is None:
    if 'KHR_texture_basisu' not in extensions:
      return None
    source = extensions['KHR_texture_basisu'].get('source')
  image = items(document, 'images')[source]
  content = None
  if 'uri' in image and not image['uri'].startswith('data:'):
    content = get_picture(image['uri'])
  elif 'uri' in image:
    content = read_uri(document, image['uri'])
  else:
    content = view(document, image['bufferView'])[0]
  if content is None:
    return None
  if is_ktx2(content):
    raise UserError(
      f'its image {source} is in KTX2 format (Basis), which cannot be read; convert it, for example'
      ' with `gltf-transform ktxdecompress IN.glb OUT.glb`'
    )
  sampler = {}
  if 'sampler' in described:
    sampler = items(document, 'samplers')[described['sampler']]
  wrap = tuple(WRAPS.get(sampler.get(key, 10497), 'repeat') for key in ('wrapS', 'wrapT'))
  return Picture(content, f'its image {source}', mode, float(cutoff), wrap)


def _coordinates(document, texture, attributes, faces, notes):
  """[F, 3, 2], v up; None if the primitive has no such coordinates."""
  transform = texture.get('extensions', {}).get('KHR_texture_transform', {})
  name = f'TEXCOORD_{transform.get("texCoord", texture.get("texCoord", 0))}'
  if name not in attributes:
    notes.add(notes_lib.NO_COORDINATES)
    return None
  u, v = values(document, attributes[name])[:, :2].T
  (a, b), angle = transform.get('scale', (1, 1)), transform.get('rotation', 0)
  u, v = a * u, b * v
  cos, sin = np.cos(angle), np.sin(angle)
  u, v = cos * u + sin * v, cos * v - sin * u
  x, y = transform.get('offset', (0, 0))
  return np.stack([u + x, 1 - (v + y)], -1)[faces]
