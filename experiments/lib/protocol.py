"""The paper's methods as trainings and evaluations, for the programs of its tables and figures.

Everything is below --workdir and is reused by all programs that ask for the same (see
experiments.lib.runs):

  runs/<training>_<category or 'all'>_<seed>                    what experiments.train writes
  scores/<method>_<category or 'all'>_<seed>[_<source>]_<split>[_val].json
                                                                what experiments.evaluate writes

The defaults are the paper's protocol: one model a category, 500 epochs, batches of 60.
"""

import os
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from absl import flags

from cvn import infer
from cvn.dataset import open_dataset
from cvn.errors import UserError
from cvn.infer import Network, Reconstruction
from cvn.readouts import COLOR_KINDS, SHAPE_KINDS
from experiments.lib import runs, scoring
from experiments.lib.methods import METHODS, TRAININGS
from experiments.lib.runs import Run
from experiments.lib.training import DTYPES

ALL = 'all'  # in the place of a category: one model for all of them
PAPER_CATEGORIES = ('car', 'table', 'chair', 'guitar')  # in the order of the paper's tables
VALIDATIONS = 4  # in the course of a training
VALIDATION_VIEWS = 60


def define_flags(f: flags.FlagValues) -> None:
  """The flags that the programs of tables and figures share."""
  own = {'flag_values': f}
  flags.DEFINE_string('data', None, 'Data set: a folder or URL of datagen.generate.', **own)
  flags.DEFINE_string('workdir', None, 'Folder of all trainings and results.', **own)
  flags.DEFINE_bool('quick', False, 'Train one epoch only, to try the program.', **own)
  flags.DEFINE_list('category', [], 'Categories; all of the data set by default.', **own)
  flags.DEFINE_enum(
    'models',
    'category',
    ('category', ALL),
    'Train a model for each category, as the paper does, or one for all categories.',
    **own,
  )
  flags.DEFINE_list('seeds', ['0'], 'Random seeds, with one training each.', **own)
  flags.DEFINE_list('train_source', [], 'Sources of models to train on; all by default.', **own)
  flags.DEFINE_list(
    'source', [], 'Sources of models to validate and test on; all by default.', **own
  )
  flags.DEFINE_integer('epochs', 500, 'Epochs of each training.', lower_bound=1, **own)
  flags.DEFINE_integer('batch_size', 60, 'Views in a step.', lower_bound=1, **own)
  flags.DEFINE_float('learning_rate', None, "First learning rate, instead of the recipes'.", **own)
  flags.DEFINE_integer('fresh_statistics', 0, 'See experiments.train.', lower_bound=0, **own)
  flags.DEFINE_enum('dtype', 'float32', DTYPES, 'See experiments.train.', **own)
  flags.DEFINE_enum(
    'threshold',
    'paper',
    ('paper', 'val'),
    "Occupancy threshold: the 0.8 of the paper's program (for the adapted R2N2 always chosen on the"
    ' split val), or chosen on the split val for every method.',
    **own,
  )
  flags.mark_flags_as_required(['data', 'workdir'], f)


class Plan(NamedTuple):
  """How networks are trained and evaluated, and on which data."""

  data: str  # the folder or URL of the data set
  workdir: str
  categories: tuple[str, ...]  # empty for all of the data set
  models: str  # 'category', or `ALL`
  seeds: tuple[str, ...]
  train_sources: tuple[str, ...]  # empty for all
  sources: tuple[str, ...]  # of models to validate and test on; empty for all
  epochs: int
  batch_size: int
  learning_rate: float | None  # None for the recipe's
  fresh_statistics: int
  dtype: str
  threshold: str  # 'paper' or 'val'


def read_flags(f: flags.FlagValues) -> Plan:
  """The plan that the shared flags describe."""
  return Plan(
    f.data,
    f.workdir,
    tuple(f.category),
    f.models,
    tuple(f.seeds),
    tuple(f.train_source),
    tuple(f.source),
    1 if f.quick else f.epochs,
    f.batch_size,
    f.learning_rate,
    f.fresh_statistics,
    f.dtype,
    f.threshold,
  )


def categories(plan: Plan) -> list[str]:
  """The plan's categories; by default all of the data set, the paper's first.

  Raises:
    UserError: the data set has no such category.
  """
  known = {m.category for m in open_dataset(plan.data).manifest.models}
  for name in plan.categories:
    if name not in known:
      raise UserError(f'{plan.data} has no category {name!r}; it has {", ".join(sorted(known))}')
  wanted = plan.categories or (*PAPER_CATEGORIES, *sorted(known.difference(PAPER_CATEGORIES)))
  return [c for c in wanted if c in known]


