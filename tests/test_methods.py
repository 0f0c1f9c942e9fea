"""Every kind of network says something of a view, and the joint baseline by its own rules."""

import jax
import numpy as np
import pytest

from cvn import blending, carving, methods, networks, reconstruct
from cvn.errors import UserError

IMAGE, GRID = 64, 32


@pytest.fixture(scope='module')
def views():
  rng = np.random.default_rng(0)
  rgba = rng.random((2, IMAGE, IMAGE, 4), np.float32)
  rgba[..., 3] = rgba[..., 3] > 0.5
  return rgba


def make_variables(kind):
  network = networks.NETWORKS[kind](IMAGE, GRID)
  image = np.zeros((1, IMAGE, IMAGE, 3), np.float32)
  return jax.jit(lambda k: network.init(k, image, train=False))(jax.random.key(0))


@pytest.mark.parametrize('kind', ['regression', 'flow', 'r2n2', 'joint'])
def test_colors_of_every_voxel(kind, views):
  found = methods.colors(kind, make_variables(kind), views, grid_size=GRID)
  assert found.shape == (2, GRID, GRID, GRID, 3)
  assert found.min() >= 0 and found.max() <= 1
  if kind == 'flow':  # all colours are pixels of the object
    for color, view in zip(found, views, strict=True):
      pixels = {tuple(p) for p in view[view[..., 3] == 1][:, :3]}
      assert {tuple(c) for c in color.reshape(-1, 3)} <= pixels


def test_the_unified_network_answers_both(views):
  variables = make_variables('joint')
  both = reconstruct.estimate_joint(variables, views, grid_size=GRID)
  score = methods.score('joint', variables, views, grid_size=GRID)
  np.testing.assert_array_equal(score, both.probability)
  color = methods.colors('joint', variables, views, alpha=0.5, grid_size=GRID)
  weight = blending.recalculate_weight(both.weight, 0.5)[..., None]
  np.testing.assert_allclose(color, blending.blend(both.sampled, both.regressed, weight), atol=1e-6)


def test_the_joint_baseline_has_one_threshold_for_shape_and_color(views):
  variables = make_variables('r2n2')
  score = methods.score('r2n2', variables, views, grid_size=GRID)
  volume = reconstruct.estimate_r2n2(variables, views, grid_size=GRID)
  threshold = float(np.quantile(score, 0.9))
  occupied, color = blending.adjust_color(volume, threshold)
  np.testing.assert_array_equal(score > threshold, occupied)
  np.testing.assert_array_equal(
    methods.colors('r2n2', variables, views, threshold=threshold, grid_size=GRID), color
  )


@pytest.mark.parametrize('kind', ['shape', 'r2n2'])
def test_flipped_estimates_are_those_of_the_mirrored_object_mirrored(kind, views):
  variables = make_variables(kind)
  plain = methods.score(kind, variables, views, grid_size=GRID)
  other = methods.score(kind, variables, views[:, :, ::-1], grid_size=GRID)
  found = methods.score(kind, variables, views, flip=True, grid_size=GRID)
  np.testing.assert_allclose(found, (plain + other[:, ::-1]) / 2, atol=1e-6)
  # A symmetric view has a symmetric estimate.
  symmetric = np.concatenate([views[:, :, : IMAGE // 2], views[:, :, : IMAGE // 2][:, :, ::-1]], 2)
  found = methods.score(kind, variables, symmetric, flip=True, grid_size=GRID)
  np.testing.assert_allclose(found, found[:, ::-1], atol=1e-6)


def test_carved_scores_are_those_of_carving(views):
  variables = make_variables('joint')
  options = {'flip': True, 'grid_size': GRID}
  plain = methods.score('joint', variables, views, **options)
  found = methods.score('joint', variables, views, carve=[0, 90], **options)
  expected = carving.carve(plain, views[..., 3] > 0.5, (0, 90))
  np.testing.assert_allclose(found, expected, atol=1e-6)
  assert (found == 0).any()
  with pytest.raises(UserError, match='no probabilities'):
    methods.score('r2n2', None, views, carve=[0], grid_size=GRID)


def test_flipped_colors(views):
  variables = make_variables('regression')
  plain, other = (
    methods.colors('regression', variables, v, grid_size=GRID) for v in (views, views[:, :, ::-1])
  )
  found = methods.colors('regression', variables, views, flip=True, grid_size=GRID)
  np.testing.assert_allclose(found, (plain + other[:, ::-1]) / 2, atol=1e-6)
