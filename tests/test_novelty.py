"""How far features lie from those of training."""

import jax
import jax.numpy as jnp
import numpy as np

from cvn import novelty
from cvn.data import composite
from cvn.networks import ShapeNetwork


def trained(views):
  """Variables whose running statistics are those of some views."""
  network = ShapeNetwork(32, 16)
  images = composite(views)
  variables = network.init(jax.random.key(0), images, train=False)
  _, found = network.apply(variables, images, train=True, mutable='batch_stats')
  return {'params': variables['params'], **found}


def test_training_images_deviate_by_one_variance_and_others_by_more():
  rng = np.random.default_rng(0)
  usual = np.ones((24, 32, 32, 4), np.float32)
  usual[..., :3] = rng.uniform(0.4, 0.6, (24, 1, 1, 3)) + rng.normal(0, 0.05, (24, 32, 32, 3))
  usual = np.clip(usual, 0, 1)
  variables = trained(usual)
  found = novelty.feature_deviation(variables, usual)
  assert found.shape == (24,)
  np.testing.assert_allclose(jnp.mean(found), 1, atol=0.3)
  stripes = usual.copy()
  stripes[:, ::4, :, :3] = 0
  assert novelty.feature_deviation(variables, stripes).min() > 2 * found.max()


def test_bytes_and_floats_agree():
  views = np.random.default_rng(0).integers(0, 256, (2, 32, 32, 4), np.uint8)
  variables = trained(views)
  a, b = (novelty.feature_deviation(variables, v) for v in (views, views / np.float32(255)))
  np.testing.assert_allclose(a, b, rtol=1e-3)
