"""The training step: it learns, it compiles once, and its pieces are what the recipes say."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cvn import blending, losses, sampler, train
from cvn.data import Batch
from cvn.grid import PADDING_INDEX
from cvn.networks import NETWORKS, ColorNetwork
from cvn.objectives import OBJECTIVES
from cvn.recipe import PAPER, RECIPES, RELEASE, cosine, norm_decay

SLOTS = 256

# Compiled once for the whole file: what takes time here is the compiler.
_make_step = functools.cache(train.make_step)
_make_eval = functools.cache(train.make_eval)


def make_step(kind, recipe, mixed=False):
  return _make_step(NETWORKS[kind](mixed=mixed), OBJECTIVES[kind], recipe)


def make_eval(kind, recipe):
  return _make_eval(NETWORKS[kind](), OBJECTIVES[kind], recipe)


def create_state(kind):
  return train.create_state(jax.random.key(0), NETWORKS[kind]())


def make_batch(seed=0, size=2):
  """A batch of random views and surfaces, the last slots of each padded."""
  rng = np.random.default_rng(seed)
  index = rng.integers(0, 64, (size, SLOTS, 3)).astype(np.int32)
  index[:, -50:] = PADDING_INDEX
  return Batch(
    image=rng.random((size, 128, 128, 3), np.float32),
    index=index,
    color=rng.random((size, SLOTS, 3), np.float32),
    flow=rng.random((size, SLOTS, 2), np.float32),
  )


@pytest.mark.parametrize(
  ('kind', 'mixed'),
  [('shape', False), ('shape', True), ('color', False), ('color', True)]
  + [('regression', True), ('flow', True), ('joint', True), ('r2n2', True)],
)
def test_a_few_steps_lower_the_loss_with_one_trace(kind, mixed):
  step = make_step(kind, PAPER, mixed=mixed)
  state = create_state(kind)
  batch, found = make_batch(), []
  for _ in range(3):
    state, metrics = step(state, batch)
    found.append(float(metrics['loss']))
  assert np.isfinite(found).all()
  assert found[2] < found[0]
  assert step._cache_size() == 1
  assert int(state.step) == 3
  assert all(x.dtype == jnp.float32 for x in jax.tree.leaves(state.params))


@pytest.mark.parametrize('mixed', [False, True])
def test_steps_at_the_surface_lower_the_loss_with_one_trace(mixed):
  """However many cells are near the surface: a few at first, then all of them."""
  step = train.make_surface_step(ColorNetwork(mixed=mixed), PAPER)
  state = create_state('color')
  structure = jax.tree.structure(state)
  batch, found = make_batch(), []
  full = np.stack(np.unravel_index(np.arange(0, 64**3, 64**3 // SLOTS), (64,) * 3), -1)
  for _ in range(3):
    state, metrics = step(state, batch)
    found.append(float(metrics['loss']))
  state, metrics = step(state, batch._replace(index=np.stack([full.astype(np.int32)] * 2)))
  assert np.isfinite([*found, float(metrics['loss'])]).all()
  assert found[2] < found[0]
  assert step._cache_size() == 1
  assert jax.tree.structure(state) == structure


def test_color_loss_sees_only_surface_voxels():
  batch = make_batch()
  evaluate = make_eval('color', PAPER)
  state = create_state('color')
  expected = evaluate(state, batch)
  padded = batch.index[..., :1] == PADDING_INDEX
  other = batch._replace(
    color=np.where(padded, np.float32(9), batch.color),
    flow=np.where(padded, np.float32(-9), batch.flow),
  )
  assert jax.tree.all(
    jax.tree.map(lambda a, b: float(a) == float(b), evaluate(state, other), expected)
  )


def test_sparse_color_loss_is_the_dense_one():
  rng = np.random.default_rng(1)
  batch = make_batch(size=1)
  voxels = rng.choice(64**3, SLOTS, replace=False)  # no voxel twice, as in a data set
  batch = batch._replace(
    index=np.stack(np.unravel_index(voxels, (64,) * 3), -1)[None].astype(np.int32)
  )
  state = create_state('color')
  variables = {'params': state.params, 'batch_stats': state.batch_stats}
  network = ColorNetwork()
  volumes = jax.jit(lambda v, x: network.apply(v, x, train=False))(variables, batch.image)
  at = (0, *batch.index[0].T)
  mask = np.zeros((1, 64, 64, 64), bool)
  color, flow = np.full((1, 64, 64, 64, 3), -1.0), np.full((1, 64, 64, 64, 2), -1.0)
  mask[at], color[at], flow[at] = True, batch.color[0], batch.flow[0]
  blended = blending.blend(
    sampler.bilinear(batch.image, volumes.flow), volumes.regressed, volumes.weight
  )
  dense, _ = losses.color_objective(volumes.regressed, blended, volumes.flow, color, flow, mask)
  sparse = make_eval('color', PAPER)(state, batch)['loss']
  np.testing.assert_allclose(sparse, dense, rtol=1e-5)


@pytest.mark.parametrize('kind', ['shape', 'color'])
def test_empty_surface_is_finite(kind):
  batch = make_batch()
  batch = batch._replace(index=np.full_like(batch.index, PADDING_INDEX))
  state, metrics = make_step(kind, PAPER)(create_state(kind), batch)
  assert np.isfinite(float(metrics['loss']))
  assert all(np.isfinite(x).all() for x in jax.tree.leaves(state))


def test_running_statistics_follow_the_decay():
  batch, step = make_batch(), make_step('shape', PAPER)
  ones = create_state('shape')
  zeros = ones._replace(batch_stats=jax.tree.map(jnp.zeros_like, ones.batch_stats))
  was = jax.tree.map(np.asarray, ones.batch_stats)
  became, from_zeros = (
    jax.tree.map(np.asarray, step(jax.tree.map(jnp.copy, s), batch)[0].batch_stats)
    for s in (ones, zeros)
  )
  # Of what was there, half goes in 60 samples; the batch's own statistics take the place.
  kept = 0.5 ** (len(batch.image) / 60)
  jax.tree.map(
    lambda o, n, b: np.testing.assert_allclose(n, kept * o + b, rtol=1e-5, atol=1e-6),
    was,
    became,
    from_zeros,
  )
  variance = from_zeros['trunk']['encoder']['conv0']['norm']['var'] / (1 - kept)
  assert (variance > 1e-3).all()


def test_recalibrated_statistics_are_the_mean_of_the_batches_own():
  """A step with nothing to remember has the batch's statistics, times what its decay leaves."""
  state = create_state('shape')
  state = state._replace(batch_stats=jax.tree.map(jnp.zeros_like, state.batch_stats))
  params = jax.tree.map(np.asarray, state.params)
  batches = [make_batch(seed) for seed in (0, 1)]
  renewed = train.make_recalibration(NETWORKS['shape']())(state, batches)
  kept = 0.5 ** (len(batches[0].image) / 60)
  own = [
    make_step('shape', PAPER)(jax.tree.map(jnp.copy, state), b)[0].batch_stats for b in batches
  ]
  jax.tree.map(
    lambda found, a, b: np.testing.assert_allclose(
      found, (a + b) / 2 / (1 - kept), rtol=1e-4, atol=1e-5
    ),
    renewed.batch_stats,
    *own,
  )
  jax.tree.map(np.testing.assert_array_equal, renewed.params, params)


