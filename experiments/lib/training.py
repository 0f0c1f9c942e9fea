"""The settings of experiments.train: its flags, the recipe they make, and the stored configuration.

The configuration identifies a run: a training continues, and is reused, only if all of it is the
same.
"""

import math
import os
from collections import Counter
from collections.abc import Sequence
from typing import Any, NamedTuple

from absl import flags

from cvn import checkpoint, data, losses, sampler
from cvn import recipe as recipes
from cvn.dataset import Dataset, digest, open_dataset
from cvn.errors import UserError
from cvn.networks import NETWORKS
from cvn.ops import native
from cvn.recipe import RECIPES, Recipe
from experiments.lib import cli, sessions

SHAPE_LOSSES = {'msfcel': losses.msfcel, 'cross_entropy': losses.cross_entropy}
SURFACE_DISTANCES = {
  'l2': losses.surface_l2,
  'l1': losses.surface_l1,
}
DTYPES = ('float32', 'mixed')
DTYPE_CHOICES = ('auto', *DTYPES)
HEADS = ('dense', 'surface')
RESTORES = ('newest', 'last_good')
SAMPLERS = {
  'bilinear': sampler.bilinear,
  'nearest': sampler.nearest,
  'foreground': sampler.bilinear_foreground,
}
PARTS = {  # of a recipe, by their names in flags and configurations
  'shape_loss': SHAPE_LOSSES,
  'surface_distance': SURFACE_DISTANCES,
  'sample': SAMPLERS,
  'schedule': recipes.SCHEDULES,
}


class Settings(NamedTuple):
  """A training; see the flags of the same names. None stands for the recipe's own choice."""

  network: str
  recipe: str
  shape_loss: str | None
  surface_distance: str | None
  sample: str | None
  schedule: str | None
  learning_rate: float | None
  mirror: bool | None
  recolor: bool | None
  dtype: str
  heads: str
  data: str
  workdir: str
  category: list[str]
  source: list[str]
  validation_source: list[str]
  epochs: int
  batch_size: int
  fresh_statistics: int
  seed: int
  log_every: int
  validate_every: int
  validation_views: int
  checkpoint_every: float
  parts: int


def define_flags(f: flags.FlagValues) -> None:
  own = {'flag_values': f}
  flags.DEFINE_enum('network', None, [*NETWORKS], 'Network to train.', **own)
  flags.DEFINE_enum(
    'recipe', 'paper', sorted(RECIPES), "Recipe: the paper's, its program's, or our best.", **own
  )
  flags.DEFINE_enum(
    'shape_loss', None, [*SHAPE_LOSSES], "Loss of shapes, instead of the recipe's.", **own
  )
  flags.DEFINE_enum(
    'surface_distance',
    None,
    [*SURFACE_DISTANCES],
    "Distance of colours and flow, instead of the recipe's.",
    **own,
  )
  flags.DEFINE_enum(
    'dtype',
    'auto',
    DTYPE_CHOICES,
    'Type of the volumes in the products of 3D layers. mixed: bfloat16, while sums, statistics,'
    ' parameters and optimizer stay float32. auto: the type of the run in --workdir; for a new run'
    ' the faster type, which is mixed on accelerators and measured on a CPU.',
    **own,
  )
  flags.DEFINE_enum(
    'heads',
    'dense',
    HEADS,
    "Where the colour network's last layers are computed in training. surface: only at surface"
    ' voxels and their neighbours, which is faster and takes batch statistics there.',
    **own,
  )
  flags.DEFINE_string('data', None, 'Data set: a folder or URL of datagen.generate.', **own)
  flags.DEFINE_string('workdir', None, 'Folder of the run.', **own)
  flags.DEFINE_list('category', [], 'Categories to train on; all by default.', **own)
  flags.DEFINE_list('source', [], 'Sources of models to train on; all by default.', **own)
  flags.DEFINE_list(
    'validation_source', [], 'Sources of models to validate on; all by default.', **own
  )
  flags.DEFINE_integer('epochs', 500, 'Epochs in all.', lower_bound=1, **own)
  flags.DEFINE_integer('batch_size', 60, 'Views in a step.', lower_bound=1, **own)
  flags.DEFINE_float('learning_rate', None, "First learning rate, instead of the recipe's.", **own)
  flags.DEFINE_enum(
    'schedule',
    None,
    [*recipes.SCHEDULES],
    "Learning-rate schedule, instead of the recipe's; cosine ends at 0 with the last epoch.",
    **own,
  )
  flags.DEFINE_enum(
    'sample',
    None,
    [*SAMPLERS],
    "Colour sampling in training, instead of the recipe's. foreground: the background is filled"
    ' with the nearest pixels of the object, as at test time.',
    **own,
  )
  flags.DEFINE_bool(
    'mirror', None, "Horizontal-flip augmentation of half of the views, or the recipe's.", **own
  )
  flags.DEFINE_bool(
    'recolor', None, "Colour augmentation of views and surfaces, or the recipe's.", **own
  )
  flags.DEFINE_integer(
    'fresh_statistics',
    0,
    'Training batches for batch-norm recalibration before validation and at the end; 0 keeps the'
    ' running statistics. Small batches and short trainings need it.',
    lower_bound=0,
    **own,
  )
  flags.DEFINE_integer(
    'seed', 0, 'Random seed for initialisation, shuffling and augmentation.', 0, 2**32 - 1, **own
  )
  flags.DEFINE_integer('log_every', 10, 'Steps between lines of the log.', lower_bound=1, **own)
  flags.DEFINE_integer('validate_every', 10, 'Epochs between validations.', lower_bound=1, **own)
  flags.DEFINE_integer('validation_views', 120, 'Maximum views in a validation.', 1, **own)
  flags.DEFINE_float('checkpoint_every', 5, 'Minutes between checkpoints.', 0, **own)
  flags.DEFINE_integer(
    'parts',
    1,
    'Parts of a batch that are computed one after the other, for less memory: gradients are added'
    ' up, and batch normalisation sees a part at a time.',
    lower_bound=1,
    **own,
  )
  flags.DEFINE_enum(
    'restore',
    'newest',
    RESTORES,
    'Checkpoint to continue from. last_good: the newest one that is not damaged.',
    **own,
  )
  flags.DEFINE_bool(
    'replay', False, 'Compute again the step whose loss or gradient was not finite.', **own
  )
  flags.DEFINE_string(
    'coordinator',
    None,
    'HOST:PORT of the first of several processes; JAX finds it by itself under Slurm, Open MPI,'
    ' Kubernetes and on Cloud TPU.',
    **own,
  )
  flags.DEFINE_integer('num_processes', None, 'Processes of the training.', 1, **own)
  flags.DEFINE_integer('process_id', None, 'Number of this process, from 0.', 0, **own)
  flags.mark_flags_as_required(['workdir'], f)
  flags.register_validator(
    'learning_rate', lambda x: x is None or 0 < x < math.inf, 'must be above 0', f
  )


