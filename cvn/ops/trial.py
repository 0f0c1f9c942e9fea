"""Times each kernel of a library against the plain product, and checks that both agree.

python -m cvn.ops.trial LIBRARY

timings.py runs this in a process of its own, so that a library that crashes or hangs hurts nobody.
It prints one line of JSON: {"seconds": {operation: {"float32" or "mixed": [kernels, plain]}}}, for
the value and all gradients of a small layer, or {"refused": REASON}. A kernel is timed in turn with
the plain product, and the shortest time of each counts: other programs can only add to it.
"""

import json
import pathlib
import sys
import time
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from cvn.ops import compile as compiling
from cvn.ops import conv2d, deconv, native, normalization
from cvn.ops.normalization import ELU, SIGMOID

MIN_REPEATS, SECONDS = 3, 0.8  # for each layer; the seconds are for all of its programs
TOLERANCES = {'float32': 1e-3, 'mixed': 2e-2}  # of the largest number of an array


class Layer(NamedTuple):
  """A layer of the networks, smaller."""

  operation: str
  function: Callable  # (mixed, implementation, x, *arrays) -> arrays
  shapes: tuple[tuple[int, ...], ...]  # of x and the other arrays


# The last layers of the shape network at half their size, and work of the encoder in proportion: so
# the sum of their times tells which type of volumes is faster.
LAYERS = (
  Layer(
    'deconv',
    lambda mixed, chosen, *arrays: deconv.deconv(*arrays, ELU, implementation=chosen),
    ((8, 16, 16, 16, 32), (32,), (32,), (3, 3, 3, 32, 24)),
  ),
  Layer(
    'conv',
    lambda mixed, chosen, *arrays: deconv.conv(*arrays, ELU, implementation=chosen),
    ((8, 32, 32, 32, 24), (24,), (24,), (3, 3, 3, 24, 1)),
  ),
  Layer(
    'activated',
    lambda mixed, chosen, *arrays: (
      normalization.activate(*arrays, SIGMOID, implementation=chosen),
    ),
    ((8, 32, 32, 32, 1), (1,), (1,)),
  ),
  Layer(
    'conv2d',
    lambda mixed, chosen, *arrays: (conv2d.conv2d(*arrays, mixed=mixed, implementation=chosen),),
    ((8, 32, 32, 64), (5, 5, 64, 64)),
  ),
)


def main(argv: list[str]) -> int:
  """Prints the result for the library that is named; the exit status is 0 whatever it is."""
  try:
    library = native.load(pathlib.Path(argv[1]), suffix='')
    found = {'seconds': {layer.operation: measure(library, layer) for layer in LAYERS}}
  except (OSError, AttributeError, RuntimeError, ArithmeticError) as e:
    if 'RESOURCE_EXHAUSTED' in str(e):  # the machine's fault
      raise
    found = {'refused': compiling.reason(e)}
  print(json.dumps(found))
  return 0


def measure(library: native.Library, layer: Layer) -> dict[str, tuple[float, float]]:
  """Seconds with kernels and with plain products, in 'float32' and 'mixed'.

  All four take turns, so that what slows one down for a while does so with the others.

  Raises:
    ArithmeticError: the kernels and the plain products disagree.
  """
  steps = []
  for dtype, tolerance in TOLERANCES.items():
    arguments, results = _draw(layer, dtype == 'mixed'), []
    for chosen in (library, 'plain'):
      program = _make_step(layer, dtype == 'mixed', chosen).lower(*arguments).compile()
      results.append(jax.block_until_ready(program(*arguments)))
      steps.append((program, arguments))
    difference = np.max([*map(_difference, *results)])  # NaN if there is one
    if not difference <= tolerance:
      raise ArithmeticError(f'{layer.operation} in {dtype} is wrong by {difference:.1e}')

  seconds, start = [], time.perf_counter()
  while len(seconds) < MIN_REPEATS or time.perf_counter() - start < SECONDS:
    seconds.append([_time(*step) for step in steps])
  shortest = map(min, *seconds)
  return {dtype: (next(shortest), next(shortest)) for dtype in TOLERANCES}


def _time(program, arguments):
  start = time.perf_counter()
  jax.block_until_ready(program(*arguments))
  return time.perf_counter() - start


def _draw(layer, mixed):
  rng = np.random.default_rng(0)
  first, *rest = (rng.standard_normal(shape, np.float32) for shape in layer.shapes)
  volumes = layer.operation != 'conv2d'  # the arrays of conv2d are float32 in any case
  return jnp.asarray(first, jnp.bfloat16 if mixed and volumes else jnp.float32), *rest


def _make_step(layer, mixed, implementation):
  """The value and all gradients; the cotangent is the value, of about the same size."""

  def step(*arguments):
    value, pull = jax.vjp(lambda *a: layer.function(mixed, implementation, *a), *arguments)
    # Sums over all voxels have a cotangent as large as that of a voxel.
    cotangent = [v / (1 if n == 0 else value[0].size) for n, v in enumerate(value)]
    return *value, *pull(tuple(cotangent))

  return jax.jit(step)


def _difference(a, b):
  a, b = (np.asarray(v, np.float32) for v in (a, b))
  return np.abs(a - b).max() / max(np.abs(b).max(), 1e-30)


if __name__ == '__main__':
  sys.exit(main(sys.argv))
