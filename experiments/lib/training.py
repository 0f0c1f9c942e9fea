"""The settings of experiments.train: its flags, what they make of a recipe, and what is stored.

What is stored identifies a run: a training goes on, and is reused, only where all of
it is the same.
"""

import math
import os
from collections import Counter
from collections.abc import Sequence
from typing import Any

from absl import flags

from cvn import checkpoint, data, losses, sampler
from cvn import recipe as recipes
from cvn.dataset import Dataset, digest, open_dataset
from cvn.errors import UserError
from cvn.networks import NETWORKS
from cvn.ops import native
from cvn.recipe import RECIPES, Recipe

SHAPE_LOSSES = {'msfcel': losses.msfcel, 'cross_entropy': losses.cross_entropy}
SURFACE_DISTANCES = {
  'l2': losses.surface_l2,
  'l1': losses.surface_l1,
}
DTYPES = ('float32', 'mixed')
DTYPE_CHOICES = ('auto', *DTYPES)
HEADS = ('dense', 'surface')
SAMPLERS = {
  'bilinear': sampler.bilinear,
  'nearest': sampler.nearest,
  'foreground': sampler.bilinear_foreground,
}
PARTS = {  # of a recipe, by the names that flags and configurations have for them
  'shape_loss': SHAPE_LOSSES,
  'surface_distance': SURFACE_DISTANCES,
  'sample': SAMPLERS,
  'schedule': recipes.SCHEDULES,
}


def define_flags(f: flags.FlagValues) -> None:
  """The program's flags. Not at import: there the names of several programs would collide."""
  own = {'flag_values': f}
  flags.DEFINE_enum('network', None, [*NETWORKS], 'Which network.', **own)
  flags.DEFINE_enum('recipe', 'paper', sorted(RECIPES), 'What to follow where they differ.', **own)
  flags.DEFINE_enum(
    'shape_loss', None, [*SHAPE_LOSSES], "Of shapes, instead of the recipe's.", **own
  )
  flags.DEFINE_enum(
    'surface_distance',
    None,
    [*SURFACE_DISTANCES],
    "Of colours and flow, instead of the recipe's.",
    **own,
  )
  flags.DEFINE_enum(
    'dtype',
    'auto',
    DTYPE_CHOICES,
    'Type of the volumes that the 3D layers multiply. mixed: bfloat16, while sums, statistics,'
    ' parameters and optimizer stay float32. auto: what the run in --workdir was begun with; in a'
    ' new run the faster type, which is mixed on accelerators, and on a CPU what was measured for'
    ' its compiled kernels.',
    **own,
  )
  flags.DEFINE_enum(
    'heads',
    'dense',
    HEADS,
    "Where the colour network's last layers are computed in training; surface: at surface voxels"
    ' and their neighbours alone, which is faster, and takes batch statistics there.',
    **own,
  )
  flags.DEFINE_string('data', None, 'The data set: a folder or URL of datagen.generate.', **own)
  flags.DEFINE_string('workdir', None, "The run's folder.", **own)
  flags.DEFINE_list('category', [], 'Categories to train on; all of them by default.', **own)
  flags.DEFINE_list('source', [], 'Sources of models to train on; all by default.', **own)
  flags.DEFINE_list('validation_source', [], 'Sources of models to validate on; all.', **own)
  flags.DEFINE_integer('epochs', 500, 'Epochs in all.', lower_bound=1, **own)
  flags.DEFINE_integer('batch_size', 60, 'Views a step.', lower_bound=1, **own)
  flags.DEFINE_float('learning_rate', None, "The first one, instead of the recipe's.", **own)
  flags.DEFINE_enum(
    'schedule',
    None,
    [*recipes.SCHEDULES],
    "Of the learning rate, instead of the recipe's: cosine ends at 0 with the last epoch.",
    **own,
  )
  flags.DEFINE_enum(
    'sample',
    None,
    [*SAMPLERS],
    'How colours are sampled in training, instead of as the recipe does; foreground: the ground is'
    ' filled with the nearest pixels of the object, as at test time.',
    **own,
  )
  flags.DEFINE_bool(
    'mirror',
    None,
    'Whether half of the views are mirrored, each with its object, instead of as the recipe says.',
    **own,
  )
  flags.DEFINE_bool(
    'recolor',
    None,
    'Whether objects are painted in other colours at random, in views and on surfaces, instead of'
    ' as the recipe says.',
    **own,
  )
  flags.DEFINE_integer(
    'fresh_statistics',
    0,
    'Training batches over which the statistics of the normalisations are taken anew for'
    ' validation and at the end; 0 keeps running ones. Small batches and short trainings need it.',
    lower_bound=0,
    **own,
  )
  flags.DEFINE_integer('seed', 0, 'Of everything random.', 0, 2**32 - 1, **own)
  flags.DEFINE_integer('log_every', 10, 'Steps between lines of the log.', lower_bound=1, **own)
  flags.DEFINE_integer('validate_every', 10, 'Epochs between validations.', lower_bound=1, **own)
  flags.DEFINE_integer('validation_views', 120, 'At most, each time.', lower_bound=1, **own)
  flags.DEFINE_float('checkpoint_every', 5, 'Minutes between checkpoints.', 0, **own)
  flags.mark_flags_as_required(['network', 'data', 'workdir'], f)
  flags.register_validator(
    'learning_rate', lambda x: x is None or 0 < x < math.inf, 'must be above 0', f
  )


