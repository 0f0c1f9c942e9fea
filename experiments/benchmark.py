r"""How fast a network trains: whole steps (forward, loss, backward, Adam) on synthetic batches.

python -m experiments.benchmark [--network=shape|color|both] [--batch_size=12] [--steps=5]

Prints the machine, the versions, and for each network the time of the first step (tracing and
compiling are in it), and images/s as median and range over steps.
"""

import os
import platform
import statistics
import time

import flax
import jax
import jaxlib
import numpy as np
from absl import flags

from cvn import environment, errors, train
from cvn.camera import IMAGE_SIZE
from cvn.data import Batch
from cvn.grid import GRID_SIZE
from cvn.machine import processor
from cvn.recipe import PAPER

SURFACE_VOXELS = 8192  # a generous chair; the median of our data sets is 6000


def define_flags(f: flags.FlagValues) -> None:
  """The program's flags. Not at import: there the names of several programs would collide."""
  own = {'flag_values': f}
  flags.DEFINE_enum('network', 'both', [*train.NETWORKS, 'both'], 'Which network.', **own)
  flags.DEFINE_integer('batch_size', 12, 'Views a step.', lower_bound=1, **own)
  flags.DEFINE_integer('steps', 5, 'Timed steps, after one that is not.', lower_bound=1, **own)


def main(_) -> None:
  run(flags.FLAGS)


def run(f: flags.FlagValues) -> None:
  """Times the networks that the flags name."""
  print(describe_machine())
  for kind in train.NETWORKS if f.network == 'both' else [f.network]:
    first, seconds = time_steps(kind, f.batch_size, f.steps)
    rates = sorted(f.batch_size / s for s in seconds)
    print(
      f'{kind}, batch {f.batch_size}, float32: {statistics.median(rates):.2f} images/s'
      f' ({rates[0]:.2f} to {rates[-1]:.2f} over {f.steps} steps), first step {first:.1f} s'
    )


def describe_machine() -> str:
  """The processor, its cores, the device and the versions that matter."""
  device = jax.devices()[0]
  tunables = os.environ.get('GLIBC_TUNABLES', 'none')
  return (
    f'{processor()}, {os.cpu_count()} cores; {len(jax.devices())} x {device.device_kind};'
    f' Python {platform.python_version()}, jax {jax.__version__}, jaxlib {jaxlib.__version__},'
    f' flax {flax.__version__}; GLIBC_TUNABLES {tunables}'
  )


def time_steps(kind: str, batch_size: int, steps: int) -> tuple[float, list[float]]:
  """Seconds of the first step, and of each step after it."""
  batch = make_batch(batch_size)
  state, step = train.create_state(jax.random.key(0), kind), train.make_step(kind, PAPER)
  seconds = []
  for _ in range(steps + 1):
    start = time.perf_counter()
    state, _ = jax.block_until_ready(step(state, batch))
    seconds.append(time.perf_counter() - start)
  return seconds[0], seconds[1:]


def make_batch(size: int) -> Batch:
  """A batch of noise, of the shapes that training meets, on the device."""
  rng = np.random.default_rng(0)
  return jax.device_put(
    Batch(
      image=rng.random((size, IMAGE_SIZE, IMAGE_SIZE, 3), np.float32),
      index=rng.integers(0, GRID_SIZE, (size, SURFACE_VOXELS, 3)).astype(np.int32),
      color=rng.random((size, SURFACE_VOXELS, 3), np.float32),
      flow=rng.random((size, SURFACE_VOXELS, 2), np.float32),
    )
  )


if __name__ == '__main__':
  environment.prepare()
  define_flags(flags.FLAGS)
  errors.run(main)
