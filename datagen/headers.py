"""What a mesh file says of its scene, looked at before a library follows it.

A library that reads what a stranger wrote makes room for all that is declared, and walks a scene
that has no end until memory has one.
"""

import base64
import json
import struct
from collections import defaultdict
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from xml.parsers import expat

from cvn.errors import UserError
from datagen.images import check_image

MAX_FACES = 20_000_000  # of a scene, each instance of a mesh counted
MAX_INSTANCES = 100_000  # of meshes in a DAE file, which does not say at once how large they are
MAX_DEPTH = 256  # of XML elements within one another
PACKED = {'KHR_draco_mesh_compression', 'EXT_meshopt_compression'}  # glTF that trimesh cannot read


def check_gltf(content: bytes, get: Callable[[str], bytes]) -> None:
  """Looks at a glTF or GLB file's header, and at the pictures of its base colours.

  Args:
    content: of the file.
    get: the content of a file that it names; FileNotFoundError where there is none.

  Raises:
    UserError: it is packed, its scene has no end or too many faces, it declares data that it has
      not, or a picture cannot be read.
    Exception: it is no such file.
  """
  header, blob = _gltf_chunks(content)
  packed = PACKED.intersection(header.get('extensionsRequired', []))
  if packed:
    raise UserError(f'its meshes are packed with {min(packed)}; unpack it first')
  accessors, meshes, nodes = (header.get(key, []) for key in ('accessors', 'meshes', 'nodes'))
  empty = sum(a['count'] for a in accessors if 'bufferView' not in a)
  if empty > MAX_FACES:  # they are zeros, for which room would be made
    raise UserError(f'it declares {empty} values and holds none')
  faces = [sum(_gltf_faces(p, accessors) for p in m['primitives']) for m in meshes]
  count = count_instances(
    {i: node.get('children', []) for i, node in enumerate(nodes)},
    {i: faces[node['mesh']] for i, node in enumerate(nodes) if 'mesh' in node},
  )
  if count > MAX_FACES:
    raise UserError(f'its scene has {count} faces, more than {MAX_FACES}')
  for index, picture in _gltf_pictures(header, blob, get):
    try:
      check_image(picture)
    except UserError as e:
      raise UserError(f'its image {index} {e}') from e


def check_dae(content: bytes) -> None:
  """Looks through a DAE file.

  Raises:
    UserError: it has a DOCTYPE, whose entities might unpack to anything; it is nested too deeply;
      its scene has no end or too many parts.
    expat.ExpatError: it is no XML.
  """
  parser = expat.ParserCreate()
  path: list[Hashable] = []  # the elements that are open; a node's is what it is called
  children, own = defaultdict(list), defaultdict(int)

  def start(tag, attributes):
    tag = tag.split(':')[-1]
    parent = next((p for p in reversed(path) if p is not None), None)
    key = attributes.get('id') or object() if tag == 'node' else None
    if key is not None:
      children[parent].append(key)
    elif tag == 'instance_node':
      children[parent].append(attributes.get('url', '')[1:])
    elif tag in ('instance_geometry', 'instance_controller'):
      own[parent] += 1
    path.append(key)
    if len(path) > MAX_DEPTH:
      raise UserError(f'its elements are nested more than {MAX_DEPTH} deep')

  def doctype(*_):
    raise UserError('it has a DOCTYPE, which no DAE file needs; remove it')

  parser.StartElementHandler = start
  parser.EndElementHandler = lambda _: path.pop()
  parser.StartDoctypeDeclHandler = doctype
  parser.Parse(content, True)
  count = count_instances(children, own)
  if count > MAX_INSTANCES:
    raise UserError(f'its scene has {count} parts, more than {MAX_INSTANCES}')


def count_instances(
  children: Mapping[Hashable, Sequence[Hashable]], own: Mapping[Hashable, int]
) -> int:
  """The most that any node of a scene holds, all below it counted as often as it is there.

  Args:
    children: node -> the nodes below it, one as often as it is used.
    own: node -> what it holds itself.

  Raises:
    UserError: a node is below itself.
  """
  totals: dict[Hashable, int] = {}
  for root in children:
    todo, open_nodes = [(root, False)], set()
    while todo:
      node, is_done = todo.pop()
      if is_done:
        open_nodes.remove(node)
        totals[node] = own.get(node, 0) + sum(totals[c] for c in children.get(node, ()))
      elif node in open_nodes:
        raise UserError('its scene has no end: a node is below itself')
      elif node not in totals:
        open_nodes.add(node)
        todo.append((node, True))
        todo += [(c, False) for c in children.get(node, ()) if c not in totals]
  return max(totals.values(), default=0)


def _gltf_chunks(content):
  """(header, binary chunk) of a glTF or GLB file."""
  if content[:4] != b'glTF':
    return _json_object(content), b''
  (size,) = struct.unpack_from('<I', content, 12)
  if 20 + size > len(content):
    raise UserError('its header is cut off')
  return _json_object(content[20 : 20 + size]), content[28 + size :]


def _json_object(text):
  value = json.loads(text)
  if not isinstance(value, dict):
    raise UserError('its header is no JSON object')
  return value


def _gltf_faces(primitive, accessors):
  """At least as many as a primitive has."""
  if 'indices' in primitive:
    corners = accessors[primitive['indices']]['count']
  else:
    corners = accessors[primitive['attributes']['POSITION']]['count']
  return corners // 3 if primitive.get('mode', 4) == 4 else corners


def _gltf_pictures(header, blob, get) -> Iterator[tuple[int, bytes]]:
  """The (index, content) of each image that a base colour is taken from, where it is there."""

  def read(uri):
    head, comma, packed = uri.partition('base64,')
    return base64.b64decode(packed) if comma else get(head)

  used = [header['textures'][t['index']] for t in _base_color_textures(header)]
  for index in {_image_of(texture) for texture in used} - {None}:
    image = header['images'][index]
    try:
      if 'uri' in image:
        yield index, read(image['uri'])
      else:
        view = header['bufferViews'][image['bufferView']]
        uri = header['buffers'][view['buffer']].get('uri')
        start = view.get('byteOffset', 0)
        yield index, (read(uri) if uri else blob)[start : start + view['byteLength']]
    except FileNotFoundError:
      continue  # who reads the file counts what is missing


def _base_color_textures(header):
  """The references to textures that colours are taken from, in either model of materials."""
  for material in header.get('materials', []):
    older = material.get('extensions', {}).get('KHR_materials_pbrSpecularGlossiness', {})
    for model in (material.get('pbrMetallicRoughness', {}), older):
      for name in ('baseColorTexture', 'diffuseTexture', 'specularGlossinessTexture'):
        if name in model:
          yield model[name]


def _image_of(texture):
  """The index of a texture's image, which an extension gives for WebP and Basis pictures."""
  sources = [texture, *texture.get('extensions', {}).values()]
  return next((s['source'] for s in sources if 'source' in s), None)
