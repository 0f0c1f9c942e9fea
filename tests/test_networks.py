"""The networks: parameters, shapes, ranges, and what `train` changes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cvn.networks import (
  JOINT_MEAN,
  JOINT_SPREAD,
  NETWORKS,
  AdaptedR2N2,
  ColorNetwork,
  ColorVolumes,
  FlowNetwork,
  JointNetwork,
  RegressionNetwork,
  ShapeNetwork,
)

SMALL = {'image_size': 64, 'grid_size': 32}


def parameter_count(network):
  shapes = jax.eval_shape(
    lambda: network.init(jax.random.key(0), jnp.zeros((1, 128, 128, 3)), train=False)
  )
  return sum(x.size for x in jax.tree.leaves(shapes['params']))


def test_shape_network_has_the_published_number_of_parameters():
  # The authors' program, counting biases, gamma and beta.
  assert parameter_count(ShapeNetwork()) == 7_668_115


@pytest.mark.parametrize('network', NETWORKS.values())
def test_about_seven_million_parameters(network):
  assert 7e6 < parameter_count(network()) < 8e6


@pytest.mark.parametrize('network', NETWORKS.values())
def test_outputs(network):
  network = network(**SMALL)
  image = jax.random.uniform(jax.random.key(1), (2, 64, 64, 3))
  variables = network.init(jax.random.key(0), image, train=False)
  out, mutated = jax.jit(lambda v, x: network.apply(v, x, train=True, mutable='batch_stats'))(
    variables, image
  )
  channels = {
    ShapeNetwork: 1,
    ColorNetwork: ColorVolumes(3, 2, 1),
    JointNetwork: (1, ColorVolumes(3, 2, 1)),
    RegressionNetwork: 3,
    FlowNetwork: 2,
    AdaptedR2N2: 3,
  }[type(network)]
  assert jax.tree.map(lambda x: x.shape, out) == jax.tree.map(
    lambda c: (2, 32, 32, 32, c), channels
  )
  assert all(np.isfinite(x).all() for x in jax.tree.leaves(out))
  volumes = out[1] if isinstance(network, JointNetwork) else out
  if isinstance(volumes, ColorVolumes):
    assert all(x.min() >= 0 and x.max() <= 1 for x in volumes)
  # Training returns this batch's statistics, whatever the running ones were.
  before, after = jax.tree.leaves(variables['batch_stats']), jax.tree.leaves(mutated['batch_stats'])
  assert any(not np.allclose(a, b) for a, b in zip(before, after, strict=True))


def test_the_joint_baseline_starts_at_the_spread_of_its_target():
  """-0.5 where empty, colours of mean 0.5 on a fortieth of the voxels."""
  target = np.where(np.arange(4000) % 40 == 0, 0.5, -0.5)
  assert JOINT_MEAN == pytest.approx(target.mean(), abs=0.01)
  assert JOINT_SPREAD == pytest.approx(target.std(), abs=0.01)
  network = AdaptedR2N2(**SMALL)
  image = jax.random.uniform(jax.random.key(1), (2, 64, 64, 3))
  variables = network.init(jax.random.key(0), image, train=False)
  out, _ = network.apply(variables, image, train=True, mutable='batch_stats')
  np.testing.assert_allclose(out.mean((0, 1, 2, 3)), JOINT_MEAN, atol=1e-3)
  np.testing.assert_allclose(out.std((0, 1, 2, 3)), JOINT_SPREAD, rtol=2e-2)


def test_evaluation_treats_every_image_alone():
  network = ShapeNetwork(**SMALL)
  image = jax.random.uniform(jax.random.key(1), (3, 64, 64, 3))
  variables = network.init(jax.random.key(0), image, train=False)
  apply = jax.jit(lambda x: network.apply(variables, x, train=False))
  together, alone = apply(image), apply(image[1:2])
  np.testing.assert_allclose(together[1:2], alone, rtol=1e-4, atol=1e-5)


def test_wrong_image_size_is_refused():
  with pytest.raises(ValueError, match='128, 128, 3'):
    ShapeNetwork().init(jax.random.key(0), jnp.zeros((1, 64, 64, 3)), train=False)


def test_mixed_precision_needs_no_loss_scaling():
  """bfloat16 has the range of float32: gradients 2^40 times smaller are the same numbers."""
  network = ShapeNetwork(**SMALL, mixed=True)
  image = jax.random.uniform(jax.random.key(1), (2, 64, 64, 3))
  variables = network.init(jax.random.key(0), image, train=False)
  weights = jax.random.normal(jax.random.key(2), (2, 32, 32, 32, 1)) / 32**3

  @jax.jit
  @jax.grad
  def gradient(params, scale):
    variables_of_it = {**variables, 'params': params}
    out, _ = network.apply(variables_of_it, image, train=True, mutable='batch_stats')
    return scale * jnp.sum(out * weights)

  plain = gradient(variables['params'], 1.0)
  for scale in (2.0**-40, 2.0**10):
    scaled = jax.tree.map(lambda g, s=scale: g / s, gradient(variables['params'], scale))
    jax.tree.map(
      lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-6, atol=1e-20), scaled, plain
    )
