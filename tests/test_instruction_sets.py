"""Every kernel, built for every instruction set that this processor has, against the reference.

The libraries are loaded side by side. The one that this process would choose by itself is tested
in test_deconv.py, test_conv2d.py and test_normalization.py.
"""

import functools
import platform

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cvn.ops import compile as compiling
from cvn.ops import conv2d, deconv, native, normalization
from cvn.ops.normalization import ELU, IDENTITY, SIGMOID

X86 = platform.machine().lower() in ('x86_64', 'amd64')
# Without instructions beyond those that every x86-64 has, and all that wheels carry.
TARGETS = [*(['x86-64'] if X86 else []), *compiling.usable_targets()[::-1]]
DTYPES = {'float32': jnp.float32, 'bfloat16': jnp.bfloat16}

# [B, X, Y, Z, in], out, and what comes before the product.
VOLUMES = [
  ((2, 2, 3, 4, 6), 5, ELU),
  ((1, 1, 1, 1, 3), 1, SIGMOID),
  ((1, 5, 2, 1, 1), 34, IDENTITY),
  ((2, 2, 2, 17, 33), 5, ELU),
  ((1, 2, 1, 32, 24), 16, ELU),
  ((1, 3, 4, 5, 16), 32, ELU),
]
# [B, H, W, in], size and out.
MAPS = [
  ((2, 16, 12, 3), 7, 16),
  ((1, 2, 2, 5), 3, 32),
  ((3, 10, 6, 20), 5, 48),
  ((2, 8, 70, 64), 5, 64),
  ((1, 36, 4, 16), 4, 16),
]
CHANNELS = [(1, ELU), (3, SIGMOID), (5, IDENTITY), (24, ELU), (33, SIGMOID)]
PRODUCTS = {
  'deconv': (deconv.deconv, deconv.library_deconv),
  'conv': (deconv.conv, deconv.library_conv),
}


@pytest.fixture(scope='module', params=TARGETS)
def library(request):
  """The kernels for a target."""
  try:
    compiling.find_compiler()
  except FileNotFoundError:
    pytest.skip('no C++ compiler here')
  return native.load(native.build(target=request.param))


def test_libraries_are_what_they_were_built_for(library, request):
  names = {
    'x86-64': 'SSE2, 4 lanes',
    'x86-64-v3': 'AVX2, 8 lanes',
    'x86-64-v4': 'AVX-512, 16 lanes',
    'x86-64-v4-bf16': 'AVX-512 with BF16, 8 lanes',
    'sapphirerapids': 'AVX-512 with BF16 and AMX, 16 lanes',
    'aarch64': 'NEON, 4 lanes',
  }
  assert library.instruction_set == names[request.node.callspec.params['library']]
  assert library.suffix.startswith('@')


def draw(*shapes):
  rng = np.random.default_rng(0)
  return [rng.standard_normal(shape, dtype=np.float32) for shape in shapes]


def value_and_gradients(function, arguments, cotangents):
  value, pull = jax.vjp(function, *arguments)
  return *value, *pull(cotangents)


def compute(function, library, arguments, cotangents, kernels):
  """The value and gradients of a library's kernels, which the program is seen to call."""
  step = jax.jit(lambda *a: value_and_gradients(function, a[0], a[1]))
  compiled = step.lower(arguments, cotangents).compile()
  text = compiled.as_text()
  assert all(f'"{name}{library.suffix}"' in text for name in kernels)
  return compiled(arguments, cotangents)


def assert_close(got, want, tolerances):
  for g, w, tolerance in zip(got, want, tolerances, strict=True):
    w = np.asarray(w, np.float32)
    scale = max(float(np.abs(w).max()), 1.0)
    np.testing.assert_allclose(np.asarray(g, np.float32), w, rtol=tolerance, atol=tolerance * scale)


def rounded(x):
  return jax.lax.reduce_precision(x, exponent_bits=8, mantissa_bits=7)