def read_flags(f: flags.FlagValues) -> Settings:
  """The settings that the flags describe; those not given are of the run's last session.

  Raises:
    UserError: --workdir holds no run, and --network or --data is not given; or the file of its
      sessions is damaged.
  """
  last = sessions.last_settings(f['workdir'].value)

  def value(name):
    return last[name] if name in last and not f[name].present else f[name].value

  s = Settings(*(value(name) for name in Settings._fields))._replace(workdir=f['workdir'].value)
  missing = [f'--{name}' for name in ('network', 'data') if getattr(s, name) is None]
  if missing:
    raise UserError(f'{s.workdir} holds no run to continue: name {" and ".join(missing)}')
  return s


def resolve_dtype(s: Settings) -> Settings:
  """The settings with a type in place of --dtype=auto; prints the reason.

  Raises:
    UserError: the settings of the run in the workdir cannot be read.
  """
  if s.dtype != 'auto':
    return s
  if os.path.lexists(os.path.join(s.workdir, 'config.json')):
    dtype = checkpoint.read_config(s.workdir).get('dtype', 'float32')
    why = f'the run in {s.workdir} has it'
  else:
    dtype, why = native.faster_dtype()
  print(f'--dtype=auto is {dtype}: {why}')
  return s._replace(dtype=dtype)


def make_recipe(s: Settings) -> Recipe:
  """The recipe with the changes that the settings make."""
  names = (*PARTS, 'learning_rate', 'mirror', 'recolor')
  asked = {name: getattr(s, name) for name in names if getattr(s, name) is not None}
  chosen = {name: PARTS[name][x] if name in PARTS else x for name, x in asked.items()}
  return RECIPES[s.recipe]._replace(**chosen)


def configuration(**named: Any) -> dict[str, Any]:
  """The configuration that the program stores when it is started with some flags."""
  s = resolve_dtype(read_flags(cli.parse(define_flags, **named)))
  dataset = open_dataset(s.data)
  rows = data.select_rows(dataset, 'train', categories=s.category, sources=s.source)
  return make_config(s, make_recipe(s), dataset, rows)


def make_config(
  s: Settings, recipe: Recipe, dataset: Dataset, rows: Sequence[int]
) -> dict[str, Any]:
  """Everything that a resumed or reused run must have in common with the one asked for.

  The recipe is stored part by part, so that a recipe that has changed under its name is another
  one. `counts` is the number of models of each category and source.
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
    **{name: getattr(s, name) for name in names},
    **describe_recipe(recipe),
  }
  if s.parts > 1:
    config['parts'] = s.parts
  # A schedule that ends with the training depends on its length.
  return config | ({'epochs': s.epochs} if recipe.schedule is recipes.cosine else {})


def describe_recipe(recipe: Recipe) -> dict[str, Any]:
  """The recipe as JSON values: its parts by their names."""
  names = {part: name for parts in PARTS.values() for name, part in parts.items()}
  found = {k: names[v] if k in PARTS else v for k, v in recipe._asdict().items()}
  return {'recipe': found.pop('name'), **found}


def is_finished(workdir: str, step: int, steps_per_epoch: int, epochs: int) -> bool:
  """Whether a run has reached the end of its epochs.

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
