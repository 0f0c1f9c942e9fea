"""Each layer of a network alone: its operations and bytes, the least time they take, and the time.

The floor is the larger of operations over the machine's measured peak and of bytes over its
measured bandwidth, where every array is read or written once (what normalisation reads twice is
counted twice: statistics come first). A layer with weights is timed without its normalisation,
which has a line of its own; only that of volumes is part of the layers before and after it.
"""

import statistics
import time
from typing import NamedTuple

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np

from cvn.camera import IMAGE_SIZE
from cvn.layers import Collect, Conv2D, Conv3D, Deconv3D, Dense, Norm, PendingNorm, VolumeNorm

REPEATS = 5
HEADER = (
  '| layer | output | GFLOP | MB | floor, ms | forward, ms | ratio | of peak'
  ' | floor, ms | backward, ms | ratio | of peak |\n'
  '| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |'
)


class Peaks(NamedTuple):
  """What the machine does at most."""

  float32: float  # operations a second, of a large matrix product
  bfloat16: float  # the same, of bfloat16 factors with float32 sums
  bandwidth: float  # bytes a second, of a large array that is read and written


class Layer(NamedTuple):
  """A layer as a network calls it."""

  name: str
  module: nn.Module  # unbound
  inputs: tuple[jax.ShapeDtypeStruct | PendingNorm, ...]  # of its call
  output: jax.ShapeDtypeStruct


class Cost(NamedTuple):
  """One direction of a layer."""

  operations: int
  bytes: int
  floor: float  # s
  seconds: float


class Row(NamedTuple):
  """A line of the table."""

  name: str
  output: tuple[int, ...]
  dtype: str  # of the factors of its products
  forward: Cost
  backward: Cost


def measure_peaks(size: int = 4096, megabytes: int = 256) -> Peaks:
  """Times a product of two [size, size] matrices, and a pass over an array of that many MiB."""

  def product(dtype):
    a = jnp.ones((size, size), dtype)
    multiply = jax.jit(lambda a, b: jnp.dot(a, b, preferred_element_type=jnp.float32))
    return 2 * size**3 / min(time_calls(multiply, a, a))

  x = jnp.ones((megabytes << 18,), jnp.float32)
  in_place = jax.jit(lambda x: x + 1, donate_argnums=0)
  x, seconds = jax.block_until_ready(in_place(x)), []
  for _ in range(REPEATS):
    start = time.perf_counter()
    x = jax.block_until_ready(in_place(x))
    seconds.append(time.perf_counter() - start)
  return Peaks(product(jnp.float32), product(jnp.bfloat16), 2 * x.nbytes / min(seconds))


def time_layers(network: nn.Module, batch_size: int, peaks: Peaks) -> list[Row]:
  """Times every layer of a network; the order is that of the forward pass.

  Args:
    network: from cvn.networks.
    batch_size: views.
    peaks: of this machine.
  """
  return [
    _time_layer(layer, peaks, needs_input_gradient=n > 0)
    for n, layer in enumerate(layers_of(network, batch_size))
  ]


def layers_of(network: nn.Module, batch_size: int) -> list[Layer]:
  """The layers that a network calls in training: those with weights, and their normalisations."""
  found = []

  def note(call, args, kwargs, context):
    place, module = len(found), context.module
    y = call(*args, **kwargs)
    if isinstance(module, (Collect, Conv2D, Conv3D, Deconv3D, Dense, Norm)):
      inputs, output = jax.tree.map(
        lambda a: jax.ShapeDtypeStruct(a.shape, a.dtype), (args[:-1], _array(y))
      )
      path = tuple(p for p in module.path if p != 'trunk')
      # Before the normalisation in it, which has ended by now.
      found.insert(place, Layer('/'.join(path), module.clone(parent=None), inputs, output))
    return y

  image = jax.ShapeDtypeStruct((batch_size, IMAGE_SIZE, IMAGE_SIZE, 3), jnp.float32)
  with nn.intercept_methods(note):
    jax.eval_shape(lambda k, x: network.init(k, x, train=True), jax.random.key(0), image)
  return found


def count_operations(layer: Layer) -> int:
  """Of the forward pass: two for each factor of a kernel at each place it is applied to.

  Places outside the volume count as inside. Those of normalisation are not counted: it waits for
  memory.
  """
  if isinstance(layer.module, Norm):
    return 0
  places = _array(layer.inputs[0]) if isinstance(layer.module, Deconv3D) else layer.output
  kernel = _parameters(layer)['kernel']
  return 2 * int(np.prod(places.shape[:-1])) * kernel.size


