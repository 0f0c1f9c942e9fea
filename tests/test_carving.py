"""A silhouette carves a shape, from the azimuth that the shape itself tells."""

import numpy as np
import pytest
from scipy import ndimage

from cvn import camera, carving, grid, metrics

SIZE, IMAGE = 32, 64
AZIMUTHS = (0, 45, 90, 135, 180, 225, 270, 315)


def make_object():
  """A shape that looks different from everywhere: a slab, on it a post and a block."""
  shape = np.zeros((SIZE,) * 3, bool)
  shape[6:26, 8:11, 10:22] = True
  shape[6:10, 11:27, 10:14] = True
  shape[18:24, 11:18, 18:22] = True
  return shape


def draw(shape, azimuth, image=IMAGE):
  """The silhouette [H, W] of voxels, from points all through them."""
  mask = np.zeros((image, image), bool)
  corners = np.stack(np.meshgrid(*[np.linspace(-0.5, 0.5, 5)] * 3, indexing='ij'), -1)
  points = grid.index_to_world(np.argwhere(shape)[:, None] + corners.reshape(-1, 3), size=SIZE)
  pixel, _ = camera.project(points, camera.camera_at(azimuth, image_size=image))
  column, row = np.floor(pixel.reshape(-1, 2)).astype(int).T
  mask[row, column] = True
  return mask


@pytest.fixture(scope='module')
def masks():
  return np.stack([draw(make_object(), a) for a in AZIMUTHS])


def test_the_azimuth_is_told_from_the_shape(masks):
  shape = np.broadcast_to(make_object().astype(np.float32), (len(AZIMUTHS), *(SIZE,) * 3))
  weights = np.asarray(carving.azimuth_weights(shape, masks, azimuths=AZIMUTHS))
  np.testing.assert_allclose(weights.sum(1), 1, atol=1e-5)
  np.testing.assert_array_equal(weights.argmax(1), np.arange(len(AZIMUTHS)))
  assert weights.max(1).min() > 0.7


def test_what_lies_outside_the_silhouette_goes_and_all_else_stays(masks):
  true = make_object()
  estimate = true.astype(np.float32)
  estimate[8:12, 8:30, 28:31] = 0.9  # a wall that is not there
  found = np.asarray(carving.carve(np.stack([estimate] * len(masks)), masks, azimuths=AZIMUTHS))
  assert found.min() >= 0 and found.max() <= 1 + 1e-6
  assert found[:, true].mean(1).min() > 0.98
  before = metrics.iou(estimate >= 0.8, true)
  after = metrics.iou(found >= 0.8, np.broadcast_to(true, found.shape))
  assert (after > before + 0.03).all()
  wall = estimate == np.float32(0.9)
  for view in (1, 2, 6):  # from where it lies beside the object
    assert found[view][wall].max() < 0.05
  pixel, _ = camera.project(
    grid.index_to_world(np.argwhere(wall), size=SIZE), camera.camera_at(0, image_size=IMAGE)
  )
  column, row = np.floor(pixel).astype(int).T
  assert found[0][wall][masks[0][row, column]].min() > 0.7  # from where it lies before it


def test_the_silhouette_is_explained_by_what_is_likeliest_along_the_ray(masks):
  true = make_object()
  estimate = true.astype(np.float32)
  post = np.zeros_like(true)
  post[6:10, 12:27, 10:14] = True
  estimate[post] = 0.6  # the network is not sure of it, but nothing else is there
  estimate[11:14, 12:27, 10:14] = 0.3  # and less of what is beside it
  found = np.asarray(carving.carve(estimate[None], masks[2:3], azimuths=AZIMUTHS))[0]
  assert found[post].mean() > 0.75
  assert found[estimate == np.float32(0.3)].max() < 0.6


def test_what_an_unsure_network_spreads_over_the_inside_does_not_fill_it():
  """Occupancy is the surface: of a block of nearly even doubt, walls stay, and nothing inside."""
  true = np.zeros((SIZE,) * 3, bool)
  true[6:26, 6:26, 8:24] = True
  doubt = np.random.default_rng(0).uniform(0.44, 0.46, true.shape).astype(np.float32)
  estimate = np.where(true, doubt, 0)
  view = draw(true, AZIMUTHS[1])[None]
  found = np.asarray(carving.carve(estimate[None], view, azimuths=AZIMUTHS[1:2]))[0]
  inside = np.zeros_like(true)
  inside[8:24, 8:24, 10:22] = True
  assert (found[inside] == 0).all()
  assert found[true & ~inside].mean() > 0.7


def test_a_thin_surface_has_no_inside():
  estimate = np.zeros((1, SIZE, SIZE, SIZE), np.float32)
  estimate[:, 4:28, 4:28, 8:12] = 0.9  # a wall of four voxels
  estimate[:, 4:28, 4:28, 18] = 0.6
  foreground = np.ones((1, IMAGE, IMAGE), bool)
  found = np.asarray(carving.carve(estimate, foreground, azimuths=AZIMUTHS))
  assert (found >= estimate - 1e-6).all()


def test_a_view_that_is_all_foreground_carves_nothing():
  probability = np.random.default_rng(0).random((2, SIZE, SIZE, SIZE), np.float32)
  foreground = np.ones((2, IMAGE, IMAGE), bool)
  found = np.asarray(carving.carve(probability, foreground, azimuths=AZIMUTHS))
  kept = found >= probability - 1e-6
  assert found.max() <= 1 + 1e-6
  # All that goes is what is about the smallest within two voxels: the inside of something.
  least = ndimage.minimum_filter(probability, (1, 5, 5, 5), mode='constant', cval=1)
  assert (kept | (found == 0)).all() and (least >= 0.85 * probability)[~kept].all()
  # Where nothing is likely, nothing becomes so.
  found = carving.carve(0.3 * probability, foreground, azimuths=AZIMUTHS)
  np.testing.assert_allclose(found, np.where(kept, 0.6 * probability, 0), atol=2e-2)


def test_a_shape_nobody_is_sure_of_counts_every_azimuth_alike(masks):
  faint = 0.5 * make_object().astype(np.float32)[None]
  weights = carving.azimuth_weights(faint, masks[:1], azimuths=AZIMUTHS)
  np.testing.assert_allclose(weights, 1 / len(AZIMUTHS), atol=1e-6)


def test_the_mirrored_view_carves_the_mirrored_shape(masks):
  probability = np.random.default_rng(1).random((1, SIZE, SIZE, SIZE), np.float32)
  probability = np.maximum(probability * 0.7, make_object())
  found = np.asarray(carving.carve(probability, masks[1:2], azimuths=AZIMUTHS))
  other = np.asarray(carving.carve(probability[:, ::-1], masks[1:2, :, ::-1], azimuths=AZIMUTHS))
  # Centres that project onto the border of two pixels may fall to either side.
  assert (np.abs(found - other[:, ::-1]) < 1e-3).mean() > 0.99


def test_other_arrays_are_refused():
  with pytest.raises(ValueError, match='are needed'):
    carving.carve(np.zeros((1, 8, 8, 4)), np.zeros((1, 16, 16), bool))
  with pytest.raises(ValueError, match='are needed'):
    carving.carve(np.zeros((2, 8, 8, 8)), np.zeros((1, 16, 16), bool))
