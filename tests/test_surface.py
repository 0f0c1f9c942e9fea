"""Heads at surface voxels: as those of whole volumes read there, statistics of some voxels."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.sharding import AxisType, NamedSharding, PartitionSpec

from cvn import layers, surface
from cvn.grid import PADDING_INDEX
from cvn.networks import ColorNetwork, ColorVolumes, Trunk
from cvn.ops import deconv, normalization

GRID = 8
CHANNELS = {'regressed': (4, 3), 'flow': (2,), 'weight': (3, 1)}  # hidden and last, or last


def make_params(rng, features=5):
  def layer(cin, cout):
    norm = {'scale': rng.normal(1, 0.3, cout), 'bias': rng.normal(0, 0.3, cout)}
    kernel = rng.normal(0, 0.3, (3, 3, 3, cin, cout))
    return {'kernel': kernel, 'bias': rng.normal(size=cout), 'norm': norm}

  def head(hidden, last=None):
    made = {'deconv': layer(features, hidden)}
    return made | ({'conv': layer(hidden, last)} if last else {})

  made = {name: head(*channels) for name, channels in CHANNELS.items()}
  return jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), made)


def make_index(rng, counts=(9, 5), slots=12, size=GRID):
  """Distinct voxels, the grid's corners among them, and padding."""
  index = np.full((len(counts), slots, 3), PADDING_INDEX, np.int32)
  for sample, count in enumerate(counts):
    inner = rng.choice(np.arange(1, size**3 - 1), max(count - 2, 0), replace=False)
    voxels = np.concatenate([[0, size**3 - 1], inner])[:count].astype(int)
    index[sample, :count] = np.stack(np.unravel_index(voxels, (size,) * 3), -1)
  return index


def near_voxels(index, size=GRID):
  """[B, X, Y, Z]: voxels of cells that hold a voxel within 1 of a surface voxel; by definition."""
  near = np.zeros((len(index), size, size, size), bool)
  for sample, voxels in enumerate(index):
    for v in voxels[voxels[:, 0] < size]:
      low = np.maximum(v - 1, 0) // 2 * 2
      high = np.minimum(v + 1, size - 1) // 2 * 2 + 2
      near[sample, low[0] : high[0], low[1] : high[1], low[2] : high[2]] = True
  return near


def whole_volumes(params, features, index):
  """The definition: whole volumes, statistics of the voxels that count, values at the surface."""
  batch = np.arange(len(index))[:, None]
  real = index[..., 0] < GRID
  at = (batch, *np.moveaxis(np.where(real[..., None], index, 0), -1, 0))
  own = np.zeros((len(index), GRID, GRID, GRID), bool)
  own[tuple(a[real] for a in np.broadcast_arrays(*at))] = True

  def finish(x, where, p, activation):
    chosen = x[where]
    mean, variance = chosen.mean(0), chosen.var(0)
    gain = p['norm']['scale'] / jnp.sqrt(variance + normalization.EPSILON)
    x = (x - mean[None, None, None, None]) * gain[None, None, None, None]
    y = activation.value(x + p['norm']['bias'][None, None, None, None])
    return y, {'norm': {'mean': mean + p['bias'], 'var': variance}}

  def head(p):
    x, first = finish(
      deconv.library_deconv(features, p['deconv']['kernel']),
      near_voxels(index) if 'conv' in p else own,
      p['deconv'],
      normalization.ELU if 'conv' in p else normalization.SIGMOID,
    )
    if 'conv' not in p:
      return x[at], {'deconv': first}
    x = deconv.library_conv(x, p['conv']['kernel'])
    x, last = finish(x, own, p['conv'], normalization.SIGMOID)
    return x[at], {'deconv': first, 'conv': last}

  found = {name: head(p) for name, p in params.items()}
  values = ColorVolumes(found['regressed'][0], found['flow'][0], 1 - found['weight'][0])
  return values, {name: f[1] for name, f in found.items()}


def sparse(params, features, index, capacity=None, mixed=False):
  near = surface.near_cells(index, GRID)
  places = surface.find_places(near, index, capacity or near.size)
  return surface.color_heads(params, features, places, mixed=mixed)


def weighted(function, params, features, index, weights):
  """A scalar of the values at real voxels."""
  values, _ = function(params, features, index)
  real = (index[..., :1] < GRID).astype(np.float32)
  return sum(jnp.sum(v * w * real) for v, w in zip(values, weights, strict=True))


@pytest.fixture
def rng():
  return np.random.default_rng(0)


def test_near_cells(rng):
  index = make_index(rng)
  expected = near_voxels(index)[:, ::2, ::2, ::2]
  np.testing.assert_array_equal(surface.near_cells(jnp.asarray(index), GRID), expected)
  assert 0 < expected.sum() < expected.size


@pytest.mark.parametrize('counts', [(9, 5), (12, 1), (0, 3)])
def test_values_statistics_and_gradients_are_those_of_whole_volumes(rng, counts):
  params, index = make_params(rng), make_index(rng, counts)
  features = jnp.asarray(rng.normal(size=(2, 4, 4, 4, 5)), jnp.float32)
  real = index[..., 0] < GRID
  got, statistics = jax.jit(sparse)(params, features, index)
  expected, expected_statistics = whole_volumes(params, features, index)
  for a, b in zip(got, expected, strict=True):
    np.testing.assert_allclose(a[real], b[real], atol=1e-5)
  jax.tree.map(
    lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-5),
    statistics,
    expected_statistics,
  )
  weights = [rng.normal(size=v.shape).astype(np.float32) for v in got]
  gradient, expected = (
    jax.jit(jax.grad(functools.partial(weighted, function, index=index, weights=weights), (0, 1)))(
      params, features
    )
    for function in (sparse, whole_volumes)
  )
  jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=3e-4), gradient, expected)


