r"""Source `shapenet`: ShapeNetCore, version 1 or 2, as downloaded.

`--input` is a folder with, for each category, a folder or a zip archive named after its WordNet
synset (`03001627` or `03001627.zip`); or it is one of these itself. Archives are read without
unpacking. Below the synset, each model has a folder whose name is the model's id, here as well:

  version 1: <synset>/<id>/model.obj
  version 2: <synset>/<id>/models/model_normalized.obj

The README of version 1 says that "the up direction is the +Y axis, and the front is the +X axis",
that of version 2 that the front "is the -Z axis". Models are turned to face +z.

Textures are beside the MTL file, in `../images` or elsewhere below the model's folder. MTL files
may name them by paths on their authors' machines (`C:\Users\...`). If a path leads to no file, a
file of the same name anywhere below the model's folder is taken.
"""

import contextlib
import functools
import os
import posixpath
import re

import numpy as np

from cvn.errors import UserError
from datagen.geometry.mesh import TexturedMesh
from datagen.reading import read_mesh
from datagen.reading.files import Files, archive_files, folder_files
from datagen.sources import SourceModel
from datagen.splits import SYNSETS

LICENCE = 'ShapeNet terms of use'
_V2 = 'models/model_normalized.obj'
_MESHES = (_V2, 'model.obj')  # in a model's folder, the better version first


def list_models(
  category: str, input_dir: str | None, limit: int | None = None, seed: int = 0
) -> list[SourceModel]:
  """The models of a category in the order of their ids.

  Every subfolder of a folder is taken to be a model, because checking fifty thousand of them takes
  long.

  Args:
    category: a key of `SYNSETS`, or the eight digits of any synset.
    input_dir: folder of ShapeNet.
    limit: maximum number of models; None or 0 takes all.
    seed: unused.

  Raises:
    UserError: no such category, or the input holds none of its models.
  """
  del seed
  synset = SYNSETS.get(category, category)
  if not re.fullmatch(r'\d{8}', synset):
    known = ', '.join(SYNSETS)
    raise UserError(
      f'ShapeNet has no category {category!r}: give {known}, or the eight digits of a synset'
    )
  names = {synset: name for name, synset in SYNSETS.items()}
  path = _find_synset(synset, input_dir)
  listed = _list_folder(path) if os.path.isdir(path) else _list_archive(path, synset)
  if not listed:
    raise UserError(f'{path} holds no model')
  models = [
    SourceModel(id, names.get(synset, synset), place, detail, licence=LICENCE)
    for id, (place, detail) in sorted(listed.items())
  ]
  return models[: limit or None]


def _find_synset(synset: str, input_dir: str | None) -> str:
  """The folder or archive of a synset."""
  if not input_dir or not os.path.exists(input_dir):
    given = f'--input={input_dir} is not there' if input_dir else 'give it as --input=DIR'
    raise UserError(f'--source=shapenet needs the folder of ShapeNetCore: {given}')
  below = [os.path.join(input_dir, name) for name in (synset, f'{synset}.zip')]
  for path in below:
    if os.path.exists(path):
      return path
  if os.path.basename(os.path.abspath(input_dir)) in (synset, f'{synset}.zip'):
    return input_dir
  raise UserError(f'{input_dir} has neither a folder {synset} nor an archive {synset}.zip')


def _list_folder(path: str) -> dict[str, tuple[str, None]]:
  """id -> (folder of the model, None)."""
  with os.scandir(path) as entries:
    return {
      entry.name: (entry.path, None)
      for entry in entries
      if entry.is_dir() and not entry.name.startswith('.')
    }


def _list_archive(path: str, synset: str) -> dict[str, tuple[str, str]]:
  """id -> (the archive, name of the mesh in it)."""
  meshes = '|'.join(map(re.escape, _MESHES))
  pattern = re.compile(rf'(?:(?:.*/)?{synset}/)?([^/.][^/]*)/({meshes})')
  listed = {}
  for name in _archive(path).names():
    match = pattern.fullmatch(name)
    if match and (match[1] not in listed or match[2] == _V2):
      listed[match[1]] = path, name
  return listed


def load(model: SourceModel) -> TexturedMesh:
  """Reads one model, turned to face +z.

  Raises:
    UserError: it has no mesh, or one that cannot be read or normalised.
  """
  if model.detail is not None:
    files, name = _archive(model.path), model.detail
  else:
    files = folder_files(model.path)
    there = [n for n in _MESHES if os.path.isfile(os.path.join(model.path, n))]
    if not there:
      raise UserError(f'{model.path} has neither {" nor ".join(_MESHES)}')
    name = there[0]
  is_v2 = posixpath.basename(name) == posixpath.basename(_V2)
  folder = posixpath.dirname(name)  # of the model, in version 2 one up
  mesh = read_mesh(_forgiving(files, posixpath.dirname(folder) if is_v2 else folder), name)
  x, y, z = np.moveaxis(mesh.vertices, -1, 0)
  turned = (-x, y, -z) if is_v2 else (-z, y, x)
  return mesh._replace(vertices=np.stack(turned, -1))


def _archive(path: str) -> Files:
  """The files of an archive."""
  return _opened(path)[1]


@functools.lru_cache(maxsize=2)  # a worker goes from one category to the next
def _opened(path: str) -> tuple[contextlib.ExitStack, Files]:
  """An archive that stays open: reading the table of its hundred thousand files takes seconds."""
  stack = contextlib.ExitStack()
  return stack, stack.enter_context(archive_files(path))


def _forgiving(files: Files, folder: str) -> Files:
  """The files, with a search by bare name for those that are not where they should be."""

  @functools.cache
  def places():
    names = sorted(files.names(folder), key=lambda name: -name.count('/'))  # the topmost one wins
    return {posixpath.basename(name).lower(): name for name in names}

  def read(name):
    try:
      return files.read(name)
    except (FileNotFoundError, UserError) as e:  # not there, or not below the model's folder
      place = places().get(posixpath.basename(name).lower())
      if place is None:
        raise FileNotFoundError(f'{files.path} has no file {name}') from e
      return files.read(place)

  return files._replace(read=read, alike=lambda _: None)
