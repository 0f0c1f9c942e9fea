r"""Trains a network on a data set.

python -m experiments.train --network=shape --recipe=paper|release|best --data=DIR --workdir=DIR

shape and color are the paper's method. The other networks are for comparison: regression and flow
are the colour network without its other heads, joint is the unified network, r2n2 the adapted
3D-R2N2.

The same command continues exactly where the last one stopped; with more --epochs it goes further.
Ctrl-C or SIGTERM saves first. WORKDIR holds config.json, checkpoints, log.jsonl and files for
TensorBoard (see cvn.checkpoint and experiments.lib.journal).
"""

import contextlib
import sys

import jax
import numpy as np
from absl import flags
from flax import linen as nn

from cvn import camera, checkpoint, data, grid, infer, train
from cvn.dataset import Dataset, open_dataset
from cvn.errors import UserError
from cvn.networks import NETWORKS
from cvn.objectives import OBJECTIVES
from cvn.recipe import Recipe
from experiments.lib import cli
from experiments.lib.fit import Intervals, Validation, fit, make_placement, mean
from experiments.lib.training import (
  Settings,
  define_flags,
  is_finished,
  make_config,
  make_recipe,
  read_flags,
  resolve_dtype,
)
from experiments.lib.training_pictures import draw_views

PICTURES = 4  # views drawn at each validation


@cli.program(define_flags)
def main(f: flags.FlagValues) -> int:
  return run(read_flags(f))


def run(s: Settings) -> int:
  """Trains a network; returns the exit status."""
  recipe = make_recipe(s)
  read = data.read_shape if s.network == 'shape' else data.read_color
  dataset = open_dataset(s.data)
  check_sizes(dataset)
  rows = data.select_rows(dataset, 'train', categories=s.category, sources=s.source)
  options = {'seed': s.seed, 'mirror': recipe.mirror, 'recolor': recipe.recolor}
  batches = data.training_batches(read, dataset, rows, batch_size=s.batch_size, **options)
  s = resolve_dtype(s)
  network = NETWORKS[s.network](dataset.manifest.image_size, dataset.manifest.grid_size)
  step = make_step(s, network, recipe, s.epochs * len(batches) * s.batch_size)
  views = data.select_rows(dataset, 'val', categories=s.category, sources=s.validation_source)
  pairs = choose_views(dataset, views, maximum=s.validation_views, batch_size=s.batch_size)
  checkpoint.start(s.workdir, make_config(s, recipe, dataset, rows))
  if is_finished(s.workdir, checkpoint.latest_step(s.workdir) or 0, len(batches), s.epochs):
    print(f'{s.workdir} is trained for {s.epochs} epochs: raise --epochs to go on')
    return 0
  if len(pairs) == 0:
    print('no finished model in the split val: training without validation', file=sys.stderr)

  put_batch, put_state = make_placement(s.batch_size)
  evaluate = train.make_eval(network, OBJECTIVES[s.network], recipe)
  renew = train.make_recalibration(network.clone(mixed=s.dtype == 'mixed'))

  def recalibrate(state):
    if not s.fresh_statistics:
      return state
    return renew(state, (put_batch(batches[n]) for n in range(s.fresh_statistics)))

  def validate(state):
    held_out = data.evaluation_batches(read, dataset, pairs, batch_size=s.batch_size)
    with contextlib.closing(data.iterate(held_out, num_epochs=1)) as views:
      found = mean(jax.device_get([evaluate(state, put_batch(b)) for b in views]))
    variables = {'params': state.params, 'batch_stats': state.batch_stats}
    trained = infer.Network(s.network, network, variables)
    return Validation(found, draw_views(trained, dataset, pairs[:: -(-len(pairs) // PICTURES)]))

  return fit(
    s.workdir,
    put_state(train.create_state(jax.random.key(s.seed), network)),
    step,
    batches,
    epochs=s.epochs,
    batch_size=s.batch_size,
    put_batch=put_batch,
    recalibrate=recalibrate,
    validate=validate if len(pairs) else None,
    every=Intervals(s.log_every, s.validate_every, s.checkpoint_every),
  )


def make_step(s: Settings, network: nn.Module, recipe: Recipe, total_samples: int):
  """The training step of the settings.

  Raises:
    UserError: there is none.
  """
  network = network.clone(mixed=s.dtype == 'mixed')
  if s.heads == 'dense':
    return train.make_step(network, OBJECTIVES[s.network], recipe, total_samples=total_samples)
  if s.fresh_statistics:
    raise UserError(f'--heads={s.heads} has its own statistics: leave out --fresh_statistics')
  if s.network != 'color':
    raise UserError(
      f'--heads={s.heads} is for --network=color: the loss of shapes reads all voxels'
    )
  return train.make_surface_step(network, recipe, total_samples=total_samples)


def check_sizes(dataset: Dataset) -> None:
  """Refuses data whose size is not the networks'."""
  m = dataset.manifest
  if (m.image_size, m.grid_size) != (camera.IMAGE_SIZE, grid.GRID_SIZE):
    raise UserError(
      f'{dataset.root} has {m.image_size}-pixel views and a grid of {m.grid_size},'
      f' the networks need {camera.IMAGE_SIZE} and {grid.GRID_SIZE}: make the data set again'
    )


def choose_views(dataset: Dataset, rows, *, maximum: int, batch_size: int) -> np.ndarray:
  """Pairs (row, view) [P, 2] to validate on, in whole batches if there is more than one.

  Args:
    dataset: the open data set.
    rows: of the models.
    maximum: number of pairs.
    batch_size: pairs in a batch.
  """
  views = len(dataset.manifest.azimuths)
  count = min(maximum, len(rows) * views)
  if count > batch_size:
    count -= count % batch_size
  return data.evaluation_pairs(rows, views, limit=count)


if __name__ == '__main__':
  main()