def test_room_for_more_cells_changes_nothing(rng):
  params, index = make_params(rng), make_index(rng)
  features = jnp.asarray(rng.normal(size=(2, 4, 4, 4, 5)), jnp.float32)
  exact = int(near_voxels(index).sum()) // 8
  jax.tree.map(
    lambda a, b: np.testing.assert_allclose(a, b, atol=1e-5),
    sparse(params, features, index, exact),
    sparse(params, features, index),
  )


def test_with_the_same_statistics_it_is_the_color_network(rng):
  network, trunk = ColorNetwork(64, 32), Trunk(64, 32)
  image = jnp.asarray(rng.random((2, 64, 64, 3)), jnp.float32)
  index = make_index(rng, (300, 200), 320, 32)

  @jax.jit
  def both(key):
    variables = network.init(key, image, train=False)
    params, stats = variables['params'], variables['batch_stats']
    own = {'params': params['trunk'], 'batch_stats': stats['trunk']}
    features, mutated = trunk.apply(own, image, train=True, mutable='batch_stats')
    near = surface.near_cells(index, 32)
    places = surface.find_places(near, index, near.size)
    heads = {name: p for name, p in params.items() if name != 'trunk'}
    values, statistics = surface.color_heads(
      heads, layers.materialize(features), places, mixed=False
    )
    statistics = {'trunk': mutated['batch_stats'], **statistics}
    volumes = network.apply({'params': params, 'batch_stats': statistics}, image, train=False)
    return values, statistics, volumes, stats

  values, statistics, volumes, stats = both(jax.random.key(0))
  assert jax.tree.structure(statistics) == jax.tree.structure(stats)
  for sample in (0, 1):
    real = index[sample, :, 0] < 32
    at = (sample, *index[sample][real].T)
    for a, b in zip(values, volumes, strict=True):
      np.testing.assert_allclose(a[sample][real], b[at], atol=1e-5)


def test_mixed_is_within_the_rounding_of_bfloat16(rng):
  params, index = make_params(rng), make_index(rng)
  features = jnp.asarray(rng.normal(size=(2, 4, 4, 4, 5)), jnp.float32)
  weights = [rng.normal(size=(2, 12, c)).astype(np.float32) for c in (3, 2, 1)]

  def gradient(mixed):
    def function(*arrays):
      return sparse(*arrays, mixed=mixed)

    return jax.jit(jax.grad(lambda p, f: weighted(function, p, f, index, weights), (0, 1)))(
      params, features
    )

  for a, b in zip(*map(jax.tree.leaves, (gradient(True), gradient(False))), strict=True):
    assert a.dtype == jnp.float32
    np.testing.assert_allclose(a, b, atol=0.05 * max(1, np.abs(b).max()))


def test_no_surface_at_all_is_finite(rng):
  params, index = make_params(rng), make_index(rng, (0, 0))
  features = jnp.asarray(rng.normal(size=(2, 4, 4, 4, 5)), jnp.float32)
  weights = [np.ones((2, 12, c), np.float32) for c in (3, 2, 1)]
  gradient = jax.grad(lambda p: weighted(sparse, p, features, index, weights))(params)
  assert all(np.isfinite(g).all() for g in jax.tree.leaves(gradient))


@pytest.mark.parametrize('count', [0, 7, 8, 9, 13, 14, 33, 64])
def test_capacity_is_the_first_that_holds_all_near_cells(count):
  near = jnp.arange(64).reshape(1, 4, 4, 4) < count

  def function(capacity, x, y, z):
    return jnp.sum(x * x * y) * z.astype(x.dtype), {'capacity': jnp.int32(capacity)}

  def total(x, y):
    return surface.by_capacity(function, near, x, y, jnp.int32(3))

  x, y = jnp.array([1.0, 2]), jnp.array([3.0, 5])
  value, found = jax.jit(total)(x, y)
  (same, _), gradient = jax.jit(jax.value_and_grad(total, (0, 1), has_aux=True))(x, y)
  assert value == same == 69
  assert found['capacity'] == min(c for c in (7, 8, 10, 13, 16, 22, 32, 64) if c >= count)
  jax.tree.map(
    np.testing.assert_array_equal, gradient, (jnp.array([18.0, 60]), jnp.array([3.0, 12]))
  )


def test_devices_share_a_batch(rng):
  """Statistics are the whole batch's, and gradients the sum's, as on one device."""
  params, index = make_params(rng), make_index(rng, (9, 5, 12, 1))
  features = jnp.asarray(rng.normal(size=(4, 4, 4, 4, 5)), jnp.float32)
  weights = [rng.normal(size=(4, 12, c)).astype(np.float32) for c in (3, 2, 1)]

  def loss(capacity, params, features, index):
    return weighted(
      functools.partial(sparse, capacity=capacity), params, features, index, weights
    ), ()

  @jax.jit
  def gradient(params, features, index):
    def total(params, features):
      near = surface.near_cells(index, GRID)
      return surface.by_capacity(loss, near, params, features, index)

    return jax.grad(total, (0, 1), has_aux=True)(params, features)[0]

  mesh = jax.make_mesh((2,), ('batch',), (AxisType.Auto,), devices=jax.devices()[:2])
  spread = jax.device_put((features, index), NamedSharding(mesh, PartitionSpec('batch')))
  jax.tree.map(
    lambda a, b: np.testing.assert_allclose(a, b, atol=1e-5),
    gradient(jax.device_put(params, NamedSharding(mesh, PartitionSpec())), *spread),
    gradient(params, features, index),
  )
