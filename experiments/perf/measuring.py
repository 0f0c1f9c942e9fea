"""What experiments.perf measures, each figure in a process of its own.

So no figure knows of another's compiled programs, memory or threads, and the peak of a process is
the peak of what it measured. Batches are noise of the shapes that training meets.
"""

import contextlib
import functools
import multiprocessing
import os
import platform
import resource
import statistics
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import Any, NamedTuple

import flax
import jax
import jaxlib
import numpy as np

from cvn import data, environment, infer, parallel, train
from cvn.camera import IMAGE_SIZE
from cvn.data import Batch
from cvn.dataset import open_dataset
from cvn.errors import UserError
from cvn.grid import GRID_SIZE
from cvn.networks import NETWORKS
from cvn.objectives import OBJECTIVES
from cvn.ops import compile as compiling
from cvn.ops import dispatch, native
from cvn.recipe import PAPER
from experiments import train as program
from experiments.lib import fit
from experiments.perf import layers

SURFACE_VOXELS = 8192  # a generous chair; the median of our data sets is 6000
REFERENCE_BATCH = 2  # the library's deconvolution takes seconds an image on a CPU
SETTINGS = (
  'LD_PRELOAD',
  'GLIBC_TUNABLES',
  'CVN_KERNELS',
  'CVN_TARGET',
  'XLA_FLAGS',
)  # variables that speed depends on
READERS = {'shape': data.read_shape, 'color': data.read_color}
DATA_ROUNDS = 3
DATA_STEPS = 10  # at least, in a round: more than is read ahead


class Steps(NamedTuple):
  """Training steps of one process."""

  first: float  # s, with tracing and compiling
  seconds: tuple[float, ...]  # of each step after it
  peak: int  # bytes of memory, of the whole process
  device_peak: int | None  # bytes of the device's own memory, where it has any


class DataTimes(NamedTuple):
  """Steps as the training program takes them: the next batch is read during each."""

  synthetic: float  # s a step, with one batch over and over
  real: float  # s a step, with batches that are read meanwhile
  peak: int  # bytes of memory, of the whole process


def alone(function: Callable, *args, programs: str | None = None) -> Any:
  """function(*args), in a new process; with environment.prepare's settings of memory.

  Args:
    function: of a module, so that its name can be sent.
    *args: what can be pickled.
    programs: the folder of compiled programs; None for none but what the environment names.

  Raises:
    UserError: the process is killed, or it raises one itself.
  """
  context = multiprocessing.get_context('spawn')
  initializer = () if programs is None else (environment.keep_programs, (programs,))
  with ProcessPoolExecutor(1, context, *initializer) as executor:
    try:
      return executor.submit(_call, function, *args).result()
    except BrokenProcessPool as e:
      raise UserError(
        f'the process of {function.__name__} was killed; if memory is short, take a smaller'
        ' --batch_size'
      ) from e


def _call(function, *args):
  environment.keep_memory()
  with fit.out_of_memory_is_a_user_error():
    return function(*args)


def describe_machine() -> dict[str, Any]:
  """The machine, the device and the versions that matter; builds the kernels where it must."""
  device = jax.devices()[0]
  library = native.library() if device.platform == 'cpu' else None
  return {
    'processor': compiling.processor_name(),
    'cores': os.cpu_count(),
    'platform': device.platform,
    'devices': f'{len(jax.devices())} x {device.device_kind}',
    'compiled kernels': library and f'{library.instruction_set} ({library.origin})',
    'versions': {
      'Python': platform.python_version(),
      'jax': jax.__version__,
      'jaxlib': jaxlib.__version__,
      'flax': flax.__version__,
    },
    'settings': {name: os.environ[name] for name in SETTINGS if name in os.environ},
  }


def time_steps(
  kind: str, batch_size: int, mixed: bool, steps: int, *, implementation: str = 'auto'
) -> Steps:
  """Whole training steps: forward, loss, backward, Adam.

  Args:
    kind: 'shape' or 'color'.
    batch_size: views.
    mixed: whether in mixed precision.
    steps: how many are timed after the first.
    implementation: of the layers, see cvn/ops/dispatch.py.
  """
  batch = make_batch(batch_size)
  network = NETWORKS[kind](mixed=mixed, implementation=implementation)
  state, step = (
    train.create_state(jax.random.key(0), network),
    train.make_step(network, OBJECTIVES[kind], PAPER),
  )
  seconds = []
  for _ in range(steps + 1):
    start = time.perf_counter()
    state, _ = jax.block_until_ready(step(state, batch))
    seconds.append(time.perf_counter() - start)
  statistic = jax.devices()[0].memory_stats() or {}
  return Steps(seconds[0], tuple(seconds[1:]), peak_memory(), statistic.get('peak_bytes_in_use'))