def count_bytes(layer: Layer, needs_input_gradient: bool) -> tuple[int, int]:
  """Read and written by the forward and by the backward pass."""
  x, y = _nbytes(_array(layer.inputs[0])), _nbytes(layer.output)
  if isinstance(layer.module, Norm):
    return 2 * x + y, 2 * (x + y) + x
  kernel = _nbytes(_parameters(layer)['kernel'])
  read = x + y + kernel
  if isinstance(layer.inputs[0], PendingNorm):
    read += y  # its statistics' part of the gradient depends on it
  return x + kernel + y, read + (x + kernel if needs_input_gradient else 0)


def format_rows(rows: list[Row], peaks: Peaks) -> str:
  """The table, in Markdown, with a line for all layers together."""
  total = [
    Cost(*(sum(values) for values in zip(*costs, strict=True)))
    for costs in zip(*((r.forward, r.backward) for r in rows), strict=True)
  ]
  lines = [HEADER]
  for r in rows:
    size = 'x'.join(map(str, r.output[1:]))
    peak = peaks.bfloat16 if r.dtype == 'bfloat16' else peaks.float32
    lines.append(_format(f'{r.name} | {size}', r.forward, r.backward, peak))
  return '\n'.join([*lines, _format('all layers |', *total, None)])


def time_calls(f, *args) -> list[float]:
  """Seconds of each of some calls, after one that is not counted."""
  jax.block_until_ready(f(*args))
  seconds = []
  for _ in range(REPEATS):
    start = time.perf_counter()
    jax.block_until_ready(f(*args))
    seconds.append(time.perf_counter() - start)
  return seconds


def _time_layer(layer, peaks, needs_input_gradient) -> Row:
  function = _alone(layer.module)
  parameters, inputs, dy = jax.tree.map(_numbers, (_parameters(layer), layer.inputs, layer.output))

  def pull(parameters, *inputs):
    if needs_input_gradient:
      return jax.vjp(function, parameters, *inputs)[1]
    return jax.vjp(lambda p: function(p, *inputs), parameters)[1]

  pulled = jax.jit(pull)(parameters, *inputs)
  forward = statistics.median(time_calls(jax.jit(function), parameters, *inputs))
  backward = statistics.median(time_calls(jax.jit(lambda pulled, dy: pulled(dy)), pulled, dy))
  operations, moved = count_operations(layer), count_bytes(layer, needs_input_gradient)
  of_backward = operations * (2 if needs_input_gradient else 1)
  mixed = isinstance(layer.module, Conv2D) and layer.module.mixed
  dtype = 'bfloat16' if mixed else str(_array(layer.inputs[0]).dtype)
  peak = peaks.bfloat16 if dtype == 'bfloat16' else peaks.float32
  costs = [
    Cost(count, amount, max(count / peak, amount / peaks.bandwidth), seconds)
    for count, amount, seconds in zip(
      (operations, of_backward), moved, (forward, backward), strict=True
    )
  ]
  return Row(layer.name, layer.output.shape, dtype, *costs)


def _alone(module):
  """f(parameters, *inputs): the layer without its normalisation, or the normalisation."""

  def skip(call, args, kwargs, context):
    inner = isinstance(context.module, (Norm, VolumeNorm)) and not isinstance(module, Norm)
    return args[0] if inner else call(*args, **kwargs)

  def function(parameters, *inputs):
    with nn.intercept_methods(skip):
      y, _ = module.apply({'params': parameters}, *inputs, True, mutable='batch_stats')
    return _array(y)

  return function


def _parameters(layer):
  """Shapes of the layer's own parameters, those of its normalisation left out."""
  shapes = jax.eval_shape(
    lambda k, *x: layer.module.init(k, *x, True), jax.random.key(0), *layer.inputs
  )['params']
  return {name: shape for name, shape in shapes.items() if name != 'norm'}


def _array(x):
  """Of a volume what is kept of it."""
  return x.x if isinstance(x, PendingNorm) else x


def _numbers(shape):
  """Noise of that shape, a short piece of it over and over."""
  noise = np.random.default_rng(0).standard_normal(1 << 16, np.float32)
  return jnp.asarray(np.resize(noise, shape.shape), shape.dtype)


def _nbytes(shape):
  return shape.size * shape.dtype.itemsize


def _format(name, forward, backward, peak):
  cells = [name, f'{forward.operations / 1e9:.2f}', f'{forward.bytes / 1e6:.1f}']
  for cost in (forward, backward):
    rate = cost.operations / cost.seconds
    cells += [
      f'{1e3 * cost.floor:.2f}',
      f'{1e3 * cost.seconds:.2f}',
      f'{cost.seconds / cost.floor:.1f}',
      f'{rate / peak:.0%}' if peak and rate else '',
    ]
  return f'| {" | ".join(cells)} |'
