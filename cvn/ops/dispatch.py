"""Calls of the compiled kernels from JAX, one device or several."""

import itertools
from collections.abc import Sequence

import jax
import jax.numpy as jnp
from jax.experimental.custom_partitioning import custom_partitioning
from jax.sharding import NamedSharding, PartitionSpec

from cvn.ops import native


def call(
  name: str,
  results: Sequence[jax.ShapeDtypeStruct],
  *arrays: jax.Array,
  volumes: Sequence[int] = (0,),
  in_place: int | None = None,
  **attributes,
) -> Sequence[jax.Array]:
  """Calls a kernel; it is there on a CPU, where `available`.

  Where a batch is spread over devices, each calls it for its own samples.

  Args:
    name: one of `KERNELS`.
    results: their shapes and types; the first axis is the batch's.
    *arrays: what it takes.
    volumes: which of them have the batch as first axis, the first among them; all devices need the
      others whole.
    in_place: which of them the first result may overwrite, where nothing else needs it.
    **attributes: numpy integers.
  """

  aliases = {} if in_place is None else {in_place: 0}

  def run(*arrays):
    local = [jax.ShapeDtypeStruct((len(arrays[0]), *r.shape[1:]), r.dtype) for r in results]
    call = jax.ffi.ffi_call(native.target(name), local, input_output_aliases=aliases)
    return tuple(call(*arrays, **attributes))

  if jax.device_count() == 1:  # the partitioner's callbacks would miss the compilation cache
    return run(*arrays)

  def partition(mesh, arguments, _):
    spec = arguments[0].sharding.spec
    batch = NamedSharding(mesh, PartitionSpec(spec[0] if len(spec) else None))
    whole = NamedSharding(mesh, PartitionSpec())
    shardings = [batch if i in volumes else whole for i in range(len(arrays))]
    return mesh, run, (batch,) * len(results), tuple(shardings)

  spread = custom_partitioning(run)
  spread.def_partition(partition, sharding_rule=_rule(arrays, results, volumes))
  return spread(*arrays)


def sum_samples(x: jax.Array) -> jax.Array:
  """x.sum(0), as a product: the compiler's own sum over the first axis is slow."""
  return (jnp.ones((1, len(x))) @ x.reshape(len(x), -1)).reshape(x.shape[1:])


def _rule(arrays, results, volumes) -> str:
  """How axes of arguments and results go together, for the partitioner: only the batch's do."""
  names = itertools.count()

  def axes(array, has_batch):
    found = [f'a{next(names)}' for _ in array.shape]
    return ' '.join((['batch', *found[1:]] if has_batch else found) or [''])

  left = ', '.join(axes(a, i in volumes) for i, a in enumerate(arrays))
  return f'{left} -> {", ".join(axes(r, True) for r in results)}'