@functools.cache
def make_product(name, case, dtype):
  """(arguments, cotangents, what the reference makes of them) of a case."""
  shape, cout, activation = VOLUMES[case]
  arguments = draw(shape, shape[-1:], shape[-1:], (3, 3, 3, shape[-1], cout))
  reference = PRODUCTS[name][1]
  mixed = dtype == 'bfloat16'
  if mixed:  # as the kernels round
    arguments[0] = np.asarray(rounded(arguments[0]))

  def composed(x, scale, shift, kernel):
    scale, shift = (v.reshape(1, 1, 1, 1, -1) for v in (scale, shift))
    a = activation.value(x * scale + shift)
    y = reference(_pass_rounded(a), _pass_rounded(kernel)) if mixed else reference(a, kernel)
    return y, jnp.stack([y.sum((0, 1, 2, 3)), (y * y).sum((0, 1, 2, 3))])

  y, sums = jax.eval_shape(composed, *arguments)
  cotangents = draw(y.shape, sums.shape)
  if mixed:  # a cotangent of sums would be added to that of y before both are rounded
    cotangents = [np.asarray(rounded(cotangents[0])), 0 * cotangents[1]]
  want = jax.jit(lambda *a: value_and_gradients(composed, a[0], a[1]))(
    tuple(arguments), tuple(cotangents)
  )
  return arguments, cotangents, want


@jax.custom_jvp
def _pass_rounded(x):
  """x rounded to bfloat16, with the derivative of x."""
  return rounded(x)


@_pass_rounded.defjvp
def _(primals, tangents):
  return rounded(*primals), tangents[0]


@pytest.mark.parametrize('dtype', DTYPES)
@pytest.mark.parametrize('case', range(len(VOLUMES)))
@pytest.mark.parametrize('name', PRODUCTS)
def test_products(library, name, case, dtype):
  arguments, cotangents, want = make_product(name, case, dtype)
  activation = VOLUMES[case][2]
  x, *rest = arguments
  out = jnp.float32 if name == 'conv' else DTYPES[dtype]
  got = compute(
    lambda *a: PRODUCTS[name][0](*a, activation, implementation=library),
    library,
    (jnp.asarray(x, DTYPES[dtype]), *rest),
    (jnp.asarray(cotangents[0], out), cotangents[1]),
    [f'cvn_{name}', f'cvn_{name}_gradient'],
  )
  assert [g.dtype for g in got] == [out, jnp.float32, DTYPES[dtype], *[jnp.float32] * 3]
  exact, half = 1e-5, 2**-8  # a result in bfloat16 is rounded by half a unit of its eighth digit
  if dtype == 'float32':
    tolerances = [exact] * 6
  else:
    # Sums and gradients of what was activated follow the rounding of single factors.
    tolerances = [exact if out == jnp.float32 else half, half, half, half, half, exact]
  assert_close(got, want, tolerances)


@pytest.mark.parametrize('mixed', [False, True])
@pytest.mark.parametrize(('shape', 'size', 'out'), MAPS)
def test_conv2d(library, shape, size, out, mixed):
  x, kernel = draw(shape, (size, size, shape[-1], out))
  (dy,) = draw(jax.eval_shape(conv2d.library_conv2d, x, kernel).shape)

  def ours(x, kernel):
    return (conv2d.conv2d(x, kernel, mixed=mixed, implementation=library),)

  kernels = ['cvn_conv2d', 'cvn_conv2d_input_gradient', 'cvn_conv2d_kernel_gradient']
  got = compute(ours, library, (x, kernel), (dy,), kernels)
  want = value_and_gradients(lambda *a: (conv2d.library_conv2d(*a),), (x, kernel), (dy,))
  for a, b in zip(got, want, strict=True):
    scale, rtol = float(jnp.abs(b).max()), 0 if mixed else 1e-5
    np.testing.assert_allclose(a, b, rtol=rtol, atol=(0.01 if mixed else 1e-5) * scale)


@pytest.mark.parametrize('dtype', DTYPES)
@pytest.mark.parametrize(('channels', 'activation'), CHANNELS)
def test_activated(library, channels, activation, dtype):
  shapes = (2, 3, 4, 5, channels), (channels,), (channels,), (2, 3, 4, 5, channels)
  x, scale, shift, dy = draw(*shapes)
  x, dy = (jnp.asarray(v, DTYPES[dtype]) for v in (x, dy))
  tolerance = 1e-5 if dtype == 'float32' else 2**-7

  def ours(x, scale, shift):
    return (normalization.activate(x, scale, shift, activation, implementation=library),)

  def expected(x, scale, shift):
    scale, shift = (v.reshape(1, 1, 1, 1, -1) for v in (scale, shift))
    return (activation.value(x * scale + shift),)

  kernels = ['cvn_activated', 'cvn_activated_gradient']
  got = compute(ours, library, (x, scale, shift), (dy,), kernels)
  wide = (x.astype(jnp.float32), scale, shift), (dy.astype(jnp.float32),)
  assert_close(got, value_and_gradients(expected, *wide), [tolerance] * 4)
