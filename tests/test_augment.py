"""Augmented elements are elements of other objects."""

import itertools

import numpy as np
import pytest
import synthetic

from cvn import augment, camera, data, grid


@pytest.fixture(scope='module')
def made(tmp_path_factory):
  return synthetic.make_dataset(
    tmp_path_factory.mktemp('data') / 'set', 1, azimuths=(0, 120), image_size=16, grid_size=16
  )


def test_a_mirrored_element_is_the_mirrored_objects_view(made):
  """Azimuth a of the object, turned over, is azimuth -a of the object mirrored in x."""
  slots, size = data.max_voxels(made), made.manifest.grid_size
  element = data.read_color(made, 0, 1, max_voxels=slots)
  found = augment.mirrored(element, grid_size=size)
  real = element.index[:, 0] != grid.PADDING_INDEX
  expected = [size - 1, 0, 0] + element.index[real].astype(int) * [-1, 1, 1]
  np.testing.assert_array_equal(found.index[real], expected)
  assert (found.index[~real] == grid.PADDING_INDEX).all() and not found.flow[~real].any()
  np.testing.assert_array_equal(found.image[:, ::-1], element.image)
  np.testing.assert_array_equal(found.color, element.color)
  view = camera.camera_at(-made.manifest.azimuths[1], image_size=made.manifest.image_size)
  pixel, _ = camera.project(grid.index_to_world(found.index[real], size=size), view)
  flow = data.decode(found).flow
  np.testing.assert_allclose(flow[real], pixel / made.manifest.image_size, atol=1e-4)
  twice = augment.mirrored(found, grid_size=size)
  np.testing.assert_array_equal(twice.index, element.index)
  np.testing.assert_array_equal(twice.flow, element.flow)
  shape = augment.mirrored(data.read_shape(made, 0, 1, max_voxels=slots), grid_size=size)
  np.testing.assert_array_equal(shape.index, found.index)


def test_image_and_surface_are_recolored_alike(made):
  element = data.read_color(made, 0, 1, max_voxels=data.max_voxels(made))
  ends = np.array([[0, 1], [1, 0], [0.25, 0.75]])
  found = augment.recolored(element, order=[2, 0, 1], ends=ends)
  was, now = (e.image[..., :3].astype(float) for e in (element, found))
  np.testing.assert_array_equal(now[..., 0], was[..., 2])
  np.testing.assert_array_equal(now[..., 1], 255 - was[..., 0])
  np.testing.assert_allclose(now[..., 2], 0.25 * 255 + 0.5 * was[..., 1], atol=0.51)
  np.testing.assert_array_equal(found.image[..., 3], element.image[..., 3])
  assert data.decode(found).image[0, 0].tolist() == [np.float32(data.GREY)] * 3
  real = element.index[:, 0] != grid.PADDING_INDEX
  np.testing.assert_array_equal(found.color[real, 1], 255 - element.color[real, 0])
  assert not found.color[~real].any() and found.color.dtype == np.uint8
  for same in ('index', 'flow'):
    np.testing.assert_array_equal(getattr(found, same), getattr(element, same))
  shape = data.ShapeBatch(element.image, element.index)
  shape = augment.recolored(shape, order=[2, 0, 1], ends=ends)
  np.testing.assert_array_equal(shape.image, found.image)


def test_random_colours_keep_contrast():
  rng = np.random.default_rng(0)
  drawn = [augment.draw_colors(rng) for _ in range(200)]
  assert {tuple(order) for order, _ in drawn} == set(itertools.permutations(range(3)))
  ends = np.stack([e for _, e in drawn])
  spans = ends[..., 1] - ends[..., 0]
  assert ends.min() >= 0 and ends.max() <= 1 and abs(spans).min() >= 0.5 and spans.min() < 0
  natural = (ends == [0, 1]).all((1, 2))
  assert 0.4 < natural.mean() < 0.6
