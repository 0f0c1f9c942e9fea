"""glTF 2.0 and GLB -> parts, one for each primitive: float attributes, in world coordinates.

The shape is that of the file's default scene without animation: node transforms, skins and morph
weights as they are written. `UNDERSTOOD` lists the supported extensions; a file that requires
another one is refused with its name.
"""

import json
import struct
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from cvn.errors import UserError
from datagen.reading import notes as notes_lib
from datagen.reading.gltf_accessors import Document, items, packed, raw_values, values
from datagen.reading.gltf_materials import appearance
from datagen.reading.gltf_pose import instances, joint_matrices, local, skinned, worlds
from datagen.reading.headers import MAX_FACES, count_instances
from datagen.reading.parts import Part, placed

PACKED = ('KHR_draco_mesh_compression', 'EXT_meshopt_compression', 'KHR_meshopt_compression')
BASIS = 'KHR_texture_basisu'
UNDERSTOOD = frozenset(
  (
    'KHR_texture_transform KHR_mesh_quantization EXT_mesh_gpu_instancing EXT_texture_webp'
    ' EXT_texture_avif KHR_materials_pbrSpecularGlossiness KHR_materials_unlit KHR_node_visibility'
    # What has no say in shape and albedo:
    ' KHR_lights_punctual KHR_materials_anisotropy KHR_materials_clearcoat KHR_materials_dispersion'
    ' KHR_materials_emissive_strength KHR_materials_ior KHR_materials_iridescence'
    ' KHR_materials_sheen KHR_materials_specular KHR_materials_transmission KHR_materials_variants'
    ' KHR_materials_volume KHR_animation_pointer KHR_xmp_json_ld KHR_xmp EXT_lights_image_based'
    ' EXT_mesh_features EXT_structural_metadata EXT_instance_features MSFT_lod'
  ).split()
)
TRIANGLES, STRIP, FAN = 4, 5, 6  # modes of primitives; those before are points and lines
CONVERT = 'convert it, for example with `gltf-pipeline -i IN.gltf -o OUT.glb`'


def read_gltf(
  content: bytes,
  get: Callable[[str], bytes],
  get_picture: Callable[[str], bytes | None],
  notes: set[str],
) -> Iterator[Part]:
  """The parts of the default scene.

  Args:
    content: the file's bytes.
    get: returns the content of a file that it names, or raises UserError.
    get_picture: the same for an image; returns None if it does not exist.
    notes: set that gets notes of what is ignored.

  Raises:
    UserError: it is not glTF 2.0, requires an unsupported extension, has an endless scene or too
      many faces, declares data that are missing, or has an unreadable image.
    Exception: it is not such a file.
  """
  header, blob = _chunks(content)
  document = Document(header, blob, get, {})
  _check_version(header, notes)
  nodes = items(document, 'nodes')
  roots = _roots(document)
  _check_size(document, roots)
  world_of = worlds(document)
  uses = Counter(node.get('mesh') for node in nodes)
  known: dict[tuple[int, Any, Any], list[Part]] = {}  # of meshes that are there again
  todo = [(root, np.eye(4)) for root in reversed(roots)]
  while todo:
    index, parent = todo.pop()
    node = nodes[index]
    extensions = node.get('extensions', {})
    if extensions.get('KHR_node_visibility', {}).get('visible', True) is False:
      continue
    world = parent @ local(node)
    todo += [(child, world) for child in reversed(node.get('children', []))]
    if 'mesh' not in node:
      continue
    weights = node.get('weights')
    skin = node.get('skin')
    key = (node['mesh'], None if weights is None else tuple(weights), skin)
    parts = known.get(key)
    if parts is None:
      mesh = items(document, 'meshes')[node['mesh']]
      weights = mesh.get('weights', []) if weights is None else weights
      joints = None if skin is None else joint_matrices(document, skin, world_of)
      made = (
        _part(document, primitive, weights, joints, get_picture, notes)
        for primitive in mesh['primitives']
      )
      parts = [part for part in made if part is not None]
      if uses[node['mesh']] > 1:
        known[key] = parts
    places = [np.eye(4) if skin is not None else world]  # a skinned mesh goes with its joints
    if 'EXT_mesh_gpu_instancing' in extensions:
      places = [world @ m for m in instances(document, extensions['EXT_mesh_gpu_instancing'])]
    for place in places:
      for part in parts:
        yield placed(part, place)


def _chunks(content):
  """(header, binary chunk) of a glTF or GLB file."""
  if content[:4] != b'glTF':
    return _json_object(content), b''
  version, size = struct.unpack_from('<I4xI', content, 4)
  if version == 1:
    raise UserError(f'it is glTF 1.0, not 2.0: {CONVERT}')
  if 20 + size > len(content):
    raise UserError('its header is cut off')
  return _json_object(content[20 : 20 + size]), content[28 + size :]


