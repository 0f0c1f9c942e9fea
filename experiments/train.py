r"""Trains a network on a data set.

python -m experiments.train --network=shape --recipe=paper|release|best --data=DIR --workdir=DIR

shape and color are the paper's method. The other networks are for comparison: regression and flow
are the colour network without its other heads, joint is the unified network, r2n2 the adapted
3D-R2N2.

The same command continues exactly where the last one stopped, and so does --workdir=WORKDIR alone;
with more --epochs it goes further. Ctrl-C or SIGTERM saves first. WORKDIR holds config.json,
sessions.jsonl, checkpoints, log.jsonl and files for TensorBoard (see cvn.checkpoint,
experiments.lib.journal and experiments.lib.sessions).

A batch is spread over all devices of all processes: docs/scaling.md says how to start several.
"""

import contextlib
import functools
import sys
from collections.abc import Callable, Iterator
from typing import Any

import jax
import numpy as np
from absl import flags
from flax import linen as nn

from cvn import camera, checkpoint, data, files, grid, infer, parallel, train
from cvn.dataset import Dataset, open_dataset
from cvn.errors import UserError
from cvn.networks import NETWORKS
from cvn.objectives import OBJECTIVES
from cvn.ops import native
from cvn.recipe import Recipe
from experiments.lib import cli, nonfinite, sessions
from experiments.lib.fit import Intervals, Validation, fit, mean
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


def join(f: flags.FlagValues) -> None:
  parallel.connect(
    coordinator=f.coordinator, num_processes=f.num_processes, process_id=f.process_id
  )


@cli.program(define_flags, start=join)
def main(f: flags.FlagValues) -> int:
  with parallel.die_together():
    return run(read_flags(f), last_good=f.restore == 'last_good', replay=f.replay)


