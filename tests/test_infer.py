"""Inference with every kind of network, on small ones with random parameters."""

import functools

import jax
import numpy as np
import pytest

from cvn import blending, carving, data, infer, readouts, sampler
from cvn.errors import UserError
from cvn.infer import Network, reconstruct, reconstruct_alphas
from cvn.networks import NETWORKS, ColorNetwork, ShapeNetwork

IMAGE, GRID = 32, 16
BLEND = ('regressed', 'sampled', 'weight')


@functools.cache
def make_network(kind, seed=0):
  module = NETWORKS[kind](IMAGE, GRID)
  image = np.zeros((1, IMAGE, IMAGE, 3), np.float32)
  shapes = jax.eval_shape(lambda: module.init(jax.random.key(0), image, train=False))
  rng = np.random.default_rng(seed)

  def draw(path, x):
    noise = 0.05 * rng.standard_normal(x.shape, np.float32)
    return 1 + abs(noise) if path[-1].key in ('var', 'scale') else noise

  return Network(kind, module, jax.tree_util.tree_map_with_path(draw, shapes))


def make_views(count=2):
  """Random colours everywhere, opaque within a disc."""
  views = np.random.default_rng(2).random((count, IMAGE, IMAGE, 4), np.float32)
  rows, columns = np.indices((IMAGE, IMAGE)) + 0.5
  views[..., 3] = np.hypot(rows - IMAGE / 2, columns - IMAGE / 2) < IMAGE / 3
  return views


def run(views, **options):
  """With a shape and a colour network."""
  return reconstruct(views, shape=make_network('shape'), color=make_network('color', 1), **options)


def assert_equal(found, expected, atol=1e-5):
  for name, a, b in zip(found._fields, found, expected, strict=True):
    assert (a is None) == (b is None), name
    if a is not None:
      np.testing.assert_allclose(a, b, atol=atol, err_msg=name)


def test_shapes_and_ranges():
  result = run(make_views())
  volume = (2, GRID, GRID, GRID)
  channels = {'occupancy': (), 'probability': (), 'weight': (), 'flow': (2,)}
  for name, x in jax.device_get(result)._asdict().items():
    assert x.shape == volume + channels.get(name, (3,)), name
    assert np.all((x >= 0) & (x <= 1)), name


def test_it_is_the_networks_on_the_composed_image_and_nothing_else():
  views = make_views()
  opacity = views[..., 3:]
  image = views[..., :3] * opacity + np.float32(data.GREY) * (1 - opacity)
  result = run(views)
  shape, color = make_network('shape'), make_network('color', 1)

  @jax.jit
  def networks(shape, color, image):
    logits = ShapeNetwork(IMAGE, GRID).apply(shape, image, train=False)[..., 0]
    return logits, ColorNetwork(IMAGE, GRID).apply(color, image, train=False)

  logits, volumes = networks(shape.variables, color.variables, image)
  np.testing.assert_allclose(result.probability, jax.nn.sigmoid(logits), atol=1e-5)
  np.testing.assert_allclose(result.regressed, volumes.regressed, atol=1e-5)
  np.testing.assert_allclose(result.flow, volumes.flow, atol=1e-5)
  weight = blending.recalculate_weight(volumes.weight)
  np.testing.assert_allclose(result.weight, weight[..., 0], atol=5e-5)
  sampled = sampler.nearest_foreground(image, result.flow, opacity[..., 0] > 0.5)
  np.testing.assert_allclose(result.sampled, sampled, atol=1e-6)


@pytest.mark.parametrize('alpha', [0.2, 0.55, 1.0])
@pytest.mark.parametrize('flip', [False, True])
def test_the_colours_are_the_blend_of_the_volumes_beside_them(flip, alpha):
  result = run(make_views(), flip=flip, alpha=alpha)
  regressed, sampled, weight = (getattr(result, k) for k in BLEND)
  blended = blending.blend(sampled, regressed, weight[..., None])
  np.testing.assert_allclose(result.color, blended, atol=1e-5)


