"""Data parallelism: one training on all devices of all processes.

Every process runs the same program and holds the whole state; a batch is one array, spread over the
devices of all processes, of which a process reads its own part. So losses, gradients and batch
statistics are those of the whole batch, and JAX adds what it takes for that between devices.

All processes see the same files: checkpoints are written by all of them, everything else by the
first. If one of them dies the others end, too, and the same command goes on from the checkpoint.
"""

import contextlib
import hashlib
import itertools
import os
import sys
import traceback
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jax._src import distributed  # the coordination service has no public name
from jax.experimental import multihost_utils
from jax.sharding import AxisType, NamedSharding, PartitionSpec

from cvn.errors import UserError

TIMEOUT_MS = 3_600_000  # for other processes; one that died ends all of them much earlier

_calls = itertools.count()  # the same in all processes, which call in the same order


class Placement(NamedTuple):
  """Where arrays lie."""

  parts: NamedSharding  # a batch, in equal parts
  whole: NamedSharding  # the same on every device


def connect(
  *,
  coordinator: str | None = None,
  num_processes: int | None = None,
  process_id: int | None = None,
) -> None:
  """Joins the other processes of a training, before anything is computed.

  Without arguments JAX looks for a cluster (Slurm, Open MPI, Kubernetes, Cloud TPU); where there is
  none the process stays alone.

  Args:
    coordinator: 'HOST:PORT' of the first process.
    num_processes: how many there are; 1 looks for no cluster.
    process_id: this one's number, from 0.

  Raises:
    UserError: the arguments do not fit, or the others do not come.
  """
  given = [x is not None for x in (coordinator, num_processes, process_id)]
  if num_processes == 1 and not coordinator:
    return
  if any(given) and not all(given):
    raise UserError('--coordinator, --num_processes and --process_id go together')
  try:
    jax.distributed.initialize(coordinator, num_processes, process_id)
  except ValueError as e:
    if any(given):
      raise UserError(f'cannot join {coordinator}: {e}') from e
  except RuntimeError as e:
    line = str(e).split('\n', 1)[0]
    raise UserError(
      f'cannot join the other processes ({line}); --num_processes=1 trains in this one alone'
    ) from e


def is_first() -> bool:
  """Whether this process writes what only one writes: logs, pictures, configurations."""
  return jax.process_index() == 0


def local_batch(batch_size: int, *, parts: int = 1) -> int:
  """How many elements of a batch this process reads.

  Args:
    batch_size: elements in a batch of all processes.
    parts: of it that are computed one after the other.

  Raises:
    UserError: the batch does not divide.
  """
  devices, multiple = jax.device_count(), jax.device_count() * parts
  if batch_size % multiple:
    low, high = batch_size // multiple * multiple, -(-batch_size // multiple) * multiple
    sizes = f'{low} or {high}' if low else str(high)
    times = f' and {parts} parts' if parts > 1 else ''
    raise UserError(
      f'a batch of {batch_size} cannot be spread evenly over {devices} devices{times}: take'
      f' --batch_size={sizes}'
    )
  return batch_size // devices * jax.local_device_count()


def make_placement(*, devices: Sequence[jax.Device] | None = None) -> Placement:
  """Spreads batches over devices, all of those of all processes by default."""
  devices = jax.devices() if devices is None else devices
  mesh = jax.make_mesh((len(devices),), ('batch',), axis_types=(AxisType.Auto,), devices=devices)
  return Placement(
    NamedSharding(mesh, PartitionSpec('batch')), NamedSharding(mesh, PartitionSpec())
  )


def put_batch(placement: Placement, batch: Any) -> Any:
  """This process's part of a batch, as NumPy arrays, becomes the batch on all devices."""
  return jax.tree.map(
    lambda x: jax.make_array_from_process_local_data(placement.parts, np.asarray(x)), batch
  )


def put_whole(placement: Placement, tree: Any) -> Any:
  """Arrays that all processes have become the same on every device."""
  return jax.tree.map(
    lambda x: jax.make_array_from_process_local_data(placement.whole, np.asarray(x), x.shape), tree
  )


def local(tree: Any) -> Any:
  """This process's own copy of arrays that are the same on every device."""
  return jax.tree.map(lambda x: x.addressable_data(0) if isinstance(x, jax.Array) else x, tree)


def wait_for_all() -> None:
  """Returns when every process has come here.

  Processes wait on JAX's coordination service. In a collective of Gloo they would not wait longer
  than 30 s, as for a process that still compiles or draws.
  """
  if jax.process_count() > 1:
    _client().wait_at_barrier(f'cvn/{next(_calls)}', TIMEOUT_MS)


def broadcast(text: str) -> str:
  """The first process's text, in all of them; what the others give is dropped."""
  if jax.process_count() == 1:
    return text
  key = f'cvn/{next(_calls)}'
  if is_first():
    _client().key_value_set(key, text)
  return _client().blocking_key_value_get(key, TIMEOUT_MS)


def agree(wish: bool) -> bool:
  """The first process's wish, in all of them."""
  return broadcast(str(int(wish))) == '1'


def check_equal(tree: Any, what: str) -> None:
  """Checks that all processes have the same bytes in arrays that are whole on every device.

  Raises:
    UserError: this process's differ from the first one's.
  """
  if jax.process_count() == 1:
    return
  found = digest(local(tree))
  first = broadcast(found)
  if found != first:
    raise UserError(
      f'{what} of process {jax.process_index()} ({found[:8]}) is not that of process 0'
      f' ({first[:8]}): the machines compute differently; nothing was saved'
    )


def digest(tree: Any) -> str:
  """A hash of the bytes of all arrays."""
  total = hashlib.sha256()
  for x in jax.tree.leaves(tree):
    total.update(np.ascontiguousarray(x))
  return total.hexdigest()


def must_stop(caught: list[int], step: int) -> bool:
  """Whether to stop after this step: all processes stop after the same one.

  Args:
    caught: the signals that this process has caught; only those of one that is alone count.
    step: that was taken; each process asks after each of its steps.
  """
  if jax.process_count() == 1:
    return bool(caught)
  return multihost_utils.reached_preemption_sync_point(step)


def compile_for_all(function: Any, *arrays: Any) -> Any:
  """A jitted function for these arrays, compiled when this returns in every process."""
  if jax.process_count() == 1:
    return function
  compiled = function.lower(*arrays).compile()
  wait_for_all()
  return compiled


@contextlib.contextmanager
def die_together() -> Iterator[None]:
  """Ends this process at once if the body raises, so that the others do not wait for it.

  A process that ends as usual waits for the others, who wait for it in a collective.
  """
  try:
    yield
  except BaseException as e:
    if jax.process_count() == 1:
      raise
    if isinstance(e, UserError):
      print(f'error: {" ".join(str(e).split())}', file=sys.stderr)
    else:
      traceback.print_exc()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(1)


def _client():
  return distributed.global_state.client
