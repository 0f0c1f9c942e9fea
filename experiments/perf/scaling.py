r"""What training costs on many devices and on finer grids, counted without computing anything.

python -m experiments.perf.scaling [--grid_size=64,128,256] [--seconds=0.06] [--batch_size=60]

The tables hold, for each network and grid, parameters, operations, and the bytes that a step keeps
and moves; and the efficiency of data parallelism for a measured step of --seconds on one device. An
all-reduce of n bytes over d devices moves 2 n (d - 1) / d bytes through each link. Nothing is
assumed to overlap, so the efficiency is a lower bound.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
from absl import flags

from cvn import train
from cvn.grid import GRID_SIZE
from cvn.networks import NETWORKS
from experiments.lib import cli
from experiments.lib.markdown import table
from experiments.perf import layers
from experiments.perf.measuring import IMAGE_SIZE, SURFACE_VOXELS

KINDS = ('shape', 'color')
DEVICES = (8, 64, 256)
LINKS = {'1 Gbit/s': 1e9 / 8, '10 Gbit/s': 1e10 / 8, '100 Gbit/s': 1e11 / 8, 'NVLink': 4.5e11}


class Cost(NamedTuple):
  """A network's training, counted."""

  kind: str
  grid_size: int
  parameters: int
  reduced: int  # bytes, all-reduced in a step: gradients and batch statistics
  state: int  # bytes, on every device
  operations: int  # of an image, forward and backward
  volumes: int  # bytes of an image, kept for the backward pass
  sample: int  # bytes, read from the data set and unpacked


def count(kind: str, grid_size: int, *, mixed: bool = False) -> Cost:
  """Counts from shapes alone.

  Args:
    kind: 'shape' or 'color'.
    grid_size: voxels along an axis; surfaces grow with its square.
    mixed: whether volumes are bfloat16.
  """
  network = NETWORKS[kind](grid_size=grid_size, mixed=mixed)
  state = jax.eval_shape(lambda: train.create_state(jax.random.key(0), network))
  found = layers.layers_of(network, 1)
  operations = [layers.count_operations(layer) for layer in found]
  # The gradients of input and kernel; the first layer's input, the image, has none.
  total = 3 * sum(operations) - operations[0]
  surface = SURFACE_VOXELS * (grid_size // GRID_SIZE) ** 2
  parameters = sum(x.size for x in jax.tree.leaves(state.params))
  statistics = sum(x.size for x in jax.tree.leaves(state.batch_stats))
  return Cost(
    kind,
    grid_size,
    parameters,
    4 * (parameters + 2 * statistics),  # sums forward, and their cotangents backward
    sum(x.size * x.dtype.itemsize for x in jax.tree.leaves(state)),
    total,
    sum(layer.output.size * layer.output.dtype.itemsize for layer in found),
    4 * IMAGE_SIZE**2 + surface * (3 if kind == 'shape' else 3 + 3 + 4),
  )


def efficiency(reduced: int, devices: int, bandwidth: float, seconds: float) -> float:
  """The share of its time that a device computes.

  Args:
    reduced: bytes, all-reduced in a step.
    devices: how many there are.
    bandwidth: of a link, bytes/s.
    seconds: of a step on one device.
  """
  return seconds / (seconds + 2 * reduced * (devices - 1) / devices / bandwidth)


def define_flags(f: flags.FlagValues) -> None:
  own = {'flag_values': f}
  flags.DEFINE_list('grid_size', ['64', '128', '256'], 'Voxels along an axis.', **own)
  flags.DEFINE_float('seconds', 0.06, 'Measured time of a step on one device.', 1e-6, **own)
  flags.DEFINE_integer('batch_size', 60, 'Views in a step on one device.', 1, **own)


@cli.program(define_flags)
def main(f: flags.FlagValues) -> None:
  costs = [count(k, int(n)) for n in f.grid_size for k in KINDS]
  print(format_costs(costs), '\n')
  for cost in costs[: len(KINDS)]:
    print(format_efficiency(cost, f.seconds, f.batch_size), '\n')


def format_costs(costs: Sequence[Cost]) -> str:
  """The costs as a table in Markdown."""
  head = ['network', 'grid', 'parameters', 'all-reduced a step, MB', 'state, MB']
  head += ['GFLOP an image', 'activations an image, MiB', 'data an image, kB']
  rows = [
    [
      c.kind,
      f'{c.grid_size}^3',
      f'{c.parameters / 1e6:.1f} M',
      f'{c.reduced / 1e6:.1f}',
      f'{c.state / 1e6:.0f}',
      f'{c.operations / 1e9:.1f}',
      f'{c.volumes / 2**20:.0f}',
      f'{c.sample / 1e3:.0f}',
    ]
    for c in costs
  ]
  return table(head, rows)


def format_efficiency(cost: Cost, seconds: float, batch_size: int) -> str:
  """Efficiency and read rate of one network as a table in Markdown."""
  rate = batch_size / seconds
  rows = [
    [f'{d} devices', *(f'{efficiency(cost.reduced, d, b, seconds):.1%}' for b in LINKS.values())]
    + [f'{d * rate * cost.sample / 1e9:.2f}']
    for d in DEVICES
  ]
  return table([cost.kind, *LINKS, 'data, GB/s'], rows)


if __name__ == '__main__':
  main()
