"""Operations and networks under the transformations of JAX, each against the plain loop.

Expected values come from plain operations without the transformation: a loop, a sum that is written
out, a gradient, or finite differences.
"""

import functools
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.sharding import AxisType, PartitionSpec

from cvn.networks import ShapeNetwork
from cvn.ops import conv2d, deconv, native, normalization
from cvn.ops.normalization import ELU, SIGMOID

SMALL = {'image_size': 32, 'grid_size': 16}  # the smallest that the networks can have
needs_kernels = pytest.mark.skipif(not native.available(), reason='no compiled kernels here')

# f(volumes, parameters, implementation) -> results; shapes of a batch of two, and of parameters.
OPERATIONS = {
  'deconv': (
    lambda x, p, **options: deconv.deconv(x, *p, ELU, **options),
    (2, 2, 3, 2, 4),
    ((4,), (4,), (3, 3, 3, 4, 5)),
  ),
  'conv': (
    lambda x, p, **options: deconv.conv(x, *p, SIGMOID, **options),
    (2, 2, 3, 2, 4),
    ((4,), (4,), (3, 3, 3, 4, 5)),
  ),
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
IMPLEMENTATIONS = ['auto', 'xla']  # one calls compiled kernels if there are any, one never does


def draw(seed, *shape):
  return np.random.default_rng(seed).standard_normal(shape, dtype=np.float32)


def make(name, *leading):
  """(operation, volumes [*leading, ...], parameters): a tuple of arrays."""
  operation, volume, shapes = OPERATIONS[name]
  return operation, draw(0, *leading, *volume), tuple(draw(1 + n, *s) for n, s in enumerate(shapes))


def ensemble(parameters, count=3):
  return tuple(draw(10 + n, count, *p.shape) for n, p in enumerate(parameters))


def loss(operation, x, parameters):
  """A scalar on which every result has an influence of its own; sums [2, C] are in the hundreds."""
  results = jax.tree.leaves(operation(x, parameters))
  return sum(jnp.sum(jnp.sin(r if r.ndim > 2 else r / 1000)) for r in results)


def value_and_gradients(operation):
  """f(x, parameters) -> (results, gradients of x and of parameters)."""
  return lambda *a: (operation(*a), jax.grad(functools.partial(loss, operation), (0, 1))(*a))


def assert_close(got, expected, tolerance=2e-5):
  def check(g, e):
    assert g.dtype == e.dtype
    scale = float(jnp.abs(e).max(initial=1))
    np.testing.assert_allclose(g, e, rtol=tolerance, atol=tolerance * scale)

  jax.tree.map(check, got, expected)


def loop(function, *batches):
  """function of the first elements, of the second, and so on, stacked."""
  count = len(jax.tree.leaves(batches)[0])
  outs = [function(*jax.tree.map(lambda x, i=i: x[i], batches)) for i in range(count)]
  return jax.tree.map(lambda *leaves: jnp.stack(leaves), *outs)


@pytest.fixture(params=IMPLEMENTATIONS)
def implementation(request):
  return request.param


@pytest.fixture(params=OPERATIONS)
def name(request):
  return request.param


# --- what maps, loops and spreads ---------------------------------------------------------------


def test_vmap_over_batches(name, implementation):
  operation, x, p = make(name, 3)
  both = value_and_gradients(functools.partial(operation, implementation=implementation))
  plain = value_and_gradients(functools.partial(operation, implementation='xla'))
  assert_close(jax.jit(jax.vmap(both, (0, None)))(x, p), loop(lambda x: plain(x, p), x))


def test_vmap_over_parameters(name, implementation):
  """An ensemble that sees the same batch."""
  operation, x, p = make(name)
  both = value_and_gradients(functools.partial(operation, implementation=implementation))
  plain = value_and_gradients(functools.partial(operation, implementation='xla'))
  p = ensemble(p)
  assert_close(jax.jit(jax.vmap(both, (None, 0)))(x, p), loop(lambda p: plain(x, p), p))


def test_vmap_over_both_in_one_another(name, implementation):
  operation, x, p = make(name, 2)
  both = value_and_gradients(functools.partial(operation, implementation=implementation))
  plain = value_and_gradients(functools.partial(operation, implementation='xla'))
  p = ensemble(p)
  nested = jax.vmap(jax.vmap(both, (None, 0)), (0, None))
  assert_close(jax.jit(nested)(x, p), loop(lambda x: loop(lambda p: plain(x, p), p), x))
  paired = jax.vmap(both, (0, 0))
  p = jax.tree.map(lambda a: a[:2], p)
  assert_close(jax.jit(paired)(x, p), loop(plain, x, p))


def test_gradients_of_a_vmap_add_up_over_what_it_shares(name, implementation):
  operation, x, p = make(name, 3)

  def total(x, p, implementation):
    ours = functools.partial(operation, implementation=implementation)
    return jnp.sum(jax.vmap(lambda x: loss(ours, x, p))(x))

  def plain(x, p):
    ours = functools.partial(operation, implementation='xla')
    return sum(loss(ours, x[i], p) for i in range(len(x)))

  got = jax.jit(jax.grad(functools.partial(total, implementation=implementation), (0, 1)))(x, p)
  assert_close(got, jax.grad(plain, (0, 1))(x, p))


def test_scan_and_checkpoint(name, implementation):
  """A sum over slices of a batch, whose backward pass makes the results again."""
  operation, x, p = make(name, 3)

  def slice_loss(x, p):
    return loss(functools.partial(operation, implementation=implementation), x, p)

  def total(x, p):
    def step(sum_before, x):
      return sum_before + jax.checkpoint(slice_loss)(x, p), None

    return jax.lax.scan(step, 0.0, x)[0]

  def plain(x, p):
    ours = functools.partial(operation, implementation='xla')
    return sum(loss(ours, x[i], p) for i in range(len(x)))

  got = jax.jit(jax.value_and_grad(total, (0, 1)))(x, p)
  assert_close(got, jax.value_and_grad(plain, (0, 1))(x, p))


@pytest.mark.parametrize('check', [True, False])
@pytest.mark.parametrize('name', ['deconv', 'conv', 'conv2d', 'activate'])
def test_shard_map(name, implementation, check):
  """Two devices, each with half the batch: gradients of parameters are summed by JAX."""
  operation, x, p = make(name)
  mesh = jax.make_mesh((2,), ('batch',), (AxisType.Auto,), devices=jax.devices()[:2])
  batch, whole = PartitionSpec('batch'), PartitionSpec()

  @functools.partial(
    jax.shard_map, mesh=mesh, in_specs=(batch, whole), out_specs=whole, check_vma=check
  )
  def total(x, p):
    ours = functools.partial(operation, implementation=implementation)
    return jax.lax.psum(loss(ours, x, p), 'batch')

  def plain(x, p):
    ours = functools.partial(operation, implementation='xla')
    return sum(loss(ours, x[i : i + 1], p) for i in range(2))

  got = jax.jit(jax.value_and_grad(total, (0, 1)))(x, p)
  assert_close(got, jax.value_and_grad(plain, (0, 1))(x, p))


@pytest.mark.parametrize('leading', [(), (0,), (2, 3)])
@pytest.mark.parametrize('name', ['deconv', 'conv', 'conv2d', 'activate'])
def test_a_batch_of_any_leading_shape(name, implementation, leading):
  operation, _, p = make(name)
  x = draw(0, *leading, *OPERATIONS[name][1][1:])
  run = functools.partial(operation, implementation=implementation)
  plain = functools.partial(operation, implementation='xla')
  got, expected = jax.jit(run)(x, p), plain(x.reshape(-1, *OPERATIONS[name][1][1:]), p)
  first = jax.tree.leaves(got)[0]
  assert first.shape[: len(leading)] == leading
  expected = jax.tree.map(lambda g, e: e.reshape(g.shape), got, expected)
  assert_close(got, expected)


# --- derivatives --------------------------------------------------------------------------------


def test_forward_mode(name, implementation):
  operation, x, p = make(name)
  tangents = draw(20, *x.shape), tuple(draw(21 + n, *a.shape) for n, a in enumerate(p))
  function = functools.partial(loss, functools.partial(operation, implementation=implementation))
  value, derivative = jax.jit(lambda *a: jax.jvp(function, a, tangents))(x, p)
  plain = functools.partial(loss, functools.partial(operation, implementation='xla'))
  gradients = jax.grad(plain, (0, 1))(x, p)
  assert_close(value, plain(x, p))
  products = jax.tree.map(lambda g, t: jnp.sum(g * t), gradients, tangents)
  assert_close(derivative, sum(jax.tree.leaves(products)), 1e-4)


def test_jacobians_of_both_modes_are_the_same(name, implementation):
  operation, x, p = make(name)
  function = functools.partial(operation, implementation=implementation)

  def last(v):  # of the last parameter's first numbers
    flat = p[-1].reshape(-1)
    changed = jnp.concatenate([flat[: -len(v)], v]).reshape(p[-1].shape)
    return jax.tree.leaves(function(x, (*p[:-1], changed)))[0].ravel()[:40]

  v = p[-1].reshape(-1)[-3:]
  assert_close(jax.jit(jax.jacfwd(last))(v), jax.jit(jax.jacrev(last))(v))


def test_hessian_vector_products(name, implementation):
  """Forward over reverse, reverse over reverse, and differences of gradients."""
  operation, x, p = make(name)
  function = functools.partial(loss, functools.partial(operation, implementation=implementation))
  gradient = jax.grad(function, (0, 1))
  direction = jax.tree.map(lambda a: draw(30, *a.shape), (x, p))

  @jax.jit
  def forward_over_reverse(*a):
    return jax.jvp(gradient, a, direction)[1]

  @jax.jit
  def reverse_over_reverse(*a):
    def along(*a):
      products = jax.tree.map(lambda g, d: jnp.sum(g * d), gradient(*a), direction)
      return sum(jax.tree.leaves(products))

    return jax.grad(along, (0, 1))(*a)

  first = forward_over_reverse(x, p)
  assert_close(first, reverse_over_reverse(x, p), 1e-4)

  def at(step):
    return jax.jit(gradient)(*jax.tree.map(lambda a, d: a + step * d, (x, p), direction))

  step = 1e-2
  differences = jax.tree.map(lambda a, b: (a - b) / (2 * step), at(step), at(-step))
  # Central differences err by step^2 times the third derivative.
  for a, b in zip(jax.tree.leaves(first), jax.tree.leaves(differences), strict=True):
    assert jnp.linalg.norm(a - b) < 0.02 * jnp.linalg.norm(b)


@needs_kernels
def test_the_first_gradient_is_the_kernels_and_no_plain_product_is_made():
  operation, x, p = make('deconv')
  function = functools.partial(loss, functools.partial(operation, implementation='auto'))
  text = jax.jit(jax.grad(function, (0, 1))).lower(x, p).compile().as_text()
  called = re.findall(r'custom_call_target="(\w+)', text)
  assert sorted(called) == sorted(map(native.target, ('cvn_deconv', 'cvn_deconv_gradient')))
  assert ' dot(' not in text.replace('dot(%broadcast', '')


# --- a network ----------------------------------------------------------------------------------


@pytest.fixture(scope='module')
def shape_network():
  """(variables, images [2, H, W, 3]) of the smallest shape network."""
  image = jax.random.uniform(jax.random.key(1), (2, 32, 32, 3))
  network = ShapeNetwork(**SMALL, implementation='xla')
  variables = jax.jit(lambda x: network.init(jax.random.key(0), x, train=False))(image)
  return variables, image


def apply(variables, image, implementation='auto', **options):
  network = ShapeNetwork(**SMALL, implementation=implementation, **options)
  return network.apply(variables, image, train=False)


def network_loss(params, statistics, image, implementation='auto'):
  """With batch statistics, as in training."""
  network = ShapeNetwork(**SMALL, implementation=implementation)
  variables = {'params': params, 'batch_stats': statistics}
  out, _ = network.apply(variables, image, train=True, mutable='batch_stats')
  return jnp.mean(jnp.sin(out))


def shifted(variables, count=2):
  """An ensemble of networks."""
  return jax.tree.map(lambda a: jnp.stack([a * (1 + 0.1 * i) for i in range(count)]), variables)


def test_an_ensemble_of_networks(shape_network):
  variables, image = shape_network
  networks = shifted(variables)
  got = jax.jit(jax.vmap(apply, (0, None)))(networks, image)
  assert_close(got, loop(lambda v: apply(v, image, 'xla'), networks), 1e-4)


def test_a_network_over_a_batch_of_any_leading_shape(shape_network):
  variables, image = shape_network
  expected = apply(variables, image, 'xla')
  got = jax.jit(apply)(variables, image.reshape(1, 2, 1, 32, 32, 3))
  assert_close(got, expected.reshape(1, 2, 1, 16, 16, 16, 1), 1e-4)
  assert_close(jax.jit(apply)(variables, image[0]), expected[0], 1e-4)
  assert_close(jax.jit(jax.vmap(apply, (None, 0)))(variables, image), expected, 1e-4)


def test_training_an_ensemble_equals_the_loop(shape_network):
  variables, image = shape_network
  networks = shifted(variables['params'])
  gradient = functools.partial(
    jax.value_and_grad(network_loss), statistics=variables['batch_stats']
  )
  got = jax.jit(jax.vmap(lambda p: gradient(p, image=image)))(networks)
  plain = jax.jit(lambda p: gradient(p, image=image, implementation='xla'))
  assert_close(got, loop(plain, networks), 1e-3)


def test_a_hessian_vector_product_of_a_network(shape_network):
  variables, image = shape_network
  direction = jax.tree.map(lambda a: 0.01 * draw(40, *a.shape), variables['params'])

  def product(implementation):
    def gradient(p):
      return jax.grad(network_loss)(p, variables['batch_stats'], image, implementation)

    return jax.jit(lambda p: jax.jvp(gradient, (p,), (direction,))[1])(variables['params'])

  got, expected = product('auto'), product('xla')
  for a, b in zip(jax.tree.leaves(got), jax.tree.leaves(expected), strict=True):
    assert jnp.linalg.norm(a - b) < 2e-3 * jnp.linalg.norm(b) + 1e-7


@needs_kernels
def test_inference_is_exported_and_comes_back(shape_network):
  variables, image = shape_network
  calls = [jax.export.DisabledSafetyCheck.custom_call(native.target(k)) for k in native.KERNELS]
  exported = jax.export.export(jax.jit(apply), platforms=['cpu'], disabled_checks=calls)
  again = jax.export.deserialize(exported(variables, image).serialize())
  assert native.target('cvn_deconv') in again.mlir_module()
  assert_close(again.call(variables, image), apply(variables, image, 'xla'), 1e-4)


# --- types --------------------------------------------------------------------------------------


@pytest.mark.parametrize('dtype', [jnp.float16, jnp.bfloat16])
def test_parameters_of_other_types_get_gradients_of_their_own(name, implementation, dtype):
  operation, x, p = make(name)
  low = jax.tree.map(lambda a: jnp.asarray(a, dtype), p)
  function = functools.partial(loss, functools.partial(operation, implementation=implementation))
  plain = functools.partial(loss, functools.partial(operation, implementation='xla'))
  got = jax.jit(jax.value_and_grad(function, 1))(x, low)
  value, gradients = jax.value_and_grad(plain, 1)(x, jax.tree.map(lambda a: a.astype('f4'), low))
  assert_close(got, (value, jax.tree.map(lambda g: g.astype(dtype), gradients)), 2**-7)


def test_volumes_of_other_types_are_cast(name, implementation):
  operation, x, p = make(name)
  x = x.astype(np.float16)
  run = functools.partial(operation, implementation=implementation)
  got = jax.jit(run)(x, p)
  assert_close(got, operation(x.astype(np.float32), p, implementation='xla'))
  gradient = jax.grad(functools.partial(loss, run))(x, p)
  assert gradient.dtype == jnp.float16


def test_integers_are_refused_and_the_types_are_named(name, implementation):
  operation, x, p = make(name)
  named = 'must be float32 or bfloat16 .*: int32'
  with pytest.raises(TypeError, match=f'x {named}'):
    operation(x.astype(np.int32), p, implementation=implementation)
  with pytest.raises(TypeError, match=named):
    operation(x, (*p[:-1], p[-1].astype(np.int32)), implementation=implementation)


def test_images_are_cast_or_refused(shape_network):
  variables, image = shape_network
  half = image.astype(jnp.float16)
  expected = apply(variables, half.astype(jnp.float32), 'xla')
  assert_close(jax.jit(apply)(variables, half), expected, 1e-4)
  with pytest.raises(TypeError, match=r'images must be float32 .*: uint8'):
    apply(variables, (255 * image).astype(jnp.uint8))
  low = jax.tree.map(lambda a: a.astype(jnp.bfloat16), variables)
  expected = apply(jax.tree.map(lambda a: a.astype(jnp.float32), low), image, 'xla')
  assert_close(jax.jit(apply)(low, image), expected, 1e-3)


def test_x64_mode(shape_network):
  """Nothing of a network becomes float64: parameters, results or gradients."""
  variables, image = shape_network
  expected = apply(variables, image, 'xla')
  gradient = jax.grad(network_loss)
  expected_gradient = gradient(variables['params'], variables['batch_stats'], image, 'xla')
  with jax.enable_x64(True):
    wide = jnp.asarray(np.asarray(image), jnp.float64)
    assert wide.dtype == jnp.float64
    shapes = jax.eval_shape(
      lambda x: ShapeNetwork(**SMALL).init(jax.random.key(0), x, train=False), wide
    )
    assert {x.dtype for x in jax.tree.leaves(shapes)} == {np.dtype('float32')}
    assert_close(jax.jit(apply)(variables, wide), expected, 1e-4)
    got = jax.jit(gradient)(variables['params'], variables['batch_stats'], wide)
  assert_close(got, expected_gradient, 1e-3)


@pytest.mark.parametrize('name', OPERATIONS)
def test_float64_is_cast(name, implementation):
  operation, x, p = make(name)
  run = functools.partial(operation, implementation=implementation)
  expected = operation(x, p, implementation='xla')
  with jax.enable_x64(True):
    wide = jax.tree.map(lambda a: jnp.asarray(a, jnp.float64), (x, p))
    assert_close(jax.jit(run)(*wide), expected)
    gradients = jax.jit(jax.grad(functools.partial(loss, run), (0, 1)))(*wide)
  assert {g.dtype for g in jax.tree.leaves(gradients)} == {np.dtype('float64')}


# --- refusals -----------------------------------------------------------------------------------


def test_an_unknown_implementation_is_refused(name, shape_network):
  operation, x, p = make(name)
  message = "must be one of .'auto', 'kernels', 'xla'.: 'fast'"
  with pytest.raises(ValueError, match=message):
    operation(x, p, implementation='fast')
  with pytest.raises(ValueError, match=message):
    apply(*shape_network, implementation='fast')


def test_kernels_that_are_not_there_are_an_error_that_says_why(name, monkeypatch):
  if name == 'normalize':
    pytest.skip('no kernel computes it')
  monkeypatch.setattr(native, 'available', lambda: False)
  monkeypatch.setattr(native, 'missing', lambda: 'no C++ compiler: c++')
  operation, x, p = make(name)
  with pytest.raises(RuntimeError, match=r"'kernels': no compiled kernels .no C.. compiler: c"):
    operation(x, p, implementation='kernels')


@needs_kernels
def test_kernels_that_do_not_take_a_shape_are_an_error_that_says_so():
  x, kernel = draw(0, 1, 4, 4, 3), draw(1, 3, 3, 3, 5)
  with pytest.raises(ValueError, match='no multiple of 16: 5'):
    conv2d.conv2d(x, kernel, implementation='kernels')


@needs_kernels
def test_kernels_on_an_accelerator_are_an_error():
  operation, x, p = make('deconv')
  run = jax.jit(functools.partial(operation, implementation='kernels'))
  with pytest.raises(Exception, match='cuda'):
    jax.export.export(run, platforms=['cuda'])(x, p)


@pytest.mark.parametrize('name', ['deconv', 'conv', 'conv2d', 'activate'])
def test_shapes_that_do_not_fit_are_refused(name):
  operation, x, p = make(name)
  with pytest.raises(ValueError, match=f'{name} takes x'):
    operation(x[..., :-1], p)
  with pytest.raises(ValueError, match=f'{name} takes x'):
    operation(x[0, 0], p)
