"""A mesh file of any format that trimesh reads -> a coloured mesh, with the files that it names.

OBJ (+MTL), glTF and GLB, PLY, DAE, OFF and STL, from a folder or an archive (datagen/files.py).
Files are taken to be y up and facing +z, as glTF says and most OBJ files are; DAE files say which
axis is up and are turned accordingly.
"""

import io
import logging
import posixpath
import re
import urllib.parse
import warnings

import numpy as np
import trimesh

from cvn.errors import UserError
from datagen.files import Files, find
from datagen.from_trimesh import from_trimesh
from datagen.headers import MAX_FACES, check_dae, check_gltf
from datagen.images import check_image
from datagen.mesh import TexturedMesh, check
from datagen.mtl import plain_mtl
from datagen.obj import absolute_indices, without_normals
from datagen.polygons import cut_concave

EXTENSIONS = ('.obj', '.glb', '.gltf', '.ply', '.dae', '.off', '.stl')
GLTF = ('.glb', '.gltf')
UPRIGHT = {  # a DAE file's upward axis -> what turns it to y
  b'X': np.array([[0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]),
  b'Z': np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]]),
}

# What trimesh would print about a file either has no say in shape and colour or ends in an error.
logging.getLogger('trimesh').setLevel(logging.CRITICAL)


def read_mesh(files: Files, name: str) -> TexturedMesh:
  """Reads one mesh file; `missing` of the mesh lists the files that it names in vain.

  Args:
    files: the folder or archive that holds it and what it names.
    name: of the mesh file in it.

  Raises:
    UserError: the file cannot be read, names a file outside of `files` or a picture that cannot be
      read, or holds no mesh that can be normalised.
    MemoryError: it needs more than there is.
  """
  extension = posixpath.splitext(name)[1].lower()
  path = posixpath.join(files.path, name)
  resolver = _Resolver(files, posixpath.dirname(name))
  try:
    with warnings.catch_warnings():
      warnings.simplefilter('ignore')  # numpy's and PIL's about odd files
      mesh = from_trimesh(_load(files.read(name), extension, resolver), gltf=extension in GLTF)
    check(mesh)
  except (UserError, FileNotFoundError) as e:
    raise UserError(f'{path}: {e}') from e
  except MemoryError:
    raise
  except Exception as e:  # trimesh and its readers raise whatever a broken file leads them to
    raise UserError(f'{path} cannot be read as {extension[1:].upper()}: {_reason(e)}') from e
  return mesh._replace(missing=tuple(sorted(resolver.missing)))


def _load(content, extension, resolver):
  """The scene that trimesh makes of a file, with the checks that it does not make."""
  if extension in GLTF:
    check_gltf(content, resolver.get)
  elif extension == '.dae':
    check_dae(content)
  elif not _is_binary(content, extension):
    content = _as_utf8(content)
  if extension == '.ply':  # trimesh would make paths of edges, with room for each possible vertex
    content = content.replace(b'\nelement edge ', b'\nelement unused_edge ', 1)
  if extension == '.obj':
    content = cut_concave(without_normals(absolute_indices(content)))
  stream = _Once(content) if extension == '.obj' else io.BytesIO(content)
  up = re.search(rb'<up_axis>\s*([XZ])_UP', content) if extension == '.dae' else None
  del content
  # process=False: merging vertices would also merge their colours.
  scene = trimesh.load_scene(stream, file_type=extension[1:], resolver=resolver, process=False)
  if up:
    scene.apply_transform(UPRIGHT[up[1]])
  resolver.check()
  if extension not in GLTF:  # of which they have been checked
    resolver.check_pictures(but=1 if extension == '.obj' else 0)  # its MTL is the first
  parts = (scene.geometry[scene.graph[node][1]] for node in scene.graph.nodes_geometry)
  faces = sum(len(part.faces) for part in parts if isinstance(part, trimesh.Trimesh))
  if faces > MAX_FACES:
    raise UserError(f'it has {faces} faces, more than {MAX_FACES}')
  return scene


class _Once:
  """A stream that gives up what is read: of large texts trimesh needs the memory."""

  def __init__(self, content: bytes):
    self._content = content

  def read(self) -> bytes:
    """All of it."""
    content, self._content = self._content, b''
    return content


class _Resolver(trimesh.resolvers.Resolver):
  """Answers trimesh with the files that a mesh file names.

  trimesh goes on without a texture whatever the reason, so errors are kept and raised later.
  """

  def __init__(self, files: Files, folder: str):
    self.files, self.folder = files, folder
    self.missing: set[str] = set()
    self._contents: dict[str, bytes] = {}
    self._error: Exception | None = None

  def get(self, name: str) -> bytes:
    """The content of the file called `name`, from the mesh file's folder."""
    if name not in self._contents:
      try:
        self._contents[name] = self._find(name)
      except FileNotFoundError:
        raise
      except Exception as e:
        self._error = self._error or e
        raise
    return self._contents[name]

  def check(self) -> None:
    """Raises what went wrong."""
    if self._error is not None:
      raise self._error

  def check_pictures(self, but: int) -> None:
    """Looks at the files that were asked for, but for the first so many."""
    for name, content in list(self._contents.items())[but:]:
      try:
        check_image(content)
      except UserError as e:
        raise UserError(f'{name} {e}') from e

  def _find(self, name):
    # MTL options (`-s 1 1 1 wood.png`) stand before the name.
    plain = re.sub(r'^(-\w+(\s+(-?[\d.]+|on|off))+\s+)+', '', name.strip())
    for spelling in dict.fromkeys((plain, urllib.parse.unquote(plain))):  # glTF and DAE have URIs
      try:
        found, content = find(self.files, self.folder, spelling)
        return plain_mtl(_as_utf8(content)) if found.lower().endswith('.mtl') else content
      except FileNotFoundError:
        continue
    self.missing.add(plain)
    raise FileNotFoundError(f'it names {plain}, which is not there')

  def keys(self):
    """The names of all files."""
    return self.files.names(self.folder)

  def namespaced(self, namespace: str):
    """The resolver of a folder below."""
    return _Resolver(self.files, posixpath.join(self.folder, namespace))

  def write(self, name: str, data) -> None:
    """Nothing is written."""
    raise PermissionError(name)


def _is_binary(content, extension):
  """Whether a PLY or STL file is."""
  if extension == '.ply':
    return b'format ascii' not in content[:200]
  size = int.from_bytes(content[80:84], 'little')
  return extension == '.stl' and len(content) == 84 + 50 * size


def _as_utf8(text):
  """The bytes of a text; one that is not UTF-8 is taken as Latin-1, in which any bytes are text."""
  try:
    text.decode()
    return text
  except UnicodeDecodeError:
    return text.decode('latin-1').encode()


def _reason(e):
  """One line about an exception."""
  text = ' '.join(str(e).split())
  return f'{type(e).__name__}: {text[:200]}' if text else type(e).__name__