def resolve_dtype(f: flags.FlagValues) -> None:
  """Replaces --dtype=auto by what it comes to, so that this is what is stored; prints why.

  Raises:
    UserError: --workdir holds a run whose settings cannot be read.
  """
  if f.dtype != 'auto':
    return
  if os.path.lexists(os.path.join(f.workdir, 'config.json')):
    stored = checkpoint.read_config(f.workdir)
    f.dtype, why = stored.get('dtype', 'float32'), f'{f.workdir} was begun with it'
  else:
    f.dtype, why = native.faster_dtype()
  print(f'--dtype=auto is {f.dtype}: {why}')


def make_recipe(f: flags.FlagValues) -> Recipe:
  """The recipe that the flags name, with what they change in it."""
  names = (*PARTS, 'learning_rate', 'mirror', 'recolor')
  asked = {name: f[name].value for name in names if f[name].value is not None}
  chosen = {name: PARTS[name][x] if name in PARTS else x for name, x in asked.items()}
  return RECIPES[f.recipe]._replace(**chosen)


def configuration(**named: Any) -> dict[str, Any]:
  """What the program stores as the configuration of a run when it is started with some flags."""
  f = flags.FlagValues()
  define_flags(f)
  f(['train', *(f'--{k}={v}' for k, v in named.items())])
  resolve_dtype(f)
  dataset = open_dataset(f.data)
  rows = data.select_rows(dataset, 'train', categories=f.category, sources=f.source)
  return make_config(f, make_recipe(f), dataset, rows)


def make_config(
  f: flags.FlagValues, recipe: Recipe, dataset: Dataset, rows: Sequence[int]
) -> dict[str, Any]:
  """All that a resumed run must share with the one it continues, and that a reused one must have.

  The recipe's parts are told one by one, so that a recipe of the same name that has changed since
  is another one. `counts` is how many models of each category and source there are.
  """
  models = [dataset.manifest.models[row] for row in rows]
  counts = Counter(f'{m.category} ({m.source})' for m in models)
  names = ('network', 'dtype', 'heads', 'category', 'source')
  names += ('batch_size', 'fresh_statistics', 'seed')
  config = {
    'data': dataset.root,
    'data_digest': digest(dataset, rows),
    'models': len(models),
    'counts': dict(counts),
    'categories': sorted({m.category for m in models}),
    **{n: f[n].value for n in names},
    **describe_recipe(recipe),
  }
  # A schedule that ends with the training is another one where that is longer.
  return config | ({'epochs': f.epochs} if recipe.schedule is recipes.cosine else {})


def describe_recipe(recipe: Recipe) -> dict[str, Any]:
  """The recipe as JSON values: its parts by their names."""
  names = {part: name for parts in PARTS.values() for name, part in parts.items()}
  told = {k: names[v] if k in PARTS else v for k, v in recipe._asdict().items()}
  return {'recipe': told.pop('name'), **told}


def is_finished(workdir: str, step: int, steps_per_epoch: int, epochs: int) -> bool:
  """Whether a run has come to the end of its epochs.

  Raises:
    UserError: it has gone further.
  """
  if step > epochs * steps_per_epoch:
    done = f'{step / steps_per_epoch:.4g}' if steps_per_epoch else 'more'
    raise UserError(
      f'{workdir} was trained for epochs={done}, not {epochs}: ask for more --epochs, name another'
      f' --workdir, or delete {workdir}'
    )
  return step == epochs * steps_per_epoch
