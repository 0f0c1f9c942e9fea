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

REPEATS = 7  # at most
SECONDS = 0.4  # after which a pair is repeated no more
TOLERANCES = {'float32': 1e-3, 'mixed': 2e-2}  # of the largest number of an array


class Layer(NamedTuple):
  """A layer of the networks, smaller: 1 to 3 GFLOP with its gradients."""

  operation: str
  function: Callable  # (mixed, x, *arrays) -> arrays
  shapes: tuple[tuple[int, ...], ...]  # of x and the other arrays


LAYERS = (
  Layer(
    'deconv',
    lambda mixed, *arrays: deconv.deconv(*arrays, ELU),
    ((8, 16, 16, 16, 32), (32,), (32,), (3, 3, 3, 32, 16)),
  ),
  Layer(
    'conv',
    lambda mixed, *arrays: deconv.conv(*arrays, ELU),
    ((8, 32, 32, 32, 16), (16,), (16,), (3, 3, 3, 16, 3)),
  ),
  Layer(
    'activated',
    lambda mixed, *arrays: (normalization.activate(*arrays, SIGMOID),),
    ((8, 32, 32, 32, 3), (3,), (3,)),
  ),
  Layer(
    'conv2d',
    lambda mixed, *arrays: (conv2d.conv2d(*arrays, mixed),),
    ((8, 32, 32, 64), (5, 5, 64, 64)),
  ),
)


def main(argv: list[str]) -> int:
  """Prints the result for the library that is named; the exit status is 0 whatever it is."""
  path = pathlib.Path(argv[1])
  try:
    library = native.load(path, suffix='')
  except (OSError, AttributeError, RuntimeError) as e:
    print(json.dumps({'refused': compiling.reason(e)}))
    return 0
  seconds = {}
  for layer in LAYERS:
    seconds[layer.operation] = {}
    for dtype in TOLERANCES:
      times, difference = measure(library, layer, dtype)
      if not difference <= TOLERANCES[dtype]:
        wrong = (
          f'wrong values of {layer.operation} in {dtype}: {difference:.1e} from the plain ones'
        )
        print(json.dumps({'refused': wrong}))
        return 0
      seconds[layer.operation][dtype] = times
  print(json.dumps({'seconds': seconds}))
  return 0


def measure(library: native.Library, layer: Layer, dtype: str) -> tuple[tuple[float, float], float]:
  """((seconds with kernels, seconds with plain products), the largest difference).

  The difference is relative to the largest number of the array that has it.
  """
  arguments = _draw(layer, dtype == 'mixed')
  programs, results = [], []
  for chosen in (library, None):
    with native.using(chosen):
      programs.append(_make_step(layer, dtype == 'mixed').lower(*arguments).compile())
    results.append(jax.block_until_ready(programs[-1](*arguments)))
  difference = max(map(_difference, *results))

  shortest, start = [np.inf, np.inf], time.perf_counter()
  for _ in range(REPEATS):
    for n, program in enumerate(programs):
      before = time.perf_counter()
      jax.block_until_ready(program(*arguments))
      shortest[n] = min(shortest[n], time.perf_counter() - before)
    if time.perf_counter() - start > SECONDS:
      break
  return tuple(shortest), difference


def _draw(layer, mixed):
  rng = np.random.default_rng(0)
  first, *rest = (rng.standard_normal(shape, np.float32) for shape in layer.shapes)
  volumes = layer.operation != 'conv2d'  # the arrays of conv2d are float32 in any case
  return jnp.asarray(first, jnp.bfloat16 if mixed and volumes else jnp.float32), *rest


def _make_step(layer, mixed):
  """The value and all gradients; the cotangent is the value, of about the same size."""

  def step(*arguments):
    value, pull = jax.vjp(lambda *a: layer.function(mixed, *a), *arguments)
    # Sums over all voxels have a cotangent as large as that of a voxel.
    cotangent = [v / (1 if n == 0 else value[0].size) for n, v in enumerate(value)]
    return *value, *pull(tuple(cotangent))

  return jax.jit(step)


def _difference(a, b):
  a, b = (np.asarray(v, np.float32) for v in (a, b))
  return float(np.abs(a - b).max() / max(np.abs(b).max(), 1e-30))  # NaN if either has one


if __name__ == '__main__':
  sys.exit(main(sys.argv))