def test_several_alphas_are_those_of_single_runs():
  views, color = make_views(), make_network('color', 1)
  alphas = (0.2, 0.6, 1.0)
  for alpha, found in zip(
    alphas, reconstruct_alphas(views, alphas, color=color, flip=True), strict=True
  ):
    assert_equal(found, reconstruct(views, color=color, flip=True, alpha=alpha), atol=0)


def test_a_single_view_has_no_batch_axis():
  views = make_views()
  assert_equal(run(views[1]), jax.tree.map(lambda x: x[1], run(views)))


def test_views_of_bytes_are_those_of_fractions():
  views = np.round(make_views() * 255).astype(np.uint8)
  found, expected = run(views), run(views.astype(np.float32) / 255)
  assert_equal(found, expected, atol=1e-5)


def test_what_is_behind_transparent_pixels_does_not_matter():
  views = make_views()
  other = views.copy()
  other[..., :3] = np.where(views[..., 3:] > 0, views[..., :3], 0.123)
  assert_equal(run(views), run(other), atol=0)


def test_only_foreground_is_sampled():
  views = make_views()
  views[..., :3] = np.where(views[..., 3:] > 0, (0.9, 0.1, 0.2), 0.5)
  sampled = run(views).sampled
  np.testing.assert_allclose(sampled, np.broadcast_to((0.9, 0.1, 0.2), sampled.shape), rtol=1e-6)


def test_edge_pixels_keep_their_own_colour():
  views = make_views()
  views[..., :3] = (0.9, 0.1, 0.2)
  views[..., 3] *= 0.6
  sampled = run(views).sampled
  np.testing.assert_allclose(sampled, np.broadcast_to((0.9, 0.1, 0.2), sampled.shape), rtol=1e-6)


def test_without_alpha_the_background_is_what_the_corner_shows():
  views = make_views()
  image = np.where(views[..., 3:] > 0, views[..., :3], np.float32(data.GREY))
  assert_equal(run(views), run(image))


def test_a_view_without_any_object_gives_finite_results():
  views = make_views()
  views[..., 3] = 0
  result = run(views)
  assert all(np.all(np.isfinite(x)) for x in result)
  assert np.all(result.sampled == np.float32(data.GREY))


def test_views_of_a_batch_do_not_touch_each_other():
  views = make_views()
  other = views.copy()
  other[1] = 0.5
  for a, b in zip(run(views), run(other), strict=True):
    np.testing.assert_allclose(a[0], b[0], atol=1e-6)


def test_each_network_is_traced_once_whatever_the_options():
  run(make_views(), flip=True)
  before = infer._run._cache_size()
  for n in range(3):
    run(make_views() * np.float32(1 - 0.1 * n), alpha=0.5 + 0.1 * n, flip=n > 0, carve=n > 1)
  assert infer._run._cache_size() == before


def test_voxels_are_occupied_from_the_threshold_on():
  views = make_views()[0]
  probability = np.asarray(run(views).probability)
  threshold = float(np.sort(probability.ravel())[-5])  # float32: the fifth is at the threshold
  found = run(views, threshold=threshold)
  np.testing.assert_array_equal(found.occupancy, probability >= threshold)
  voxels = infer.to_voxels(found)
  assert voxels.occupancy.sum() == 5
  np.testing.assert_array_equal(voxels.color, found.color)


@pytest.mark.parametrize('kind', readouts.COLOR_KINDS)
def test_colours_of_every_kind(kind):
  views, network = make_views(), make_network(kind)
  found = reconstruct(views, color=network)
  assert found.occupancy is None and found.probability is None
  assert found.color.shape == (2, GRID, GRID, GRID, 3)
  assert found.color.min() >= 0 and found.color.max() <= 1
  if kind == 'flow':  # all colours are pixels of the object
    for color, view in zip(np.asarray(found.color), views, strict=True):
      pixels = {tuple(p) for p in view[view[..., 3] == 1][:, :3]}
      assert {tuple(c) for c in color.reshape(-1, 3)} <= pixels


def test_the_unified_network_runs_once_for_shape_and_colour(monkeypatch):
  views, network, runs = make_views(), make_network('joint'), []
  run = infer._run
  monkeypatch.setattr(infer, '_run', lambda *a: runs.append(a) or run(*a))
  both = reconstruct(views, shape=network, color=network)
  assert len(runs) == 1
  shape, color = reconstruct(views, shape=network), reconstruct(views, color=network)
  assert_equal(both, color._replace(occupancy=shape.occupancy, probability=shape.probability))


