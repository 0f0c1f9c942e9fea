"""A mesh file of any format that trimesh reads -> a coloured mesh, with the files that it names.

OBJ (+MTL), glTF and GLB, PLY, DAE, OFF and STL, from a folder or an archive (datagen/files.py).
Files are taken to be y up and facing +z, as glTF says and most OBJ files are; DAE files say which
axis is up and are turned accordingly.
"""

import io
import logging
import posixpath
import re
import warnings

import numpy as np
import trimesh

from cvn.errors import UserError
from datagen.files import Files, find
from datagen.mesh import TexturedMesh, check, from_trimesh

EXTENSIONS = ('.obj', '.glb', '.gltf', '.ply', '.dae', '.off', '.stl')

# What trimesh would print about a file either has no say in shape and colour or ends in an error.
logging.getLogger('trimesh').setLevel(logging.CRITICAL)


def read_mesh(files: Files, name: str) -> TexturedMesh:
  """Reads one mesh file; `missing` of the mesh lists the files that it names and that are not there.

  Args:
    files: the folder or archive that holds it and what it names.
    name: of the mesh file in it.

  Raises:
    UserError: the file cannot be read, or holds no mesh that can be normalised.
  """
  extension = posixpath.splitext(name)[1].lower()
  path = posixpath.join(files.path, name)
  try:
    content = files.read(name)
    resolver = _Resolver(files, posixpath.dirname(name))
    with warnings.catch_warnings():
      warnings.simplefilter('ignore')  # numpy's and PIL's about odd files
      # process=False: merging vertices would also merge their colours.
      scene = trimesh.load_scene(
        io.BytesIO(content), file_type=extension[1:], resolver=resolver, process=False
      )
      mesh = from_trimesh(scene, gltf=extension in ('.glb', '.gltf'))
    if extension == '.dae':
      mesh = _turn_up(mesh, content)
  except UserError:
    raise
  except FileNotFoundError as e:
    raise UserError(str(e)) from e
  except Exception as e:  # trimesh and its readers raise whatever a broken file leads them to
    raise UserError(f'{path} cannot be read as {extension[1:].upper()}: {_reason(e)}') from e
  try:
    check(mesh)
  except UserError as e:
    raise UserError(f'{path}: {e}{_compressed(content, extension)}') from e
  return mesh._replace(missing=tuple(sorted(resolver.missing)))


class _Resolver(trimesh.resolvers.Resolver):
  """Answers trimesh with the files that a mesh file names."""

  def __init__(self, files: Files, folder: str):
    self.files, self.folder = files, folder
    self.missing: set[str] = set()

  def get(self, name: str) -> bytes:
    """The content of the file called `name`, from the mesh file's folder."""
    # MTL options (`-s 1 1 1 wood.png`) stand before the name.
    plain = re.sub(r'^(-\w+(\s+(-?[\d.]+|on|off))+\s+)+', '', name.strip())
    try:
      return find(self.files, self.folder, plain)[1]
    except FileNotFoundError:
      self.missing.add(plain)
      raise

  def keys(self):
    """The names of all files."""
    return self.files.names(self.folder)

  def namespaced(self, namespace: str):
    """The resolver of a folder below."""
    return _Resolver(self.files, posixpath.join(self.folder, namespace))

  def write(self, name: str, data) -> None:
    """Nothing is written."""
    raise PermissionError(name)


def _turn_up(mesh, content):
  """A DAE file's `up_axis` becomes y."""
  up = re.search(rb'<up_axis>\s*([XYZ])_UP', content)
  if up is None or up[1] == b'Y':
    return mesh
  x, y, z = np.moveaxis(mesh.vertices, -1, 0)
  turned = (x, z, -y) if up[1] == b'Z' else (-y, x, z)
  return mesh._replace(vertices=np.stack(turned, -1))


def _reason(e):
  """One line about an exception."""
  text = ' '.join(str(e).split())
  return f'{type(e).__name__}: {text[:200]}' if text else type(e).__name__


def _compressed(content, extension):
  """A hint, where a glTF without geometry is one whose geometry trimesh cannot unpack."""
  if extension in ('.glb', '.gltf'):
    packing = re.search(rb'KHR_draco_mesh_compression|EXT_meshopt_compression', content)
    if packing:
      return f' that can be read: it is packed with {packing[0].decode()}; unpack it first'
  return ''
