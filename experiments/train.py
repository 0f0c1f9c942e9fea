r"""Trains a network on a data set.

python -m experiments.train --network=shape --recipe=paper|release|best --data=DIR --workdir=DIR

The method of the paper is shape and color. The others are what it is compared with: regression and
flow are the colour network without its other heads, joint is the unified network, r2n2 the adapted
3D-R2N2.

The same command goes on where the last one stopped, exactly; with more --epochs it goes further.
Ctrl-C or SIGTERM saves first. WORKDIR holds config.json, checkpoints, log.jsonl and TensorBoard's
files (see cvn.checkpoint and cvn.journal).
"""

import contextlib
import math
import signal
import sys
import time

import jax
import numpy as np
from absl import flags
from flax import linen as nn
from jax.sharding import AxisType, NamedSharding, PartitionSpec
from tqdm import tqdm

from cvn import (
  camera,
  checkpoint,
  data,
  environment,
  errors,
  grid,
  infer,
  train,
)
from cvn.dataset import Dataset, open_dataset
from cvn.errors import UserError
from cvn.networks import NETWORKS
from cvn.objectives import OBJECTIVES
from cvn.recipe import Recipe
from experiments.lib import journal
from experiments.lib.training import (
  define_flags,
  is_finished,
  make_config,
  make_recipe,
  resolve_dtype,
)
from experiments.lib.training_pictures import draw_views

PICTURES = 4  # views drawn at each validation


def main(_) -> int:
  return run(flags.FLAGS)


