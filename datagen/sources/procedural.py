"""Source `procedural`: objects built from a seed, so that everything runs without a download.

Model i of a category and seed is the same whatever the limit and the order, because its random
generator is seeded from (seed, category, i) alone. Objects are y up and face +z.
"""

import importlib
import zlib

import numpy as np

from cvn.errors import UserError
from datagen.geometry.mesh import TexturedMesh
from datagen.sources import SourceModel
from datagen.sources.shapes.parts import assemble

CATEGORIES = ('car', 'chair', 'guitar', 'human', 'table')
DEFAULT_LIMIT = 200  # models, where no limit is given: the source itself has no end


def list_models(
  category: str | None, input_dir: str | None, limit: int | None, seed: int
) -> list[SourceModel]:
  """The first `limit` models of a category.

  Args:
    category: one of `CATEGORIES`.
    input_dir: must be empty; nothing is read.
    limit: number of models; None means `DEFAULT_LIMIT`.
    seed: 0 or more; another seed gives other objects with other ids.

  Returns:
    Models in a stable order; a shorter list is the beginning of a longer one.

  Raises:
    UserError: an unknown category, a folder given, a negative seed or limit.
  """
  if category not in CATEGORIES:
    known = ', '.join(CATEGORIES)
    raise UserError(f'--source=procedural has no category {category!r}: choose one of {known}')
  if input_dir:
    raise UserError(f'--source=procedural reads no input: leave out --input={input_dir}')
  if seed < 0:
    raise UserError(f'the seed must be 0 or more, not {seed}')
  if limit is not None and limit < 1:
    raise UserError(f'the limit must be 1 or more, not {limit}')
  return [
    SourceModel(
      id=f'{category}-{seed}-{index:05d}',
      category=category,
      seed=_model_seed(seed, category, index),
      licence='MIT',
      creator='cvn procedural source',
    )
    for index in range(DEFAULT_LIMIT if limit is None else limit)
  ]


def load(model: SourceModel) -> TexturedMesh:
  """Builds a model's mesh from its seed."""
  shapes = importlib.import_module(f'datagen.sources.shapes.{model.category}')
  return assemble(shapes.build(np.random.default_rng(model.seed)))


def _model_seed(seed: int, category: str, index: int) -> int:
  """A separate 64-bit seed for each model."""
  entropy = np.random.SeedSequence([seed, zlib.crc32(category.encode()), index])
  return int(entropy.generate_state(1, np.uint64)[0])