def _json_object(text):
  value = json.loads(text)
  if not isinstance(value, dict):
    raise UserError('its header is not a JSON object')
  return value


def _check_version(header, notes):
  version = str(header.get('asset', {}).get('version', '2.0'))
  if not version.startswith('2') or isinstance(header.get('meshes', []), dict):
    raise UserError(f'it is glTF {version if version[:1] != "2" else "1.0"}, not 2.0: {CONVERT}')
  required = [str(name) for name in header.get('extensionsRequired', [])]
  for name in required:
    if name in PACKED:
      raise UserError(packed(name))
    if name == BASIS:
      raise UserError(
        f'its textures are KTX2 images ({BASIS}), which cannot be read; convert them, for example'
        ' with `gltf-transform ktxdecompress IN.glb OUT.glb`'
      )
    if name not in UNDERSTOOD:
      raise UserError(f'it requires the extension {name}, which is not supported')
  for name in header.get('extensionsUsed', []):
    if name not in UNDERSTOOD and name not in (*PACKED, BASIS):
      notes.add(notes_lib.EXTENSION_IGNORED)


def _roots(document):
  """The nodes of the default scene; without scenes, the nodes that are no other node's children."""
  scenes, nodes = items(document, 'scenes'), items(document, 'nodes')
  if scenes:
    return scenes[document.header.get('scene', 0)].get('nodes', [])
  below = {child for node in nodes for child in node.get('children', [])}
  return [n for n in range(len(nodes)) if n not in below]


def _check_size(document, roots):
  """Counts the faces of the scene before any memory is allocated for them."""
  accessors = items(document, 'accessors')
  faces = [
    sum(_count_faces(p, accessors) for p in mesh['primitives'])
    for mesh in items(document, 'meshes')
  ]
  children: dict[Any, list[int]] = {'scene': roots}
  own = {}
  for n, node in enumerate(items(document, 'nodes')):
    children[n] = node.get('children', [])
    if 'mesh' in node:
      instancing = node.get('extensions', {}).get('EXT_mesh_gpu_instancing', {})
      attributes = instancing.get('attributes', {}).values()
      times = max((accessors[a]['count'] for a in attributes), default=1)
      own[n] = faces[node['mesh']] * times
  count = count_instances(children, own)
  if count > MAX_FACES:
    raise UserError(f'its scene has {count} faces, more than {MAX_FACES}')


def _count_faces(primitive, accessors):
  """A lower bound of the number of faces of a primitive."""
  name = primitive.get('indices', primitive['attributes'].get('POSITION'))
  corners = 0 if name is None else accessors[name]['count']
  return corners // 3 if primitive.get('mode', TRIANGLES) == TRIANGLES else corners


def _part(document, primitive, weights, joints, get_picture, notes):
  """A primitive's part in its mesh's frame (with joints, in the world's); None without faces."""
  attributes, mode = primitive['attributes'], primitive.get('mode', TRIANGLES)
  if mode < TRIANGLES:
    notes.add(notes_lib.NOT_TRIANGLES)
    return None
  accessors = items(document, 'accessors')
  if (
    'KHR_draco_mesh_compression' in primitive.get('extensions', {})
    and 'bufferView' not in (accessors[attributes['POSITION']])
  ):
    raise UserError(packed('KHR_draco_mesh_compression'))
  if 'POSITION' not in attributes:
    return None
  vertices = values(document, attributes['POSITION'])
  for weight, target in zip(weights, primitive.get('targets', []), strict=False):
    if weight and 'POSITION' in target:
      vertices = vertices + weight * values(document, target['POSITION'])
      notes.add(notes_lib.POSE)
  if joints is not None:
    vertices = skinned(document, attributes, vertices, joints)
    notes.add(notes_lib.POSE)
  corners = np.arange(len(vertices))
  if 'indices' in primitive:
    corners = raw_values(document, primitive['indices'])[:, 0].astype(np.int64)
  faces = _triangles(corners, mode)
  if len(faces) and faces.max() >= len(vertices):
    raise UserError(f'a face names a vertex that is out of bounds: there are {len(vertices)}')
  colors, uv, picture = appearance(document, primitive, faces, get_picture, notes)
  texture = None if picture is None else np.zeros(len(faces), np.int32)
  return Part(vertices, faces, colors, uv, texture, () if picture is None else (picture,))


def _triangles(corners, mode):
  """[F, 3] of a list of corners: triangles, a strip or a fan."""
  if mode == STRIP:
    faces = np.stack([corners[:-2], corners[1:-1], corners[2:]], 1)
    faces[1::2] = faces[1::2][:, [1, 0, 2]]
    return faces
  if mode == FAN:
    return np.stack([np.broadcast_to(corners[:1], len(corners[2:])), corners[1:-1], corners[2:]], 1)
  return corners[: len(corners) // 3 * 3].reshape(-1, 3)