def run(f: flags.FlagValues) -> int:
  """Trains as the flags say; returns the exit status."""
  recipe = make_recipe(f)
  read = data.read_shape if f.network == 'shape' else data.read_color
  dataset = open_dataset(f.data)
  check_sizes(dataset)
  rows = data.select_rows(dataset, 'train', categories=f.category, sources=f.source)
  batches = data.training_batches(
    read,
    dataset,
    rows,
    batch_size=f.batch_size,
    seed=f.seed,
    mirror=recipe.mirror,
    recolor=recipe.recolor,
  )
  resolve_dtype(f)
  network = NETWORKS[f.network](dataset.manifest.image_size, dataset.manifest.grid_size)
  train_step = make_step(f, network, recipe, f.epochs * len(batches) * f.batch_size)
  validation = select_validation(f, dataset)
  checkpoint.start(f.workdir, make_config(f, recipe, dataset, rows))

  put_batch, put_state = make_placement(f.batch_size)
  state = put_state(train.create_state(jax.random.key(f.seed), network))
  evaluate = train.make_eval(network, OBJECTIVES[f.network], recipe)
  recalibrate = train.make_recalibration(network.clone(mixed=f.dtype == 'mixed'))

  iterator = data.iterate(batches)
  window = []  # metrics of the steps since the last line of the log
  restored = checkpoint.restore(f.workdir, state)
  if restored is not None:
    state, progress = restored
    iterator.set_state(progress['iterator'])
    window = progress['window']
  step = first = int(state.step)
  total = f.epochs * len(batches)
  if is_finished(f.workdir, step, len(batches), f.epochs):
    print(f'{f.workdir} is trained for {f.epochs} epochs: raise --epochs to go on')
    return 0
  if len(validation) == 0:
    print('no finished model in the split val: training without validation', file=sys.stderr)

  saved_at = time.monotonic()
  with (
    contextlib.closing(iterator),
    catch_signals() as caught,
    out_of_memory_is_a_user_error(),
    journal.open_journal(f.workdir, step) as log,
    tqdm(
      total=total * f.batch_size,
      initial=step * f.batch_size,
      unit='image',
      mininterval=0.5 if sys.stderr.isatty() else 10,
    ) as bar,
  ):
    while step < total and not caught:
      batch = put_batch(next(iterator))  # read while the step before is computed
      jax.block_until_ready(state)  # or two steps' memory would be taken at a time
      state, metrics = train_step(state, batch)
      step += 1
      epoch = step / len(batches)
      window.append(metrics)
      bar.set_description(f'epoch {math.ceil(epoch)}/{f.epochs}', refresh=False)
      # The step before's loss, so as not to wait for this one's.
      bar.set_postfix(loss=f'{float(window[-2:][0]["loss"]):.4f}', refresh=False)
      bar.update(f.batch_size)

      if step % f.log_every == 0 or step % len(batches) == 0:
        journal.write_line(log, step, epoch, mean(fetch(window, step)))
        journal.write_scalar(log, step, 'train/images_per_second', bar.format_dict['rate'] or 0)
        window = []
      validates = step == total or step % (f.validate_every * len(batches)) == 0
      used = state
      if f.fresh_statistics and validates:
        used = recalibrate(state, (put_batch(batches[n]) for n in range(f.fresh_statistics)))
      if len(validation) and validates:
        held_out = data.evaluation_batches(read, dataset, validation, batch_size=f.batch_size)
        with contextlib.closing(data.iterate(held_out, num_epochs=1)) as views:
          found = mean(jax.device_get([evaluate(used, put_batch(b)) for b in views]))
        journal.write_line(log, step, epoch, {'validation': found})
        variables = {'params': used.params, 'batch_stats': used.batch_stats}
        trained = infer.Network(f.network, network, variables)
        picture = draw_views(trained, dataset, validation[:: -(-len(validation) // PICTURES)])
        journal.write_picture(log, step, 'validation/views', picture)
      if step == total:
        state = used
      if step == total or caught or time.monotonic() - saved_at >= 60 * f.checkpoint_every:
        window = fetch(window, step)  # first, for it refuses to save what is not finite
        checkpoint.save(f.workdir, state, {'iterator': iterator.get_state(), 'window': window})
        saved_at = time.monotonic()

  print(f'{f.workdir}: steps {first} to {step} of {total}, epoch {step / len(batches):g}')
  if caught:
    print('stopped; the same command goes on from here', file=sys.stderr)
    return 128 + caught[0]
  return 0


def make_step(f: flags.FlagValues, network: nn.Module, recipe: Recipe, total_samples: int):
  """The step that the flags ask for.

  Raises:
    UserError: there is none.
  """
  network = network.clone(mixed=f.dtype == 'mixed')
  if f.heads == 'dense':
    return train.make_step(network, OBJECTIVES[f.network], recipe, total_samples=total_samples)
  if f.fresh_statistics:
    raise UserError(f'--heads={f.heads} has statistics of its own: no --fresh_statistics')
  if f.network != 'color':
    raise UserError(
      f'--heads={f.heads} is for --network=color: the loss of shapes reads all voxels'
    )
  return train.make_surface_step(network, recipe, total_samples=total_samples)


def check_sizes(dataset: Dataset) -> None:
  """Refuses data of another size than the networks'."""
  m = dataset.manifest
  if (m.image_size, m.grid_size) != (camera.IMAGE_SIZE, grid.GRID_SIZE):
    raise UserError(
      f'{dataset.root} has {m.image_size}-pixel views and a grid of {m.grid_size},'
      f' the networks need {camera.IMAGE_SIZE} and {grid.GRID_SIZE}: make the data set again'
    )


def select_validation(f: flags.FlagValues, dataset: Dataset) -> np.ndarray:
  """Pairs (row, view) [P, 2] of the split val, in whole batches where they fill one."""
  rows = data.select_rows(dataset, 'val', categories=f.category, sources=f.validation_source)
  views = len(dataset.manifest.azimuths)
  count = min(f.validation_views, len(rows) * views)
  if count > f.batch_size:
    count -= count % f.batch_size
  return data.evaluation_pairs(rows, views, limit=count)


def make_placement(batch_size: int):
  """Functions that put a batch in equal parts, and a state whole, on as many devices as can be."""
  there = jax.device_count()
  count = math.gcd(batch_size, there)
  if count < there:
    print(
      f'--batch_size={batch_size} does not divide over {there} devices: {count} of them are used;'
      f' a multiple of {there} uses all',
      file=sys.stderr,
    )
  mesh = jax.make_mesh(
    (count,), ('batch',), axis_types=(AxisType.Auto,), devices=jax.devices()[:count]
  )
  parts, whole = NamedSharding(mesh, PartitionSpec('batch')), NamedSharding(mesh, PartitionSpec())

  def put_batch(batch):
    return jax.device_put(batch, parts if len(batch.image) % count == 0 else whole)

  return put_batch, lambda state: jax.device_put(state, whole)


def fetch(window: list[dict], step: int) -> list[dict]:
  """The metrics of the last steps as numbers.

  Raises:
    UserError: one of them is not finite.
  """
  window = [{k: float(v) for k, v in m.items()} for m in jax.device_get(window)]
  for at, metrics in enumerate(window, step - len(window) + 1):
    for name, value in metrics.items():
      if not math.isfinite(value):
        raise UserError(
          f'{name} became {value} at step {at}, training stopped; the last checkpoint is from'
          ' before. Try a smaller --learning_rate in another workdir'
        )
  return window


def mean(window: list[dict]) -> dict[str, float]:
  """The mean of each metric."""
  return {k: float(np.mean([m[k] for m in window])) for k in window[0]}


@contextlib.contextmanager
def catch_signals():
  """Yields a list that SIGINT and SIGTERM append to; a second one ends the program as usual."""
  caught = []

  def note(number, _):
    caught.append(number)
    signal.signal(number, before[number])

  before = {n: signal.signal(n, note) for n in (signal.SIGINT, signal.SIGTERM)}
  try:
    yield caught
  finally:
    for number, handler in before.items():
      signal.signal(number, handler)


@contextlib.contextmanager
def out_of_memory_is_a_user_error():
  try:
    yield
  except jax.errors.JaxRuntimeError as e:
    if 'RESOURCE_EXHAUSTED' not in str(e):
      raise
    raise UserError('the device has too little memory: take a smaller --batch_size') from e


if __name__ == '__main__':
  environment.prepare()
  define_flags(flags.FLAGS)
  errors.run(main)