def train(plan: Plan, training: str, category: str, seed: str) -> Run:
  """Trains a network, unless that is done.

  Args:
    plan: how.
    training: a key of `TRAININGS`.
    category: or `ALL`.
    seed: of the training.

  Raises:
    UserError: the folder has a network that was trained otherwise.
  """
  named: dict[str, Any] = {
    'data': plan.data,
    'workdir': os.path.join(plan.workdir, 'runs', f'{training}_{category}_{seed}'),
    'category': ','.join(plan.categories) if category == ALL else category,
    'source': ','.join(plan.train_sources),
    'validation_source': ','.join(plan.sources),
    'epochs': plan.epochs,
    'batch_size': plan.batch_size,
    'seed': seed,
    'dtype': plan.dtype,
    'fresh_statistics': plan.fresh_statistics,
    'validate_every': max(1, plan.epochs // VALIDATIONS),
    'validation_views': VALIDATION_VIEWS,
    **TRAININGS[training],
  }
  if plan.learning_rate is not None:
    named['learning_rate'] = plan.learning_rate
  return runs.train(plan.workdir, **named)


def evaluate(
  plan: Plan,
  method: str,
  category: str,
  seed: str,
  *,
  split: str = 'test',
  threshold: str | None = None,
  measures: bool = False,
) -> dict[str, Any]:
  """Evaluates a method on held-out models, training what it needs.

  Args:
    plan: how.
    method: a key of `METHODS`.
    category: of the models it was trained on and is evaluated on, or `ALL`.
    seed: of the training.
    split: to evaluate on.
    threshold: 'paper' or 'val', instead of the plan's.
    measures: whether looked-up models and pictures are evaluated as well, which takes longer.

  Returns:
    The report that experiments.evaluate writes.

  Raises:
    UserError: the folder has networks or scores that were made otherwise.
  """
  own = METHODS[method]
  chosen = 'val' in (own.threshold, threshold or plan.threshold)
  workdirs = {'shape': train(plan, own.shape, category, seed).workdir}
  if own.color:
    workdirs['color'] = train(plan, own.color, category, seed).workdir
  name = '_'.join([method, category, seed, *plan.sources, split, *(['val'] if chosen else [])])
  more = {'retrieval': 'true', 'pictures': 'true'} if measures else {}
  name += '_measures' * measures
  return runs.evaluate(
    plan.workdir,
    data=plan.data,
    split=split,
    category=','.join(plan.categories) if category == ALL else category,
    source=','.join(plan.sources),
    alpha=own.alpha,
    flip=str(own.flip).lower(),
    carve=str(own.carve).lower(),
    baselines='true',
    json=os.path.join(plan.workdir, 'scores', f'{name}.json'),
    **({'threshold': 'val'} if chosen else {}),
    **more,
    **workdirs,
  )


Predictor = Callable[[np.ndarray], list[Reconstruction]]  # of views [V, H, W, 4]


def make_predictor(plan: Plan, method: str, category: str, seed: str) -> Predictor:
  """A method as a function of views to their reconstructions; trains and evaluates what it needs.

  Arguments as of `evaluate`; the method must give colours.
  """
  own = METHODS[method]
  dataset = open_dataset(plan.data)
  report = evaluate(plan, method, category, seed)

  def load(name, kinds):
    return scoring.load(train(plan, name, category, seed).workdir, kinds, dataset)

  shape = load(own.shape, SHAPE_KINDS)
  color = shape if own.color == own.shape else load(own.color, COLOR_KINDS)
  options = {'threshold': report['threshold'], 'alpha': report['alpha']}
  return bind(method, shape, color, azimuths=dataset.manifest.azimuths, **options)


def bind(
  method: str,
  shape: Network,
  color: Network,
  *,
  threshold: float,
  alpha: float,
  azimuths: Sequence[float],
) -> Predictor:
  """A method with its networks.

  Args:
    method: a key of `METHODS`.
    shape: its network for shapes.
    color: its network for colours.
    threshold: of occupancy.
    alpha: of the blend.
    azimuths: of the data set's views, degrees.
  """
  options = {'threshold': threshold, 'alpha': alpha, 'azimuths': azimuths}
  options |= {'flip': METHODS[method].flip, 'carve': METHODS[method].carve}
  return lambda views: infer.split(infer.reconstruct(views, shape=shape, color=color, **options))


def trained_for(plan: Plan, wanted: Sequence[str]) -> list[tuple[str, list[str]]]:
  """Pairs (what a model is trained on, the categories it is evaluated on)."""
  return [(ALL, [*wanted])] if plan.models == ALL else [(c, [c]) for c in wanted]