def time_reference(kind: str) -> Steps:
  """One step of `REFERENCE_BATCH` views with the library's (de)convolutions, float32."""
  with dispatch.convolutions_everywhere():
    return time_steps(kind, REFERENCE_BATCH, False, 1, implementation='xla')


def time_layers(kind: str, batch_size: int, mixed: bool) -> tuple[layers.Peaks, list[layers.Row]]:
  """The machine's peaks and the layers' times."""
  peaks = layers.measure_peaks()
  return peaks, layers.time_layers(NETWORKS[kind](mixed=mixed), batch_size, peaks)


def time_inference(repeats: int) -> tuple[float, ...]:
  """Seconds of each reconstruction of one picture by both networks, after one that is not timed."""
  shape, color = (make_network(kind) for kind in ('shape', 'color'))
  view = np.random.default_rng(0).random((1, IMAGE_SIZE, IMAGE_SIZE, 4), np.float32)
  seconds = []
  for _ in range(repeats + 1):
    start = time.perf_counter()
    jax.block_until_ready(infer.reconstruct(view, shape=shape, color=color))
    seconds.append(time.perf_counter() - start)
  return tuple(seconds[1:])


def time_data(kind: str, batch_size: int, mixed: bool, steps: int, path: str) -> DataTimes:
  """Steps as the training program takes them, and the same on one batch of its over and over.

  Args:
    kind: 'shape' or 'color'.
    batch_size: views.
    mixed: whether in mixed precision.
    steps: of each round, DATA_STEPS or more.
    path: of the data set.

  Raises:
    UserError: there is no such data set, or it has too few models.
  """
  dataset = open_dataset(path)
  program.check_sizes(dataset)
  rows, read = data.select_rows(dataset, 'train'), READERS[kind]
  batches = data.training_batches(read, dataset, rows, batch_size=batch_size, seed=0)
  placement = parallel.make_placement()
  put_batch = functools.partial(parallel.put_batch, placement)
  network = NETWORKS[kind](mixed=mixed)
  state = parallel.put_whole(placement, train.create_state(jax.random.key(0), network))
  step = train.make_step(network, OBJECTIVES[kind], PAPER)

  def seconds_a_step(next_batch):
    nonlocal state
    start = time.perf_counter()
    for _ in range(max(steps, DATA_STEPS)):
      batch = next_batch()
      jax.block_until_ready(state)  # as the training program does
      state, _ = step(state, batch)
    jax.block_until_ready(state)
    return (time.perf_counter() - start) / max(steps, DATA_STEPS)

  with contextlib.closing(data.iterate(batches)) as iterator:
    same = put_batch(next(iterator))
    state, _ = step(state, same)
    rounds = [
      (seconds_a_step(lambda: same), seconds_a_step(lambda: put_batch(next(iterator))))
      for _ in range(1 + DATA_ROUNDS)
    ][1:]  # the first one warms up
  return DataTimes(*map(statistics.median, zip(*rounds, strict=True)), peak_memory())


def make_network(kind: str) -> infer.Network:
  """A network that was never trained."""
  module = NETWORKS[kind]()
  state = train.create_state(jax.random.key(0), module)
  return infer.Network(kind, module, {'params': state.params, 'batch_stats': state.batch_stats})


def make_batch(size: int) -> Batch:
  """A batch of noise on the device."""
  rng = np.random.default_rng(0)
  return jax.device_put(
    Batch(
      image=rng.random((size, IMAGE_SIZE, IMAGE_SIZE, 3), np.float32),
      index=rng.integers(0, GRID_SIZE, (size, SURFACE_VOXELS, 3)).astype(np.int32),
      color=rng.random((size, SURFACE_VOXELS, 3), np.float32),
      flow=rng.random((size, SURFACE_VOXELS, 2), np.float32),
    )
  )


def peak_memory() -> int:
  """The most memory that this process has had, bytes."""
  unit = 1 if sys.platform == 'darwin' else 1024
  return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit
