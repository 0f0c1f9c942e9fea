"""Source `meshes`: every mesh file of a folder and its subfolders (datagen/reading)."""

import os
import posixpath
import zlib
from collections import Counter

from cvn.errors import UserError
from datagen.geometry.mesh import TexturedMesh
from datagen.reading import EXTENSIONS, read_mesh
from datagen.reading.files import Files, folder_files
from datagen.sources import SourceModel

COMPANIONS = ('.mtl', '.png', '.jpg', '.jpeg', '.bin')  # of a mesh among others in a folder


def list_folders(
  category: str, input_dir: str, limit: int | None = None, seed: int = 0
) -> list[SourceModel]:
  """`list_models` of the subfolder that has the category's name.

  Raises:
    UserError: it does not exist, or holds no mesh file.
  """
  if (
    input_dir and os.path.isdir(input_dir) and not os.path.isdir(os.path.join(input_dir, category))
  ):
    raise UserError(
      f'{input_dir} has no subfolder {category}: several categories of --source=meshes are'
      ' subfolders of these names'
    )
  return list_models(category, input_dir, limit, seed, below=category)


def list_models(
  category: str, input_dir: str, limit: int | None = None, seed: int = 0, *, below: str = ''
) -> list[SourceModel]:
  """The folder's mesh files in the order of their ids.

  A file's id is its path below the folder without the extension, with `_` as separator; files that
  would share an id get a checksum of the whole path at the end.

  Args:
    category: the category of all these models.
    input_dir: the folder.
    limit: maximum number of models; None or 0 takes all.
    seed: unused.
    below: a subfolder, to list its files only.

  Raises:
    UserError: the folder does not exist or holds no mesh file.
  """
  del seed
  if not input_dir or not os.path.isdir(input_dir):
    given = f'--input={input_dir} is none' if input_dir else 'give it as --input=DIR'
    raise UserError(f'--source=meshes needs a folder of meshes: {given}')
  found = []
  for folder, folders, names in os.walk(os.path.join(input_dir, below)):
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
  chosen = sorted(ids.items(), key=lambda item: item[1])[: limit or None]
  files, alone = folder_files(input_dir), Counter(os.path.dirname(path) for path in ids)
  return [
    SourceModel(
      id=id,
      category=category,
      path=os.path.join(input_dir, path),
      detail=input_dir,
      content=_checksum(files, path.replace(os.sep, '/'), alone[os.path.dirname(path)] == 1),
    )
    for path, id in chosen
  ]


def _checksum(files: Files, name: str, alone: bool) -> str:
  """A checksum of a mesh file and the files that belong to it; '' if it cannot be read.

  To a mesh that is alone in its folder belongs everything there and below, except other meshes; to
  one among others, the files with its name and another extension.
  """
  folder, stem = posixpath.dirname(name), posixpath.splitext(name)[0]
  if alone and folder:
    names = [n for n in files.names(folder) if not n.lower().endswith(EXTENSIONS)]
  else:
    names = [f'{stem}{extension}' for extension in COMPANIONS]
  checksum = 0
  try:
    checksum = zlib.crc32(files.read(name))
    for other in names:
      try:
        content = files.read(other)
      except FileNotFoundError:
        continue
      checksum = zlib.crc32(content, zlib.crc32(other.encode(errors='replace'), checksum))
  except (UserError, FileNotFoundError):
    return ''  # whoever reads the mesh says why
  return f'{checksum:08x}'


def load(model: SourceModel) -> TexturedMesh:
  """Reads a mesh file.

  Raises:
    UserError: the file cannot be read, or holds no mesh that can be normalised.
  """
  folder = model.detail or os.path.dirname(model.path)
  name = os.path.relpath(model.path, folder).replace(os.sep, '/')
  return read_mesh(folder_files(folder), name)
