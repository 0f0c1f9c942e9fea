"""Derivatives of a function that has programs of its own: which is taken, and what comes out."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cvn.ops.derivatives import with_derivatives


def plain_value(x, w):
  return jnp.sin(x) * w[None], jnp.sum(x * w[None], 0)


def plain_gradient(arrays, _, cotangents):
  return jax.vjp(plain_value, *arrays)[1](cotangents)


def scalar(function):
  return lambda x, w: sum(jnp.sum(r**3) for r in function(x, w))


def both(function):
  return jax.grad(function, (0, 1))


X = np.random.default_rng(0).random((5, 4, 3), np.float32)
W = np.random.default_rng(1).random((5, 3), np.float32)
x, w = X[0], W[0]

# transformation of a scalar function of (x, w), its arguments, and whether it takes the gradient.
TRANSFORMATIONS = {
  'grad': (both, (x, w), True),
  'grad of one': (lambda f: jax.grad(f, 1), (x, w), True),
  'jvp': (lambda f: lambda *a: jax.jvp(f, a, a), (x, w), False),
  'linearize': (lambda f: lambda *a: jax.linearize(f, *a)[1](*a), (x, w), False),
  'forward over reverse': (lambda f: jax.jacfwd(both(f), (0, 1)), (x, w), True),
  'reverse over reverse': (lambda f: jax.jacrev(both(f), (0, 1)), (x, w), True),
  'forward over forward': (lambda f: jax.jacfwd(jax.jacfwd(f, 1), 0), (x, w), False),
  'reverse over forward': (lambda f: jax.jacrev(jax.jacfwd(f, 1), 0), (x, w), None),
  'third order': (lambda f: jax.jacfwd(jax.jacrev(jax.grad(f), 1)), (x, w), True),
  'vmap of grad': (lambda f: jax.vmap(both(f)), (X, W), True),
  'grad of vmap': (lambda f: both(lambda *a: jnp.sum(jax.vmap(f)(*a))), (X, W), True),
  'grad of vmap, w shared': (
    lambda f: both(lambda *a: jnp.sum(jax.vmap(f, (0, None))(*a))), (X, w), True
  ),
  'grad of vmap, x shared': (
    lambda f: both(lambda *a: jnp.sum(jax.vmap(f, (None, 0))(*a))), (x, W), True
  ),
  'checkpoint': (lambda f: both(jax.checkpoint(f)), (x, w), True),
  'scan': (
    lambda f: both(lambda X, w: jax.lax.scan(lambda c, x: (c + f(x, w), None), 0.0, X)[0]),
    (X, w),
    True,
  ),
  'cond': (
    lambda f: both(lambda x, w: jax.lax.cond(x[0, 0] > 0, f, lambda *_: 0.0, x, w)), (x, w), True
  ),
}  # fmt: skip


@pytest.mark.parametrize('name', TRANSFORMATIONS)
def test_derivatives_are_those_of_the_plain_function(name):
  transformation, arrays, takes_gradient = TRANSFORMATIONS[name]
  called = []

  def value(*arrays):
    called.append('value')
    return plain_value(*arrays)

  def gradient(*groups):
    called.append('gradient')
    return plain_gradient(*groups)

  function = with_derivatives(
    value, gradient, plain_value=plain_value, plain_gradient=plain_gradient
  )
  got = jax.jit(transformation(scalar(function)))(*arrays)
  assert 'value' in called
  assert takes_gradient is None or ('gradient' in called) == takes_gradient
  want = jax.jit(transformation(scalar(plain_value)))(*arrays)
  jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=2e-5, atol=1e-5), got, want)


def test_a_gradient_that_the_plain_program_does_not_share_shows_which_one_is_taken():
  def ones(arrays, *_):
    return tuple(map(jnp.ones_like, arrays))

  function = with_derivatives(
    plain_value, ones, plain_value=plain_value, plain_gradient=plain_gradient
  )
  np.testing.assert_array_equal(jax.grad(scalar(function))(x, w), np.ones_like(x))
  np.testing.assert_array_equal(jax.vmap(jax.grad(scalar(function)))(X, W), np.ones_like(X))