def run(s: Settings, *, last_good: bool = False, replay: bool = False) -> int:
  """Trains a network; returns the exit status.

  Args:
    s: the settings.
    last_good: whether an older checkpoint may take the place of a damaged one.
    replay: whether to compute a step that was not finite again, and nothing else.
  """
  recipe = make_recipe(s)
  read = data.read_shape if s.network == 'shape' else data.read_color
  dataset = open_dataset(s.data)
  check_sizes(dataset)
  rows = data.select_rows(dataset, 'train', categories=s.category, sources=s.source)
  parallel.local_batch(s.batch_size, parts=s.parts)  # refuses one that does not divide
  options = {'seed': s.seed, 'mirror': recipe.mirror, 'recolor': recipe.recolor}
  batches, names = (
    data.training_batches(
      of_one,
      dataset,
      rows,
      batch_size=s.batch_size,
      shard=(jax.process_index(), jax.process_count()),
      **drawn,
    )
    for of_one, drawn in ((read, options), (data.read_name, {'seed': s.seed}))
  )
  s = agree_on_type(s)
  m, implementation = dataset.manifest, agree_on_implementation(s.dtype)
  network = NETWORKS[s.network](m.image_size, m.grid_size, implementation=implementation)
  step = make_step(s, network, recipe, s.epochs * len(batches) * s.batch_size)
  evaluate = train.make_eval(network, OBJECTIVES[s.network], recipe)
  if replay:
    state = train.create_state(jax.random.key(s.seed), network)
    nonfinite.replay(s.workdir, state, step, evaluate)
    return 0
  with enter(s, make_config(s, recipe, dataset, rows)):
    if is_finished(s.workdir, checkpoint.latest_step(s.workdir) or 0, len(batches), s.epochs):
      print(f'{s.workdir} is trained for {s.epochs} epochs: raise --epochs to go on')
      return 0
    views = data.select_rows(dataset, 'val', categories=s.category, sources=s.validation_source)
    pairs = choose_views(dataset, views, maximum=s.validation_views, batch_size=s.batch_size)
    if len(pairs) == 0:
      print('no finished model in the split val: training without validation', file=sys.stderr)
    placement = parallel.make_placement()
    put_batch = functools.partial(parallel.put_batch, placement)
    renew = train.make_recalibration(network.clone(mixed=s.dtype == 'mixed'))

    def recalibrate(state):
      if not s.fresh_statistics:
        return state
      return renew(state, (put_batch(batches[n]) for n in range(s.fresh_statistics)))

    def validate(state):
      held_out, put = share_views(read, dataset, pairs, s.batch_size, placement)
      with contextlib.closing(data.iterate(held_out, num_epochs=1)) as views:
        found = mean(jax.device_get([evaluate(state, put(b)) for b in views]))
      if not parallel.is_first():
        return Validation(found, None)
      own = parallel.local(state)
      variables = {'params': own.params, 'batch_stats': own.batch_stats}
      trained = infer.Network(s.network, network, variables)
      return Validation(found, draw_views(trained, dataset, pairs[:: -(-len(pairs) // PICTURES)]))

    state = train.create_state(jax.random.key(s.seed), network)
    return fit(
      s.workdir,
      parallel.put_whole(placement, state),
      step,
      batches,
      epochs=s.epochs,
      batch_size=s.batch_size,
      put_batch=put_batch,
      recalibrate=recalibrate,
      validate=validate if len(pairs) else None,
      name_batch=names.__getitem__,
      every=Intervals(s.log_every, s.validate_every, s.checkpoint_every),
      last_good=last_good,
    )


@contextlib.contextmanager
def enter(s: Settings, config: dict[str, Any]) -> Iterator[None]:
  """Makes the workdir or checks that it is of this run, and keeps other runs out while this one is.

  Raises:
    UserError: the workdir holds another run, or is in use.
  """
  if not parallel.is_first():
    parallel.wait_for_all()
    checkpoint.start(s.workdir, config)
    yield
    return
  checkpoint.start(s.workdir, config)
  with files.exclusive(s.workdir):
    settings = s._replace(data=config['data'])._asdict()  # as a URL, which holds in any folder
    sessions.write(s.workdir, settings, checkpoint.latest_step(s.workdir) or 0)
    parallel.wait_for_all()
    yield


def agree_on_type(s: Settings) -> Settings:
  """The settings with a type in place of --dtype=auto, the first process's choice."""
  s = resolve_dtype(s) if parallel.is_first() else s
  return s._replace(dtype=parallel.broadcast(s.dtype))


def agree_on_implementation(dtype: str) -> str:
  """The implementation of all layers: 'auto' in one process or on accelerators.

  Several processes must compute with the same programs, but each would choose kernels by its own
  timings. So all take kernels, if they win everywhere in the first process, or none. Kernels are
  compiled here, before any process waits in a collective for one that compiles.

  Args:
    dtype: 'float32' or 'mixed'.

  Raises:
    UserError: the first process has compiled kernels, and this one has none.
  """
  if jax.process_count() == 1 or jax.default_backend() != 'cpu':
    return 'auto'
  library, operations = native.library(), ('deconv', 'conv', 'conv2d', 'activated')
  win = library and all(native.wins(library, o, mixed=dtype == 'mixed') for o in operations)
  chosen = parallel.broadcast('kernels' if win else 'plain')
  if chosen == 'kernels' and library is None:
    raise UserError(
      f'process {jax.process_index()} has no compiled kernels ({native.missing()}), but process 0'
      ' has: set CVN_KERNELS=off on all machines, or install a C++ compiler on this one'
    )
  return chosen


def share_views(
  read: Callable, dataset: Dataset, pairs: np.ndarray, batch_size: int, placement
) -> tuple[Any, Callable]:
  """The batches to validate on that this process reads, and what puts them on all devices.

  A batch that does not divide is read by every process, and computed by every device.

  Args:
    read: reads an element.
    dataset: the open data set.
    pairs: [P, 2] of `choose_views`.
    batch_size: pairs in a batch of all processes.
    placement: of `parallel.make_placement`.
  """
  size = min(batch_size, len(pairs))
  if size % jax.device_count():
    held_out = data.evaluation_batches(read, dataset, pairs, batch_size=size)
    return held_out, functools.partial(parallel.put_whole, placement)
  own = parallel.local_batch(size)
  mine = pairs.reshape(-1, jax.process_count(), own, 2)[:, jax.process_index()].reshape(-1, 2)
  held_out = data.evaluation_batches(read, dataset, mine, batch_size=own)
  return held_out, functools.partial(parallel.put_batch, placement)


def make_step(s: Settings, network: nn.Module, recipe: Recipe, total_samples: int):
  """The training step of the settings.

  Raises:
    UserError: there is none.
  """
  network = network.clone(mixed=s.dtype == 'mixed')
  options = {'total_samples': total_samples, 'parts': s.parts}
  if s.heads == 'dense':
    return train.make_step(network, OBJECTIVES[s.network], recipe, **options)
  if s.fresh_statistics:
    raise UserError(f'--heads={s.heads} has its own statistics: leave out --fresh_statistics')
  if s.network != 'color':
    raise UserError(
      f'--heads={s.heads} is for --network=color: the loss of shapes reads all voxels'
    )
  return train.make_surface_step(network, recipe, **options)


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
