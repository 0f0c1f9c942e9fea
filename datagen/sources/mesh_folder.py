"""Source `meshes`: every mesh file of a folder and its subfolders (datagen/reading)."""

import os
import zlib
from collections import Counter

from cvn.errors import UserError
from datagen.mesh import TexturedMesh
from datagen.reading import EXTENSIONS, read_mesh
from datagen.reading.files import folder_files
from datagen.sources import SourceModel


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
    SourceModel(id=id, category=category, path=os.path.join(input_dir, path), detail=input_dir)
    for path, id in sorted(ids.items(), key=lambda item: item[1])
  ]
  return models[: limit or None]


def load(model: SourceModel) -> TexturedMesh:
  """Reads one mesh file.

  Raises:
    UserError: the file cannot be read, or holds no mesh that can be normalised.
  """
  folder = model.detail or os.path.dirname(model.path)
  name = os.path.relpath(model.path, folder).replace(os.sep, '/')
  return read_mesh(folder_files(folder), name)
