"""Which program computes an operation, and how a compiled kernel is called from JAX.

`implementation` is an argument of every operation and every network:

  'auto'     on a CPU the compiled kernels (native.py) if this machine has them and they win,
             otherwise as 'plain'; derivatives that no kernel computes are those of plain operations
  'kernels'  the compiled kernels, or an error
  'plain'    plain JAX operations, with gradients of their own: on a CPU matrix products
             (matmul.py), and XLA's convolution elsewhere
  'xla'      plain JAX operations, with the derivatives that JAX makes
  a Library  the kernels of this library (native.load), or an error

The platform is known when a function is lowered, and the choice is made then. Only where the
default device is a CPU does 'auto' look for kernels at all: an accelerator's process compiles none.
"""

import contextlib
import contextvars
import functools
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jax.sharding import AxisType, NamedSharding, PartitionSpec

from cvn.ops import native

IMPLEMENTATIONS = ('auto', 'kernels', 'plain', 'xla')
Implementation = str | native.Library
VOLUMES = (jnp.float32, jnp.bfloat16)  # types that volumes may have

_convolutions = contextvars.ContextVar('convolutions', default=False)


def check(implementation: Implementation) -> None:
  """Refuses an unknown implementation.

  Raises:
    ValueError: it is neither one of `IMPLEMENTATIONS` nor a library.
  """
  if not isinstance(implementation, native.Library) and implementation not in IMPLEMENTATIONS:
    raise ValueError(f'implementation must be one of {IMPLEMENTATIONS}: {implementation!r}')


def choose(
  operation: str,
  kernel: Callable,
  plain: Callable,
  *arrays: Any,
  implementation: Implementation,
  mixed: bool,
  misfit: str = '',
) -> Any:
  """Calls one of two programs of an operation; 'xla' has no kernel to choose.

  Args:
    operation: 'deconv', 'conv', 'conv2d' or 'activated'.
    kernel: (library, *arrays), for a CPU.
    plain: (*arrays), for every platform.
    *arrays: arguments of both.
    implementation: any but 'xla'.
    mixed: whether factors of products are bfloat16.
    misfit: why the kernel does not take these shapes, if it does not.

  Raises:
    RuntimeError: kernels are asked for, and this process has none.
    ValueError: kernels are asked for, and the shapes do not fit.
  """
  if implementation == 'plain':
    return plain(*arrays)
  if implementation == 'auto':
    library = native.library() if not misfit and _default_platform() == 'cpu' else None
    if library is None or not native.wins(library, operation, mixed=mixed):
      return plain(*arrays)
    return lax.platform_dependent(*arrays, cpu=functools.partial(kernel, library), default=plain)
  library = native.library() if implementation == 'kernels' else implementation
  if library is None:
    raise RuntimeError(
      f"implementation='kernels': no compiled kernels ({native.missing()}); 'auto' and 'xla' do"
      ' without'
    )
  if misfit:
    raise ValueError(f"implementation='kernels': {misfit}; 'auto' and 'xla' take it")
  return lax.platform_dependent(*arrays, cpu=functools.partial(kernel, library))


def product(on_cpu: Callable, elsewhere: Callable, *arrays: Any) -> jax.Array:
  """Calls one of two plain programs of a product.

  Args:
    on_cpu: (*arrays), as matrix products.
    elsewhere: (*arrays), as a convolution.
    *arrays: arguments of both.
  """
  if _convolutions.get():
    return elsewhere(*arrays)
  return lax.platform_dependent(*arrays, cpu=on_cpu, default=elsewhere)


@contextlib.contextmanager
def convolutions_everywhere() -> Iterator[None]:
  """Makes `product` take XLA's convolution on a CPU too, which benchmarks compare with.

  It holds for what is traced within it; a function that was traced before keeps its choice.
  """
  token = _convolutions.set(True)
  try:
    yield
  finally:
    _convolutions.reset(token)


def as_float(name: str, x: jax.Array, *, allowed: Sequence[Any] = VOLUMES[:1]) -> jax.Array:
  """x if its type is one of those allowed, else as float32; refuses what is no real number.

  Gradients of what was cast have its own type.

  Args:
    name: of x, for the message.
    x: an array.
    allowed: the types that stay.

  Raises:
    TypeError: x has integers, booleans or complex numbers.
  """
  x = jnp.asarray(x)
  if not jnp.issubdtype(x.dtype, jnp.floating):
    raise TypeError(
      f'{name} must be float32 or bfloat16 (other floating types are cast to float32): {x.dtype}'
    )
  return x if x.dtype in allowed else x.astype(jnp.float32)


def alike(*arrays: jax.Array) -> list[jax.Array]:
  """The arrays as a kernel needs them within `jax.shard_map`: all vary over the same axes."""
  axes = frozenset().union(*(jax.typeof(x).mat.varying for x in arrays))
  return [lax.pcast(x, tuple(axes - jax.typeof(x).mat.varying), to='varying') for x in arrays]


