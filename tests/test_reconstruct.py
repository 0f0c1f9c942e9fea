"""Inference, on small networks with random parameters."""

import functools

import jax
import numpy as np
import pytest

from cvn import blending, reconstruct, sampler
from cvn.errors import UserError
from cvn.networks import ColorNetwork, ShapeNetwork

IMAGE, GRID = 32, 16


def _variables(network, seed):
  image = np.zeros((1, IMAGE, IMAGE, 3), np.float32)
  shapes = jax.eval_shape(lambda: network.init(jax.random.key(0), image, train=False))
  rng = np.random.default_rng(seed)

  def draw(path, x):
    noise = 0.05 * rng.standard_normal(x.shape, np.float32)
    return 1 + abs(noise) if path[-1].key in ('var', 'scale') else noise

  return jax.tree_util.tree_map_with_path(draw, shapes)


@functools.cache
def _networks():
  return _variables(ShapeNetwork(IMAGE, GRID), 0), _variables(ColorNetwork(IMAGE, GRID), 1)


def _views(count=2):
  """Random colours everywhere, opaque within a disc."""
  views = np.random.default_rng(2).random((count, IMAGE, IMAGE, 4), np.float32)
  rows, columns = np.indices((IMAGE, IMAGE)) + 0.5
  views[..., 3] = np.hypot(rows - IMAGE / 2, columns - IMAGE / 2) < IMAGE / 3
  return views


def _reconstruct(views, *, background=reconstruct.GREY, **options):
  # An argument that is given is another signature to the compiler than one left out.
  options |= {'background': background, 'grid_size': GRID}
  return reconstruct.reconstruct(*_networks(), views, **options)


def test_shapes_and_ranges():
  result = _reconstruct(_views())
  volume = (2, GRID, GRID, GRID)
  channels = {'probability': (), 'weight': (), 'flow': (2,)}
  for name, x in result._asdict().items():
    assert x.shape == volume + channels.get(name, (3,)), name
    assert np.all((x >= 0) & (x <= 1)), name


def test_it_is_the_networks_on_the_composed_image_and_nothing_else():
  views = _views()
  opacity = views[..., 3:]
  image = views[..., :3] * opacity + np.float32(0.25) * (1 - opacity)
  result = _reconstruct(views, background=0.25)

  @jax.jit
  def networks(shape, color, image):
    logits = ShapeNetwork(IMAGE, GRID).apply(shape, image, train=False)[..., 0]
    return logits, ColorNetwork(IMAGE, GRID).apply(color, image, train=False)

  logits, volumes = networks(*_networks(), image)
  np.testing.assert_allclose(result.probability, jax.nn.sigmoid(logits), atol=1e-5)
  np.testing.assert_allclose(result.regressed, volumes.regressed, atol=1e-5)
  np.testing.assert_allclose(result.flow, volumes.flow, atol=1e-5)
  np.testing.assert_allclose(result.weight, volumes.weight[..., 0], atol=1e-5)
  sampled = sampler.nearest_foreground(image, result.flow, opacity[..., 0] > 0.5)
  np.testing.assert_allclose(result.sampled, sampled, atol=1e-6)
  weight = blending.recalculate_weight(result.weight[..., None])
  blended = blending.blend(result.sampled, result.regressed, weight)
  np.testing.assert_allclose(result.blended, blended, atol=1e-5)


def test_what_is_behind_transparent_pixels_does_not_matter():
  views = _views()
  other = views.copy()
  other[..., :3] = np.where(views[..., 3:] > 0, views[..., :3], 0.123)
  for a, b in zip(_reconstruct(views), _reconstruct(other), strict=True):
    np.testing.assert_array_equal(a, b)


def test_only_foreground_is_sampled():
  views = _views()
  views[..., :3] = np.where(views[..., 3:] > 0, (0.9, 0.1, 0.2), 0.5)
  sampled = _reconstruct(views).sampled
  np.testing.assert_allclose(sampled, np.broadcast_to((0.9, 0.1, 0.2), sampled.shape), rtol=1e-6)


def test_edge_pixels_keep_their_own_colour():
  views = _views()
  views[..., :3] = (0.9, 0.1, 0.2)
  views[..., 3] *= 0.6
  sampled = _reconstruct(views).sampled
  np.testing.assert_allclose(sampled, np.broadcast_to((0.9, 0.1, 0.2), sampled.shape), rtol=1e-6)


def test_without_alpha_the_ground_is_what_the_corner_shows():
  views = _views()
  ground = np.float32(reconstruct.GREY)
  image = np.where(views[..., 3:] > 0, views[..., :3], ground)
  for a, b in zip(_reconstruct(views), _reconstruct(image), strict=True):
    np.testing.assert_allclose(a, b, atol=1e-5)


def test_a_view_without_any_object_gives_finite_results():
  views = _views()
  views[..., 3] = 0
  result = _reconstruct(views)
  assert all(np.all(np.isfinite(x)) for x in result)
  assert np.all(result.sampled == np.float32(reconstruct.GREY))


def test_views_of_a_batch_do_not_touch_each_other():
  views = _views()
  other = views.copy()
  other[1] = 0.5
  for a, b in zip(_reconstruct(views), _reconstruct(other), strict=True):
    np.testing.assert_allclose(a[0], b[0], atol=1e-6)


def test_the_inference_is_one_program_traced_once():
  _reconstruct(_views())
  before = reconstruct.reconstruct._cache_size()
  for seed in range(3):
    _reconstruct(_views() * np.float32(1 - 0.1 * seed), background=0.1 * seed)
  assert reconstruct.reconstruct._cache_size() == before


def test_voxels_are_occupied_from_the_threshold_on():
  one = jax.tree.map(lambda x: np.array(x[0]), _reconstruct(_views()))
  probability = np.zeros_like(one.probability)
  probability[1, 2, 3], probability[2, 3, 4] = 0.8, 0.79
  voxels = reconstruct.to_voxels(one._replace(probability=probability))
  assert np.argwhere(voxels.occupancy).tolist() == [[1, 2, 3]]
  np.testing.assert_array_equal(voxels.color, one.blended)
  lower = reconstruct.to_voxels(one._replace(probability=probability), 0.5)
  assert lower.occupancy.sum() == 2


def test_alpha_outside_its_range_is_refused():
  with pytest.raises(UserError, match='alpha'):
    _reconstruct(_views(), alpha=0.0)


def test_other_arrays_than_views_are_refused():
  with pytest.raises(ValueError, match=r'views must be .*\(32, 32, 3\)'):
    _reconstruct(_views()[0, ..., :3])