def test_release_adds_the_kernel_penalty():
  batch = make_batch()
  state = create_state('shape')
  plain, penalised = (float(make_eval('shape', r)(state, batch)['loss']) for r in (PAPER, RELEASE))
  leaves = jax.tree_util.tree_leaves_with_path(state.params)
  kernels = sum(float(jnp.abs(x).sum()) for path, x in leaves if path[-1].key == 'kernel')
  np.testing.assert_allclose(penalised - plain, 1e-5 * kernels, rtol=1e-3)


def test_schedules():
  samples = jnp.array([0.0, 19_999, 20_000, 60_000, 1e7])
  np.testing.assert_allclose(
    RELEASE.schedule(RELEASE.learning_rate, 1e9)(samples),
    [3e-4, 3e-4, 2.1e-4, 1.029e-4, 1e-5],
    rtol=1e-5,
  )
  np.testing.assert_allclose(norm_decay(samples, 60), [0.5, 0.5, 0.75, 0.9375, 0.99], rtol=1e-5)
  np.testing.assert_allclose(norm_decay(samples, 12) ** 5, norm_decay(samples, 60), rtol=1e-5)
  np.testing.assert_allclose(PAPER.schedule(PAPER.learning_rate, 1e9)(samples), 3e-4)
  quarters = cosine(1.0, 100)(jnp.array([0.0, 25, 50, 100]))
  np.testing.assert_allclose(quarters, [1, 0.5 + 0.5**0.5 / 2, 0.5, 0], atol=1e-6)
  np.testing.assert_allclose(cosine(1.0, np.inf)(samples), 1)  # no end is known
  assert sorted(RECIPES) == ['best', 'paper', 'release']


def test_the_learning_rate_is_that_of_the_samples_seen():
  """Adam's update is the rate itself while the gradient stays the same."""
  params, size = {'kernel': jnp.zeros(())}, 5000
  optimizer = train.make_optimizer(RELEASE, batch_size=size)
  opt_state = optimizer.init(params)
  for step in range(9):
    with jax.numpy_dtype_promotion('standard'):
      updates, opt_state = optimizer.update({'kernel': jnp.ones(())}, opt_state)
    rate = 3e-4 * 0.7 ** (step * size // 20000)
    np.testing.assert_allclose(updates['kernel'], -rate, rtol=1e-4)
