"""The training loop: steps, log, validation, checkpoints, interrupts; in one process or many."""

import contextlib
import math
import signal
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from tqdm import tqdm

from cvn import checkpoint, data, parallel
from cvn.errors import UserError
from experiments.lib import journal, nonfinite


class Intervals(NamedTuple):
  """How often things happen."""

  log: int  # steps
  validation: int  # epochs
  checkpoint: float  # minutes


class Validation(NamedTuple):
  """A validation's results."""

  metrics: dict[str, float]
  picture: np.ndarray | None  # uint8 [H, W, 3]; of the first process alone


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
  name_batch: Callable[[int], Sequence[str]],
  every: Intervals,
  last_good: bool = False,
) -> int:
  """Trains from the newest checkpoint, if there is one, to the last epoch; returns the exit status.

  Args:
    workdir: the run's folder.
    state: the initial training state, on the devices.
    step: (state, batch) -> (state, metrics); the state comes back unchanged if they are not finite.
    batches: of `data.training_batches`, this process's part of each.
    epochs: in all.
    batch_size: views in a batch of all processes.
    put_batch: puts this process's part of a batch on the devices.
    recalibrate: renews the batch-norm statistics of a state, before validation and at the end.
    validate: of a recalibrated state; None for no validation.
    name_batch: the models and views in this process's part of the batch of a step.
    every: how often things happen.
    last_good: whether an older checkpoint may take the place of a damaged one.

  Raises:
    UserError: a metric is not finite, or the device has too little memory.
  """
  iterator = data.iterate(batches)
  window = []  # metrics of the steps since the last line of the log
  restored = checkpoint.restore(workdir, state, last_good=last_good)
  if restored is not None:
    state, progress = restored
    iterator.set_state(progress['iterator'])
    window = progress['window']
  at = first = int(state.step)
  if parallel.broadcast(str(at)) != str(at):
    raise UserError(
      f'process {jax.process_index()} cannot read the checkpoint that process 0 reads'
    )
  total = epochs * len(batches)
  is_first, stopped, saved_at = parallel.is_first(), False, time.monotonic()
  with (
    contextlib.closing(iterator),
    catch_signals() as caught,
    out_of_memory_is_a_user_error(),
    journal.open_journal(workdir, at) if is_first else contextlib.nullcontext() as log,
    tqdm(
      total=total * batch_size,
      initial=at * batch_size,
      unit='image',
      mininterval=0.5 if sys.stderr.isatty() else 10,
      disable=not is_first,
    ) as bar,
  ):
    if at < total:
      following = next(iterator)
      placed = put_batch(following)
      step = parallel.compile_for_all(step, state, placed)
    while at < total and not stopped:
      batch, position = following, iterator.get_state()
      state, metrics = step(state, placed)
      if at + 1 < total:  # read while the step is computed
        following = next(iterator)
        placed = put_batch(following)
      metrics = {k: float(v) for k, v in jax.device_get(metrics).items()}
      at += 1
      if not all(map(math.isfinite, metrics.values())):
        nonfinite.stop(workdir, at, state, batch, name_batch(at - 1), metrics)
      window.append(metrics)
      epoch, last = at / len(batches), at == total
      bar.set_description(f'epoch {math.ceil(epoch)}/{epochs}', refresh=False)
      bar.set_postfix(loss=f'{metrics["loss"]:.4f}', refresh=False)
      bar.update(batch_size)

      if at % every.log == 0 or at % len(batches) == 0:
        if log:
          journal.write_line(log, at, epoch, mean(window))
          journal.write_scalar(log, at, 'train/images_per_second', bar.format_dict['rate'] or 0)
        window = []
      if last or at % (every.validation * len(batches)) == 0:
        used = recalibrate(state)
        if validate is not None:
          found = validate(used)
          if log:
            journal.write_line(log, at, epoch, {'validation': found.metrics})
            journal.write_picture(log, at, 'validation/views', found.picture)
          parallel.wait_for_all()
        if last:
          state = used
      stopped = parallel.must_stop(caught, at)
      if last or stopped or is_due(every, at, saved_at):
        parallel.check_equal(state, f'the state after step {at}')
        checkpoint.save(workdir, state, {'iterator': position, 'window': window})
        saved_at = time.monotonic()

  if is_first:
    print(f'{workdir}: steps {first} to {at} of {total}, epoch {at / len(batches):g}')
  if stopped:
    if is_first:
      print('stopped; the same command continues from here', file=sys.stderr)
    return 128 + (caught or [signal.SIGTERM])[0]
  return 0


def is_due(every: Intervals, at: int, saved_at: float) -> bool:
  """Whether it is time for a checkpoint; by the first process's clock, which takes a message.

  Args:
    every: how often things happen. Several processes look at the clock when they log.
    at: steps that were taken.
    saved_at: time of the monotonic clock.
  """
  if jax.process_count() > 1 and at % every.log:
    return False
  return parallel.agree(time.monotonic() - saved_at >= 60 * every.checkpoint)


def mean(window: list[dict]) -> dict[str, float]:
  """The mean of each metric."""
  return {k: float(np.mean([m[k] for m in window])) for k in window[0]}


@contextlib.contextmanager
def catch_signals():
  """Yields a list that SIGINT and SIGTERM append to; a second one ends the program as usual.

  Among several processes JAX catches SIGTERM, and tells it to all of them.
  """
  caught = []
  if jax.process_count() > 1:
    yield caught
    return

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
    raise UserError(
      'the device has too little memory: take a larger --parts, or a smaller --batch_size'
    ) from e
