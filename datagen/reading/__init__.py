"""Mesh files and the files that they name -> coloured meshes.

Formats: OBJ (+MTL), glTF and GLB, PLY, DAE, OFF and STL, from a folder or an archive (files.py).
The reader of each format makes parts in one common form (parts.py); nothing after that depends on
the format. Files are taken to be y up and facing +z, as glTF specifies and as most OBJ files are.
DAE files state their up axis and are rotated accordingly.
"""

import io
import logging
import posixpath
import warnings

import numpy as np
import trimesh

from cvn.errors import UserError
from datagen.geometry.mesh import TexturedMesh, check
from datagen.reading import headers
from datagen.reading.colors import grey
from datagen.reading.dae import read_dae
from datagen.reading.files import Files
from datagen.reading.gltf import read_gltf
from datagen.reading.obj import read_obj
from datagen.reading.off import read_off
from datagen.reading.parts import Part, assemble
from datagen.reading.ply import read_ply
from datagen.reading.surroundings import Surroundings, find_named, surroundings

EXTENSIONS = ('.obj', '.glb', '.gltf', '.ply', '.dae', '.off', '.stl')

# What trimesh would print about a file either has no say in shape and colour or ends in an error.
logging.getLogger('trimesh').setLevel(logging.CRITICAL)


def read_mesh(files: Files, name: str) -> TexturedMesh:
  """Reads a mesh file.

  The result's `missing` lists files and materials that are named but do not exist, its `notes` what
  was ignored or guessed.

  Args:
    files: the folder or archive with the file and all files that it names.
    name: name of the mesh file.

  Raises:
    UserError: the file cannot be read, names a file outside of `files` or an unreadable image, or
      holds no mesh that can be normalised.
    MemoryError: it needs too much memory.
  """
  extension = posixpath.splitext(name)[1].lower()
  path = posixpath.join(files.path, name)
  around = surroundings(files, name)
  try:
    with warnings.catch_warnings():
      warnings.simplefilter('ignore')  # numpy's and PIL's about odd files
      mesh = assemble(_parts(files.read(name), extension, around), around.notes)
    if len(mesh.faces) > headers.MAX_FACES:
      raise UserError(f'it has {len(mesh.faces)} faces, more than {headers.MAX_FACES}')
    check(mesh)
  except (UserError, FileNotFoundError) as e:
    raise UserError(f'{path}: {e}') from e
  except MemoryError:
    raise
  except Exception as e:  # readers raise whatever a broken file leads them to
    raise UserError(f'{path} cannot be read as {extension[1:].upper()}: {_reason(e)}') from e
  return mesh._replace(missing=tuple(sorted(around.missing)), notes=tuple(sorted(around.notes)))


def _parts(content, extension, around):
  """The parts of a file of any format."""
  match extension:
    case '.obj':
      return [read_obj(content, around)]
    case '.ply':
      return [read_ply(content, around)]
    case '.off':
      return [read_off(content, around.notes)]
    case '.dae':
      headers.check_dae(content)
      return read_dae(content, around)
    case '.stl':
      return [_read_stl(content)]
    case _:
      return read_gltf(
        content,
        lambda uri: _needed(around, uri),
        lambda uri: (find_named(around, uri) or (None, None))[1],
        around.notes,
      )


def _needed(around: Surroundings, uri):
  """The content of a file that the mesh cannot do without."""
  found = find_named(around, uri)
  if found is None:
    raise UserError(f'it names {uri}, which does not exist')
  return found[1]


def _read_stl(content):
  """An STL file, without colours: programs disagree about their encoding."""
  # process=False: vertices stay as they are.
  mesh = trimesh.load_mesh(io.BytesIO(content), file_type='stl', process=False)
  faces = np.asarray(mesh.faces, np.int64)
  return Part(np.asarray(mesh.vertices, np.float64), faces, grey(len(faces)))


def _reason(e):
  """One line about an exception."""
  text = ' '.join(str(e).split())
  return f'{type(e).__name__}: {text[:200]}' if text else type(e).__name__
