"""The operations, each with small arrays, for tests of what they have in common."""

import functools

import jax
import jax.numpy as jnp
import numpy as np

from cvn.ops import conv2d, deconv, normalization
from cvn.ops.normalization import ELU, SIGMOID

IMPLEMENTATIONS = ['auto', 'xla']  # the first calls compiled kernels if there are any

# f(volumes, parameters, implementation) -> results; shapes of a batch of two, and of parameters.
_PRODUCT = (2, 2, 3, 2, 4), ((4,), (4,), (3, 3, 3, 4, 5))
OPERATIONS = {
  'deconv': (lambda x, p, **options: deconv.deconv(x, *p, ELU, **options), *_PRODUCT),
  'conv': (lambda x, p, **options: deconv.conv(x, *p, SIGMOID, **options), *_PRODUCT),
  'conv2d': (
    lambda x, p, **options: conv2d.conv2d(x, *p, **options),
    (2, 4, 6, 3),
    ((3, 3, 3, 16),),
  ),
  'activate': (
    lambda x, p, **options: normalization.activate(x, *p, ELU, **options),
    (2, 2, 3, 2, 4),
    ((4,), (4,)),
  ),
  'normalize': (
    lambda x, p, **options: normalization.normalize(x, *p, ELU, **options)[0],
    (2, 3, 4),
    ((4,), (4,)),
  ),
}
KERNELS = ['deconv', 'conv', 'conv2d', 'activate']  # those that have compiled kernels


def draw(seed, *shape):
  return np.random.default_rng(seed).standard_normal(shape, dtype=np.float32)


def make(name, *leading):
  """(volumes [*leading, ...], parameters): a tuple of arrays."""
  _, volume, shapes = OPERATIONS[name]
  return draw(0, *leading, *volume), tuple(draw(1 + n, *s) for n, s in enumerate(shapes))


def operation(name, implementation):
  return functools.partial(OPERATIONS[name][0], implementation=implementation)


def loss(run, x, parameters):
  """A scalar on which every result has an influence of its own; sums [2, C] are in the hundreds."""
  results = jax.tree.leaves(run(x, parameters))
  return sum(jnp.sum(jnp.sin(r if r.ndim > 2 else r / 1000)) for r in results)


def values(name, implementation):
  """f(x, parameters) -> (results, (loss, gradients of x and of parameters))."""
  run = operation(name, implementation)
  gradient = jax.value_and_grad(functools.partial(loss, run), (0, 1))
  return lambda x, p: (run(x, p), gradient(x, p))


@functools.cache
def plain(name):
  """The same of plain operations, compiled: what tests expect."""
  return jax.jit(values(name, 'xla'))


def assert_close(got, want, tolerance=2e-5):
  def check(g, w):
    assert g.dtype == w.dtype
    np.testing.assert_allclose(g, w, rtol=tolerance, atol=tolerance * max(1, jnp.abs(w).max()))

  jax.tree.map(check, got, want)
