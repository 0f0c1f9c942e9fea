"""Source `meshes`: every mesh file of a folder and its subfolders, read with trimesh.

OBJ (+MTL), glTF and GLB, PLY, DAE, OFF and STL. Files are taken to be y up and facing +z, as glTF
says and most OBJ files are; DAE files say which axis is up and are turned accordingly.
"""

import logging
import os
import re
import warnings
import zlib
from collections import Counter

import numpy as np
import trimesh

from cvn.errors import UserError
from datagen.mesh import TexturedMesh, check, from_trimesh
from datagen.sources import SourceModel

EXTENSIONS = ('.obj', '.glb', '.gltf', '.ply', '.dae', '.off', '.stl')

# What trimesh would print about a file either has no say in shape and colour or ends in an error.
logging.getLogger('trimesh').setLevel(logging.CRITICAL)


def list_models(
  category: str, input_dir: str, limit: int | None = None, seed: int = 0
) -> list[SourceModel]:
  """The folder's mesh files in the order of their ids.

  A file's id is its path below the folder, with `_` between the parts and without the extension;
  files that would share an id this way get a checksum of their whole path behind it.

  Args:
    category: what the caller calls them.
    input_dir: the folder.
    limit: take the first so many; None or 0 takes all.
    seed: not used, the files are what they are.

  Raises:
    UserError: the folder does not exist or holds no mesh file.
  """
  del seed
  if not input_dir or not os.path.isdir(input_dir):
    given = f'--input={input_dir} is none' if input_dir else 'give it as --input=DIR'
    raise UserError(f'--source=meshes needs a folder of meshes: {given}')
  found = []
  for folder, folders, names in os.walk(input_dir):
    folders[:] = [name for name in folders if not name.startswith('.')]
    for name in names:
      if name.lower().endswith(EXTENSIONS) and not name.startswith('.'):
        found.append(os.path.relpath(os.path.join(folder, name), input_dir))
  if not found:
    raise UserError(f'{input_dir} holds no mesh file ({" ".join(EXTENSIONS)})')
  ids = {path: os.path.splitext(path)[0].replace(os.sep, '_') for path in sorted(found)}
  shared = Counter(ids.values())
  for path, id in ids.items():
    if shared[id] > 1:
      ids[path] = f'{id}_{zlib.crc32(path.encode(errors="surrogateescape")):08x}'
  models = [
    SourceModel(id=id, category=category, path=os.path.join(input_dir, path))
    for path, id in sorted(ids.items(), key=lambda item: item[1])
  ]
  return models[: limit or None]


def load(model: SourceModel) -> TexturedMesh:
  """Reads one mesh file.

  Raises:
    UserError: the file cannot be read, or holds no mesh that can be normalised.
  """
  path = model.path
  extension = os.path.splitext(path)[1].lower()
  try:
    with warnings.catch_warnings():
      warnings.simplefilter('ignore')  # numpy's and PIL's about odd files
      # process=False: merging vertices would also merge their colours.
      scene = trimesh.load_scene(path, resolver=_Resolver(path, allow_anywhere=True), process=False)
      mesh = from_trimesh(scene, gltf=extension in ('.glb', '.gltf'))
    if extension == '.dae':
      mesh = _turn_up(mesh, path)
  except Exception as e:  # trimesh and its readers raise whatever a broken file leads them to
    raise UserError(f'{path} cannot be read as {extension[1:].upper()}: {_reason(e)}') from e
  try:
    check(mesh)
  except UserError as e:
    raise UserError(f'{path}: {e}{_compressed(path, extension)}') from e
  return mesh


class _Resolver(trimesh.resolvers.FilePathResolver):
  """trimesh's own way to find the files that a file names, forgiving Windows' habits."""

  def get(self, name: str) -> bytes:
    """The content of the file called `name`, from the mesh file's folder."""
    # MTL options (`-s 1 1 1 wood.png`) stand before the name.
    plain = re.sub(r'^(-\w+(\s+(-?[\d.]+|on|off))+\s+)+', '', name.strip()).replace('\\', '/')
    try:
      return super().get(plain)
    except FileNotFoundError:
      folder, wanted = os.path.split(os.path.join(self.parent, plain))
      for entry in sorted(os.listdir(folder)):
        if entry.lower() == wanted.lower():
          return super().get(os.path.join(folder, entry))
      raise


def _turn_up(mesh, path):
  """A DAE file's `up_axis` becomes y."""
  with open(path, 'rb') as f:
    up = re.search(rb'<up_axis>\s*([XYZ])_UP', f.read())
  if up is None or up[1] == b'Y':
    return mesh
  x, y, z = np.moveaxis(mesh.vertices, -1, 0)
  turned = (x, z, -y) if up[1] == b'Z' else (-y, x, z)
  return mesh._replace(vertices=np.stack(turned, -1))


def _reason(e):
  """One line about an exception."""
  text = ' '.join(str(e).split())
  return f'{type(e).__name__}: {text[:200]}' if text else type(e).__name__


def _compressed(path, extension):
  """A hint, where a glTF without geometry is one whose geometry trimesh cannot unpack."""
  if extension in ('.glb', '.gltf'):
    with open(path, 'rb') as f:
      packing = re.search(rb'KHR_draco_mesh_compression|EXT_meshopt_compression', f.read())
    if packing:
      return f' that can be read: it is packed with {packing[0].decode()}; unpack it first'
  return ''
