"""glTF files put together number by number, and what is read of them."""

import base64
import io
import json

import numpy as np
import PIL.Image

from cvn.errors import UserError
from datagen.geometry.mesh import albedo
from datagen.reading.gltf import read_gltf
from datagen.reading.parts import assemble

TRIANGLE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
UV = np.array([[0, 0], [1, 0], [0, 1]], np.float32)  # v down
CODES = {'i1': 5120, 'u1': 5121, 'i2': 5122, 'u2': 5123, 'u4': 5125, 'f4': 5126}
RED, GREEN, BLUE, WHITE = (255, 0, 0), (0, 255, 0), (0, 0, 255), (255, 255, 255)


def png(*colors, mode='RGB'):
  """A picture of a row of 8x8 pixels for each colour."""
  pixels = np.repeat(np.repeat(np.array([colors], np.uint8), 8, 0), 8, 1)
  stream = io.BytesIO()
  PIL.Image.fromarray(pixels, mode).save(stream, 'PNG')
  return stream.getvalue()


class Builder:
  """Puts a glTF file together, its numbers in one buffer."""

  def __init__(self, **header):
    self.header, self.data = {'asset': {'version': '2.0'}, 'accessors': [], **header}, b''
    self.header['bufferViews'] = []

  def view(self, content):
    self.data += bytes(-len(self.data) % 4)
    described = {'buffer': 0, 'byteOffset': len(self.data), 'byteLength': len(content)}
    self.header['bufferViews'].append(described)
    self.data += content
    return len(self.header['bufferViews']) - 1

  def accessor(self, values, **more):
    values = np.asarray(values)
    kind = {1: 'SCALAR', 2: 'VEC2', 3: 'VEC3', 4: 'VEC4', 16: 'MAT4'}[
      1 if values.ndim == 1 else values[0].size
    ]
    code = CODES[values.dtype.str[1:]]
    described = {'componentType': code, 'count': len(values), 'type': kind, **more}
    if 'sparse' not in more:
      described['bufferView'] = self.view(np.ascontiguousarray(values).tobytes())
    self.header['accessors'].append(described)
    return len(self.header['accessors']) - 1

  def picture(self, content, **texture):
    for key in ('images', 'textures'):
      self.header.setdefault(key, [])
    self.header['images'].append({'bufferView': self.view(content), 'mimeType': 'image/png'})
    self.header['textures'].append({'source': len(self.header['images']) - 1, **texture})
    return len(self.header['textures']) - 1

  def json(self):
    uri = 'data:application/octet-stream;base64,' + base64.b64encode(self.data).decode()
    self.header['buffers'] = [{'byteLength': len(self.data), 'uri': uri}]
    return json.dumps(self.header).encode()


def nothing(name):
  raise UserError(f'{name} does not exist')


def read(content, get_picture=lambda uri: None):
  noted = set()
  content = content.json() if isinstance(content, Builder) else content
  mesh = assemble(read_gltf(content, nothing, get_picture, noted), noted)
  return mesh, noted


def one(b, attributes=None, nodes=None, **primitive):
  """The builder with one mesh of one primitive."""
  if attributes is None or 'POSITION' not in attributes:
    attributes = {'POSITION': b.accessor(TRIANGLE)} | (attributes or {})
  b.header['meshes'] = [{'primitives': [{'attributes': attributes, **primitive}]}]
  b.header.setdefault('nodes', [{'mesh': 0}] if nodes is None else nodes)
  return b


def textured(uv=UV, picture=None, texture=None, material=None, **attributes):
  """A triangle with a picture that is red on the left and green on the right."""
  b = Builder()
  index = b.picture(png(RED, GREEN) if picture is None else picture)
  model = {'baseColorTexture': {'index': index, **(texture or {})}}
  b.header['materials'] = [{'pbrMetallicRoughness': model, **(material or {})}]
  attributes = {
    'TEXCOORD_0': b.accessor(np.asarray(uv, np.float32)),
    **{k: b.accessor(v) for k, v in attributes.items()},
  }
  return one(b, attributes, material=0)


def colors(mesh, *weights):
  """Albedo of the first face at some places, 0..255."""
  return [
    (255 * albedo(mesh, np.array([0]), np.array([w], float))[0]).round().astype(int)[:3].tolist()
    for w in weights
  ]


LEFT, RIGHT = (0.7, 0.1, 0.2), (0.1, 0.8, 0.1)  # weights of places by the picture's halves


def linear(srgb):
  x = np.array(srgb) / 255
  return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)
