"""The training loop: steps, log, validation, checkpoints, interrupts."""

import contextlib
import math
import signal
import sys
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.sharding import AxisType, NamedSharding, PartitionSpec
from tqdm import tqdm

from cvn import checkpoint, data
from cvn.errors import UserError
from experiments.lib import journal


class Intervals(NamedTuple):
  """How often things happen."""

  log: int  # steps
  validation: int  # epochs
  checkpoint: float  # minutes


class Validation(NamedTuple):
  """A validation's results."""

  metrics: dict[str, float]
  picture: np.ndarray  # uint8 [H, W, 3]


def fit(
  workdir: str,
  state: Any,
  step: Callable[[Any, Any], tuple[Any, dict]],
  batches: Any,
  *,
  epochs: int,
  batch_size: int,
  put_batch: Callable[[Any], Any],
  recalibrate: Callable[[Any], Any],
  validate: Callable[[Any], Validation] | None,
  every: Intervals,
) -> int:
  """Trains from the newest checkpoint, if there is one, to the last epoch; returns the exit status.

  Args:
    workdir: the run's folder.
    state: the initial training state.
    step: (state, batch) -> (state, metrics).
    batches: of `data.training_batches`.
    epochs: in all.
    batch_size: views in a batch.
    put_batch: puts a batch on the devices.
    recalibrate: renews the batch-norm statistics of a state, before validation and at the end.
    validate: of a recalibrated state; None for no validation.
    every: how often things happen.

  Raises:
    UserError: a metric is not finite, or the device has too little memory.
  """
  iterator = data.iterate(batches)
  window = []  # metrics of the steps since the last line of the log
  restored = checkpoint.restore(workdir, state)
  if restored is not None:
    state, progress = restored
    iterator.set_state(progress['iterator'])
    window = progress['window']
  at = first = int(state.step)
  total = epochs * len(batches)
  saved_at = time.monotonic()
  with (
    contextlib.closing(iterator),
    catch_signals() as caught,
    out_of_memory_is_a_user_error(),
    journal.open_journal(workdir, at) as log,
    tqdm(
      total=total * batch_size,
      initial=at * batch_size,
      unit='image',
      mininterval=0.5 if sys.stderr.isatty() else 10,
    ) as bar,
  ):
    while at < total and not caught:
      batch = put_batch(next(iterator))  # read while the previous step is computed
      jax.block_until_ready(state)  # otherwise two steps would take memory at a time
      state, metrics = step(state, batch)
      at += 1
      epoch = at / len(batches)
      window.append(metrics)
      bar.set_description(f'epoch {math.ceil(epoch)}/{epochs}', refresh=False)
      # The previous step's loss, so as not to wait for this one's.
      bar.set_postfix(loss=f'{float(window[-2:][0]["loss"]):.4f}', refresh=False)
      bar.update(batch_size)

      if at % every.log == 0 or at % len(batches) == 0:
        journal.write_line(log, at, epoch, mean(fetch(window, at)))
        journal.write_scalar(log, at, 'train/images_per_second', bar.format_dict['rate'] or 0)
        window = []
      if at == total or at % (every.validation * len(batches)) == 0:
        used = recalibrate(state)
        if validate is not None:
          found = validate(used)
          journal.write_line(log, at, epoch, {'validation': found.metrics})
          journal.write_picture(log, at, 'validation/views', found.picture)
        if at == total:
          state = used
      if at == total or caught or time.monotonic() - saved_at >= 60 * every.checkpoint:
        window = fetch(window, at)  # first, because it refuses to save what is not finite
        checkpoint.save(workdir, state, {'iterator': iterator.get_state(), 'window': window})
        saved_at = time.monotonic()

  print(f'{workdir}: steps {first} to {at} of {total}, epoch {at / len(batches):g}')
  if caught:
    print('stopped; the same command continues from here', file=sys.stderr)
    return 128 + caught[0]
  return 0


def make_placement(batch_size: int):
  """Functions that put parts of a batch, and a whole state, on as many devices as divide it."""
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