def call(
  library: native.Library,
  name: str,
  results: Sequence[jax.ShapeDtypeStruct],
  *arrays: jax.Array,
  volumes: Sequence[int] = (0,),
  in_place: int | None = None,
  **attributes: Any,
) -> tuple[jax.Array, ...]:
  """Calls a kernel of a library; only a CPU has it.

  Where a batch is spread over the devices of a mesh, each device calls it for its own samples. The
  mesh is that of `jax.set_mesh` or of the arrays that are placed on it; a function that `jax.jit`
  places by `in_shardings` alone needs the former.

  Under `jax.vmap`, a mapped axis of volumes becomes part of their batch; if other arrays are
  mapped, the kernel is called for one element of the axis after another.

  Args:
    library: whose kernel it is.
    name: one of `native.KERNELS`.
    results: their shapes and types; the first axis is the batch.
    *arrays: the kernel's operands.
    volumes: which of them have the batch as first axis; the others are needed whole.
    in_place: which of them the first result may overwrite, if nothing else needs it.
    **attributes: numpy scalars.
  """
  options = {'volumes': volumes, 'in_place': in_place, **attributes}

  def of_batch(size, **types):
    return [jax.ShapeDtypeStruct((size, *r.shape[1:]), r.dtype, **types) for r in results]

  def run(*arrays):
    arrays = alike(*arrays)
    kind = jax.typeof(arrays[0])
    mesh = kind.sharding.mesh
    types = (
      {}
      if mesh.empty
      else {
        'sharding': NamedSharding(mesh, PartitionSpec()),
        'manual_axis_type': kind.mat,
      }
    )
    found = jax.ffi.ffi_call(
      name + library.suffix,
      of_batch(len(arrays[volumes[0]]), **types),
      input_output_aliases={} if in_place is None else {in_place: 0},
    )(*arrays, **attributes)
    return tuple(found)

  @jax.custom_batching.custom_vmap
  def mappable(*arrays):
    return _over_devices(run, len(results), *arrays, volumes=volumes)

  @mappable.def_vmap
  def _(size, is_mapped, *arrays):
    batch = results[0].shape[0]
    if any(is_mapped[n] for n in range(len(arrays)) if n not in volumes):
      mapped = [x for x, m in zip(arrays, is_mapped, strict=True) if m]

      def one(some):
        some = iter(some)
        whole = [next(some) if m else x for x, m in zip(arrays, is_mapped, strict=True)]
        return call(library, name, results, *whole, **options)

      found = lax.map(one, mapped)
    else:

      def flat(x, is_mapped):
        x = x if is_mapped else jnp.broadcast_to(x, (size, *x.shape))
        return x.reshape(size * batch, *x.shape[2:])

      whole = [
        flat(x, m) if n in volumes else x
        for n, (x, m) in enumerate(zip(arrays, is_mapped, strict=True))
      ]
      found = call(library, name, of_batch(size * batch), *whole, **options)
      found = tuple(x.reshape(size, batch, *x.shape[1:]) for x in found)
    return found, (True,) * len(found)

  return mappable(*arrays)


def sum_samples(x: jax.Array) -> jax.Array:
  """x.sum(0), as a product: the compiler's own sum over the first axis is slow."""
  return (jnp.ones((1, len(x)), x.dtype) @ x.reshape(len(x), -1)).reshape(x.shape[1:])


def _default_platform():
  """'cpu', or that of an accelerator: where a function runs if nothing else is said."""
  device = jax.config.jax_default_device  # a Device, the name of a platform, or None
  return getattr(device, 'platform', device) or jax.default_backend()


def _over_devices(run, count, *arrays, volumes):
  """run(*arrays) -> `count` results, each device with its share of the batch if it can have one."""
  mesh, axes = _batch_axes(len(arrays[volumes[0]]), arrays)
  if not axes:
    return run(*arrays)
  batch = PartitionSpec(axes)
  specs = tuple(batch if n in volumes else PartitionSpec() for n in range(len(arrays)))
  return jax.shard_map(
    run, mesh=mesh, in_specs=specs, out_specs=(batch,) * count, axis_names=set(axes)
  )(*arrays)


def _batch_axes(size, arrays):
  """The mesh, and those of its axes along which the batch is spread.

  Types of arrays name their mesh, but not the axis that their batch is spread along: it is spread
  along all of them, as long as they divide it.
  """
  meshes = [jax.sharding.get_abstract_mesh(), *(jax.typeof(x).sharding.mesh for x in arrays)]
  mesh = next((m for m in meshes if not m.empty), None)
  axes = []
  for name, kind in zip(mesh.axis_names, mesh.axis_types, strict=True) if mesh else ():
    count = math.prod(mesh.shape[n] for n in (*axes, name))
    if kind == AxisType.Auto and count > 1 and size % count == 0:
      axes.append(name)
  return mesh, tuple(axes)
