import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from cvn import losses


def _random(shape, seed=0):
  return np.random.default_rng(seed).standard_normal(shape).astype(np.float32)


def _log_loss(probability, occupied):
  return -np.log(np.where(occupied, probability, 1 - probability))


@pytest.mark.parametrize('shape', [(7,), (2, 4, 4, 4, 1)])
def test_msfcel_is_the_sum_of_squared_means_of_either_side(shape):
  logits = _random(shape) * 3
  occupied = _random(shape, 1) > 0.5
  each = _log_loss(1 / (1 + np.exp(-logits.astype(np.float64))), occupied)
  expected = each[~occupied].mean() ** 2 + each[occupied].mean() ** 2
  for target in (occupied, occupied.astype(np.float32)):
    np.testing.assert_allclose(jax.jit(losses.msfcel)(logits, target), expected, rtol=1e-5)


def test_msfcel_counts_voxels_of_the_batch_and_not_of_each_sample():
  logits = _random((2, 8))
  occupied = np.array([[True] * 7 + [False], [True] + [False] * 7])
  swapped = losses.msfcel(logits.reshape(1, 16), occupied.reshape(1, 16))
  np.testing.assert_allclose(losses.msfcel(logits, occupied), swapped, rtol=1e-6)


@pytest.mark.parametrize('occupied', [False, True])
def test_msfcel_of_a_one_sided_volume_is_that_sides_square(occupied):
  logits = jnp.zeros((2, 3, 3, 3, 1))
  value, grad = jax.value_and_grad(losses.msfcel)(logits, jnp.full(logits.shape, occupied))
  np.testing.assert_allclose(value, np.log(2) ** 2, rtol=1e-6)
  sign = -1 if occupied else 1
  np.testing.assert_allclose(grad, sign * np.log(2) / logits.size, rtol=1e-6)


@pytest.mark.parametrize('loss', [losses.msfcel, losses.cross_entropy])
def test_logits_of_any_size_give_finite_values_and_gradients(loss):
  logits = jnp.array([-1e4, 1e4, -200.0, 200.0])
  for occupied in (jnp.array([True, False, False, True]), jnp.array([False, True, True, False])):
    value, grad = jax.value_and_grad(loss)(logits, occupied)
    assert np.isfinite(value) and np.all(np.isfinite(grad))


def test_cross_entropy_is_the_mean_over_all_voxels():
  logits = _random((2, 3, 3, 3, 1))
  occupied = _random(logits.shape, 1) > 1
  expected = _log_loss(1 / (1 + np.exp(-logits)), occupied).mean()
  np.testing.assert_allclose(losses.cross_entropy(logits, occupied), expected, rtol=1e-5)


@pytest.mark.parametrize('loss', [losses.msfcel, losses.cross_entropy])
def test_shape_gradients(loss):
  occupied = _random((2, 9), 1) > 0
  check_grads(lambda x: loss(x, occupied), (_random((2, 9)),), order=1, modes=['rev'], rtol=1e-2)


def test_surface_l2_is_the_mean_euclidean_distance():
  target = np.zeros((3, 2), np.float32)
  prediction = np.array([[3, 4], [6, 8], [9, 9]], np.float32)
  mask = np.array([True, True, False])
  np.testing.assert_allclose(losses.surface_l2(prediction, target, mask), 7.5, rtol=1e-6)


def test_surface_l1_is_the_mean_over_channel_entries():
  target = np.zeros((3, 2), np.float32)
  prediction = np.array([[3, -4], [6, 8], [9, 9]], np.float32)
  mask = np.array([True, True, False])
  np.testing.assert_allclose(losses.surface_l1(prediction, target, mask), 21 / 4, rtol=1e-6)


@pytest.mark.parametrize('distance', [losses.surface_l1, losses.surface_l2])
def test_equal_colours_cost_nothing_and_pull_nowhere(distance):
  color = _random((4, 3))
  value, grad = jax.value_and_grad(distance)(color, color, np.ones(4, bool))
  assert value == 0
  np.testing.assert_array_equal(grad, 0)


@pytest.mark.parametrize('distance', [losses.surface_l1, losses.surface_l2])
def test_an_empty_surface_costs_nothing(distance):
  value, grad = jax.value_and_grad(distance)(_random((4, 3)), _random((4, 3), 1), np.zeros(4, bool))
  assert value == 0
  np.testing.assert_array_equal(grad, 0)


@pytest.mark.parametrize('distance', [losses.surface_l1, losses.surface_l2])
def test_what_is_masked_does_not_matter_even_if_it_is_not_a_number(distance):
  prediction, target = _random((4, 3)), _random((4, 3), 1)
  mask = np.array([True, False, True, False])
  bad = np.where(mask[:, None], prediction, np.nan)
  value, grad = jax.value_and_grad(distance)(bad, target, mask)
  kept, kept_grad = jax.value_and_grad(distance)(prediction[mask], target[mask], mask[mask])
  np.testing.assert_allclose(value, kept, rtol=1e-6)
  np.testing.assert_array_equal(grad[~mask], 0)
  np.testing.assert_allclose(grad[mask], kept_grad, rtol=1e-6)


@pytest.mark.parametrize('distance', [losses.surface_l1, losses.surface_l2])
def test_surface_gradients(distance):
  mask = np.array([[True, False, True], [True, True, True]])
  target = _random((2, 3, 3), 1)
  check_grads(
    lambda x: distance(x, target, mask), (_random((2, 3, 3)),), order=1, modes=['rev'], rtol=1e-2
  )


def test_joint_l2_counts_every_voxel():
  target = np.full((1, 2, 1, 1, 3), -0.5, np.float32)
  prediction = target + np.array([[[[[1, 0, 0]]], [[[1, 1, 1]]]]], np.float32)
  np.testing.assert_allclose(losses.joint_l2(prediction, target), (1 + 3) / 2, rtol=1e-6)


@pytest.mark.parametrize('distance', [losses.surface_l1, losses.surface_l2])
def test_the_colour_objective_is_the_sum_of_its_terms(distance):
  color, flow = _random((2, 5, 3)), _random((2, 5, 2), 1)
  regressed, blended, estimated = (
    _random((2, 5, 3), 2),
    _random((2, 5, 3), 3),
    _random((2, 5, 2), 4),
  )
  mask = _random((2, 5), 5) > 0
  total, terms = losses.color_objective(
    regressed, blended, estimated, color, flow, mask, distance=distance
  )
  np.testing.assert_allclose(terms.flow, distance(estimated, flow, mask))
  np.testing.assert_allclose(terms.regressed, distance(regressed, color, mask))
  np.testing.assert_allclose(terms.blended, distance(blended, color, mask))
  np.testing.assert_allclose(total, sum(terms), rtol=1e-6)


def test_shapes_that_do_not_fit_are_named():
  with pytest.raises(ValueError, match=r'\(2, 3\).*\(2, 4\)'):
    losses.msfcel(jnp.zeros((2, 3)), jnp.zeros((2, 4)))
  with pytest.raises(ValueError, match=r'mask \(3,\).*\(2,\)'):
    losses.surface_l2(jnp.zeros((2, 3)), jnp.zeros((2, 3)), jnp.ones(3, bool))
  with pytest.raises(ValueError, match='differ'):
    losses.joint_l2(jnp.zeros((2, 3)), jnp.zeros((2, 1)))
