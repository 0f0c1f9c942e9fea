"""Sources of meshes: one module each, all with the same two functions.

`list_models(category, input_dir, limit, seed) -> list[SourceModel]` lists the models, quickly and
in a stable order; `load(model) -> TexturedMesh` makes or reads one of them, not yet normalised.
Both raise `UserError` for problems that the user can solve. A source of records instead of meshes
has `read_record(model, azimuths=, image_size=, grid_size=) -> Record` instead of `load`.
"""

import importlib
from types import ModuleType
from typing import Any, NamedTuple

SOURCES = {
  'humans': 'datagen.sources.humans',
  'im2avatar_release': 'datagen.sources.im2avatar_release',
  'meshes': 'datagen.sources.mesh_folder',
  'procedural': 'datagen.sources.procedural',
  'shapenet': 'datagen.sources.shapenet',
  'sweethome3d': 'datagen.sources.sweethome3d',
}


class SourceModel(NamedTuple):
  """Everything that a worker process needs to make one model's mesh; it can be pickled."""

  id: str  # unique in its data set, stable between runs, fit for a file's name
  category: str
  path: str = ''  # the file it is read from; '' where there is none
  detail: Any = None  # what else its source must know to load it
  seed: int = 0  # what a made-up model is made from
  split: str = ''  # 'train', 'val' or 'test' where the source itself says so
  licence: str = ''  # as the source states it; '' where it does not
  creator: str = ''
  content: str = ''  # a checksum of its files where these may change; '' otherwise
  up: str = 'y'  # what points up in its file, a key of datagen.placement.UPS
  turn: float = 0.0  # degrees by which it is turned then, anticlockwise seen from above


def source(name: str) -> ModuleType:
  """The module of a source, given a key of `SOURCES`."""
  return importlib.import_module(SOURCES[name])
