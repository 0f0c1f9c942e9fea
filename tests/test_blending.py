import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cvn import blending
from cvn.errors import UserError


def test_the_weight_is_the_sampled_colours():
  sampled, regressed = jnp.ones((2, 4, 3)), jnp.zeros((2, 4, 3))
  weight = jnp.linspace(0, 1, 8).reshape(2, 4, 1)
  blended = jax.jit(blending.blend)(sampled, regressed, weight)
  np.testing.assert_allclose(blended, jnp.broadcast_to(weight, (2, 4, 3)), rtol=1e-6)


def test_the_weight_needs_a_channel_axis():
  with pytest.raises(ValueError, match=r'\(2, 4\)'):
    blending.blend(jnp.ones((2, 4, 3)), jnp.ones((2, 4, 3)), jnp.ones((2, 4)))


def test_weights_grow_to_one_at_alpha():
  weight = jnp.array([0.0, 0.1, 0.2, 0.20001, 1.0])
  np.testing.assert_allclose(
    blending.recalculate_weight(weight, alpha=0.2), [0, 0.5, 1, 1, 1], rtol=1e-6
  )


def test_alpha_one_leaves_the_weights():
  weight = jnp.linspace(0, 1, 11)
  np.testing.assert_array_equal(blending.recalculate_weight(weight, alpha=1.0), weight)


@pytest.mark.parametrize('alpha', [0.0, -0.2, 1.01, float('nan'), float('inf')])
def test_alpha_outside_its_range_is_refused(alpha):
  with pytest.raises(UserError, match='alpha must be above 0 and at most 1'):
    blending.recalculate_weight(jnp.ones(3), alpha=alpha)


def test_adjusted_colours_stretch_from_the_threshold_to_one():
  predicted = jnp.array([[0.25, 0.5, 1.0], [0.2, 0.9, 0.9], [-0.5, -0.5, -0.5], [0.3, 0.3, 1.2]])
  occupied, color = blending.adjust_color(predicted, 0.2)
  np.testing.assert_array_equal(occupied, [True, False, False, True])
  np.testing.assert_allclose(color[0], [0.0625, 0.375, 1], rtol=1e-5)
  np.testing.assert_allclose(color[3], [0.125, 0.125, 1], rtol=1e-5)
  assert np.all((color >= 0) & (color <= 1))


def test_a_threshold_of_one_is_refused():
  with pytest.raises(UserError, match='below 1'):
    blending.adjust_color(jnp.ones((2, 3)), 1.0)