def test_the_joint_baseline_has_one_threshold_for_shape_and_colour():
  views, network = make_views(), make_network('r2n2')
  plain = reconstruct(views, shape=network)
  threshold = float(np.quantile(plain.probability, 0.9))
  volume = network.module.apply(
    network.variables, data.composite(views).astype(np.float32), train=False
  )
  np.testing.assert_allclose(plain.probability, volume.min(-1), atol=1e-5)
  np.testing.assert_array_equal(plain.occupancy, plain.probability >= -0.25)
  color = blending.adjust_color(volume, threshold)[1]
  for options in ({'shape': network}, {}):
    found = reconstruct(views, color=network, threshold=threshold, **options)
    np.testing.assert_allclose(found.color, color, atol=1e-5)
  # The threshold of another network's shapes is none of its own.
  found = reconstruct(views, shape=make_network('shape'), color=network, threshold=threshold)
  np.testing.assert_allclose(found.color, blending.adjust_color(volume, -0.25)[1], atol=1e-5)


@pytest.mark.parametrize('kind', readouts.SHAPE_KINDS)
def test_flipped_shapes_are_the_mean_with_the_mirrored_objects(kind):
  views, network = make_views(), make_network(kind)
  plain, other, found = (
    reconstruct(v, shape=network, flip=flip).probability
    for v, flip in ((views, False), (views[:, :, ::-1], False), (views, True))
  )
  np.testing.assert_allclose(found, (plain + other[:, ::-1]) / 2, atol=1e-6)


@pytest.mark.parametrize('kind', readouts.COLOR_KINDS)
def test_flipped_colours_are_the_mean_with_the_mirrored_objects(kind):
  views, network = make_views(), make_network(kind)
  plain, other, found = (
    reconstruct(v, color=network, flip=flip)
    for v, flip in ((views, False), (views[:, :, ::-1], False), (views, True))
  )
  np.testing.assert_allclose(found.color, (plain.color + other.color[:, ::-1]) / 2, atol=1e-6)


def test_a_symmetric_view_has_a_symmetric_reconstruction():
  half = make_views()[:, :, : IMAGE // 2]
  found = run(np.concatenate([half, half[:, :, ::-1]], 2), flip=True)
  for name, x in jax.device_get(found)._asdict().items():
    mirrored = x[:, ::-1] if name != 'flow' else x[:, ::-1] * (-1, 1) + (1, 0)
    np.testing.assert_allclose(x, mirrored, atol=1e-5, err_msg=name)


def test_carved_shapes_are_those_of_carving():
  views, network = make_views(), make_network('joint')
  plain = reconstruct(views, shape=network, flip=True).probability
  found = reconstruct(views, shape=network, flip=True, carve=True, azimuths=[0, 90])
  expected = carving.carve(plain, views[..., 3] > 0.5, azimuths=(0, 90))
  np.testing.assert_allclose(found.probability, expected, atol=1e-6)
  np.testing.assert_array_equal(found.occupancy, found.probability >= 0.8)
  assert (found.probability == 0).any()


def test_unsuitable_networks_are_refused():
  views = make_views()
  with pytest.raises(UserError, match='needs occupancy probabilities'):
    reconstruct(views, shape=make_network('r2n2'), carve=True)
  with pytest.raises(UserError, match='a color network predicts no shapes: take one of shape, '):
    reconstruct(views, shape=make_network('color'))
  with pytest.raises(UserError, match='a shape network predicts no colours'):
    reconstruct(views, color=make_network('shape'))
  with pytest.raises(ValueError, match='give a shape network, a colour network or both'):
    reconstruct(views)


def test_alpha_outside_its_range_is_refused():
  with pytest.raises(UserError, match='alpha'):
    run(make_views(), alpha=0.0)


@pytest.mark.parametrize('shape', [(32, 32), (2, 32, 32, 2), (1, 2, 32, 32, 4)])
def test_other_arrays_than_views_are_refused(shape):
  with pytest.raises(ValueError, match='views must be'):
    run(np.zeros(shape, np.float32))
