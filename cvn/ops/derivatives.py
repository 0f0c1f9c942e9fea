"""All derivatives of an operation whose value and gradient have programs of their own.

`jax.custom_vjp` knows reverse mode alone: a Jacobian-vector product of its function is an error,
and so is a second derivative if the gradient is an opaque kernel. Here reverse mode takes the
gradient's own program, and every other derivative is that of a plain version of the operation,
which consists of JAX operations. The tangent is a primitive so that its transpose can be chosen.
"""

import functools
from collections.abc import Callable

import jax
from jax.custom_derivatives import SymbolicZero
from jax.extend.core import Primitive, unmapped_aval
from jax.interpreters import ad, batching, mlir

_tangent = Primitive('cvn_tangent')
_tangent.multiple_results = True


def with_derivatives(
  value: Callable, gradient: Callable, *, plain_value: Callable, plain_gradient: Callable
) -> Callable:
  """`value` with derivatives of every kind and order.

  Args:
    value: (*arrays) -> a tuple of results, all of floating-point numbers.
    gradient: (arrays, results, cotangents) -> a tuple of one cotangent for each array.
    plain_value, plain_gradient: the same functions in JAX operations alone. Forward mode and
      higher orders are derived from them.

  Returns:
    A function of the same arrays.
  """

  @jax.custom_jvp
  def pull(arrays, results, cotangents):
    return gradient(arrays, results, cotangents)

  @pull.defjvp
  def _(primals, tangents):
    return pull(*primals), jax.jvp(plain_gradient, primals, tangents)[1]

  @jax.custom_jvp
  def function(*arrays):
    return value(*arrays)

  @functools.partial(function.defjvp, symbolic_zeros=True)
  def _(arrays, tangents):
    results = function(*arrays)
    moving = [n for n, t in enumerate(tangents) if not isinstance(t, SymbolicZero)]

    def forward(known, linear):
      def of_moving(*some):
        chosen = dict(enumerate(known[: len(arrays)])) | dict(zip(moving, some, strict=True))
        return plain_value(*chosen.values())

      return jax.jvp(of_moving, tuple(known[n] for n in moving), linear)[1]

    def backward(known, cotangents):
      found = pull(known[: len(arrays)], known[len(arrays) :], cotangents)
      return tuple(found[n] for n in moving)

    derived = _tangent.bind(
      *arrays,
      *results,
      *(tangents[n] for n in moving),
      forward=forward,
      backward=backward,
      count=len(moving),
      types=tuple(jax.typeof(r).to_tangent_aval() for r in results),
    )
    return results, tuple(derived)

  return function


def _evaluate(*operands, forward, count, **_):
  """Forward mode."""
  return list(forward(operands[:-count], operands[-count:]))


def _differentiate(primals, tangents, **parameters):
  """Forward mode of forward mode."""
  evaluate = functools.partial(_evaluate, **parameters)
  tangents = tuple(ad.instantiate_zeros(t) for t in tangents)
  return jax.jvp(evaluate, tuple(primals), tangents)


def _transpose(cotangents, *operands, backward, count, **_):
  """Reverse mode."""
  known = operands[:-count]
  cotangents = tuple(ad.instantiate_zeros(c) for c in cotangents)
  return [None] * len(known) + list(backward(known, cotangents))


def _batch(operands, axes, *, forward, backward, count, types):
  """The tangent of a mapped function is one as well, whose two directions are mapped."""
  pairs = list(zip(operands, axes, strict=True))
  size = next(x.shape[axis] for x, axis in pairs if axis is not None)
  # If all tangents are mapped, JAX sums the cotangents of one that was shared.
  linear = [batching.bdim_at_front(x, axis, size) for x, axis in pairs[-count:]]
  known = tuple(axes[:-count])
  derived = _tangent.bind(
    *operands[:-count],
    *linear,
    forward=jax.vmap(forward, (known, 0)),
    backward=jax.vmap(backward, (known, 0)),
    count=count,
    types=tuple(unmapped_aval(size, 0, t) for t in types),
  )
  return derived, [0] * len(derived)


_tangent.def_impl(_evaluate)
_tangent.def_abstract_eval(lambda *_, types, **__: list(types))
ad.primitive_jvps[_tangent] = _differentiate
ad.primitive_transposes[_tangent] = _transpose
batching.primitive_batchers[_tangent] = _batch
mlir.register_lowering(_tangent, mlir.lower_fun(_evaluate, multiple_results=True))
