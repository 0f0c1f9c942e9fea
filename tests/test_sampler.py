import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads
from scipy import ndimage

from cvn import sampler


def _image(shape=(2, 6, 8, 3), seed=0):
  return np.random.default_rng(seed).random(shape, np.float32)


def _centers(height, width):
  """Flow [H, W, 2] of all pixel centres."""
  u, v = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
  return np.stack([u, v], -1).astype(np.float32)


@pytest.mark.parametrize('sample', [sampler.bilinear, sampler.nearest])
def test_pixel_centres_give_the_pixels(sample):
  image = _image((2, 4, 8, 3))  # sizes at which the centres are exact
  flow = np.stack([_centers(4, 8)] * 2)
  np.testing.assert_array_equal(jax.jit(sample)(image, flow), image)


def test_bilinear_agrees_with_scipy_everywhere():
  image = _image()
  flow = np.random.default_rng(1).uniform(-0.2, 1.2, (2, 5, 4, 3, 2)).astype(np.float32)
  result = sampler.bilinear(image, flow)
  assert result.shape == (2, 5, 4, 3, 3)
  for b in range(2):
    coordinates = [flow[b, ..., 1] * 6 - 0.5, flow[b, ..., 0] * 8 - 0.5]
    for c in range(3):
      expected = ndimage.map_coordinates(image[b, ..., c], coordinates, order=1, mode='nearest')
      np.testing.assert_allclose(result[b, ..., c], expected, atol=2e-6)


def test_coordinates_past_the_border_take_its_colour():
  image = _image((1, 4, 4, 3))
  corners = np.array([[[-3, -3], [0, 0], [1, 0], [4, -1], [0, 1], [1, 1], [2, 2]]], np.float32)
  expected = image[0, [0, 0, 0, 0, 3, 3, 3], [0, 0, 3, 3, 0, 3, 3]]
  for sample in (sampler.bilinear, sampler.nearest):
    np.testing.assert_array_equal(sample(image, corners)[0], expected)


def test_the_slope_is_right_at_exact_pixel_centres():
  ramp = np.broadcast_to(np.arange(8, dtype=np.float32)[None, None, :, None], (1, 8, 8, 1))
  flow = jnp.array([[[3.5 / 8, 2.5 / 8]]])
  slope = jax.grad(lambda f: sampler.bilinear(ramp, f).sum())(flow)
  np.testing.assert_array_equal(slope, [[[8, 0]]])


def test_the_slope_vanishes_past_the_border():
  flow = jnp.array([[[-0.1, 0.5], [1.1, 0.5]]])
  slope = jax.grad(lambda f: sampler.bilinear(_image((1, 4, 4, 3)), f).sum())(flow)
  np.testing.assert_array_equal(slope[..., 0], 0)


def test_bilinear_gradients_in_image_and_flow():
  rng = np.random.default_rng(2)
  cell = rng.integers(0, 5, (2, 7, 2))
  flow = ((cell + rng.uniform(0.6, 1.4, (2, 7, 2))) / (8, 6)).astype(np.float32)
  check_grads(sampler.bilinear, (_image(), flow), order=1, modes=['rev'], eps=1e-3, rtol=1e-2)


def test_nearest_takes_the_pixel_that_holds_the_coordinate():
  image = _image((1, 4, 4, 3))
  flow = np.array([[[0.25, 0.0], [0.2499, 0.74], [0.9999, 0.75]]], np.float32)
  np.testing.assert_array_equal(sampler.nearest(image, flow)[0], image[0, [0, 2, 3], [1, 0, 3]])


def test_nearest_sends_no_gradient_to_the_flow():
  flow = jnp.array([[[0.3, 0.6]]])
  slope = jax.grad(lambda f: sampler.nearest(_image((1, 4, 4, 3)), f).sum())(flow)
  np.testing.assert_array_equal(slope, 0)


def _first_nearest(mask):
  """Brute force: the nearest true pixel, the first in row-major order among equals."""
  true = np.argwhere(mask)
  pixels = np.argwhere(np.ones_like(mask))
  squared = ((pixels[:, None] - true[None]) ** 2).sum(-1)
  return true[squared.argmin(1)].reshape(*mask.shape, 2)


@pytest.mark.parametrize('share', [0.02, 0.3, 0.98])
@pytest.mark.parametrize('size', [(9, 9), (7, 16), (16, 5)])
def test_nearest_foreground_is_exact_and_breaks_ties_in_row_major_order(size, share):
  height, width = size
  rng = np.random.default_rng(int(100 * share) + height)
  mask = rng.random((3, height, width)) < share
  mask[:, rng.integers(height), rng.integers(width)] = True
  image = _image((3, height, width, 2))
  flow = np.stack([_centers(height, width)] * 3)
  result = jax.jit(sampler.nearest_foreground)(image, flow, mask)
  for b in range(3):
    row, column = np.moveaxis(_first_nearest(mask[b]), -1, 0)
    np.testing.assert_array_equal(result[b], image[b, row, column])
    distance = ndimage.distance_transform_edt(~mask[b])
    own_row, own_column = np.indices((height, width))
    np.testing.assert_allclose(np.hypot(row - own_row, column - own_column), distance)


def test_foreground_pixels_are_sampled_as_they_are():
  image, mask = _image(), np.ones((2, 6, 8), bool)
  flow = np.random.default_rng(3).random((2, 50, 2), np.float32)
  np.testing.assert_array_equal(
    sampler.nearest_foreground(image, flow, mask), sampler.nearest(image, flow)
  )


def test_an_image_without_foreground_is_sampled_as_it_is():
  image, mask = _image(), np.zeros((2, 6, 8), bool)
  mask[1, 2, 3] = True
  flow = np.random.default_rng(3).random((2, 50, 2), np.float32)
  result = sampler.nearest_foreground(image, flow, mask)
  np.testing.assert_array_equal(result[0], sampler.nearest(image, flow)[0])
  np.testing.assert_array_equal(result[1], np.broadcast_to(image[1, 2, 3], (50, 3)))


def test_background_is_what_has_the_red_of_the_corner_in_every_channel():
  image = np.full((2, 4, 4, 3), 245 / 255, np.float32)
  image[1] = 0.25
  image[0, 1, 1] = 0.5
  image[0, 2, 2, 2] = 246 / 255  # one channel is enough
  image[0, 3, 3] += 0.0009
  expected = np.zeros((2, 4, 4), bool)
  expected[0, 1, 1] = expected[0, 2, 2] = True
  np.testing.assert_array_equal(sampler.foreground_from_color(image), expected)
  image[0, 0, 0] = (0.5, 0, 0)  # now the pixel of three times 0.5 is the only ground
  assert np.argwhere(~np.asarray(sampler.foreground_from_color(image)[0])).tolist() == [[1, 1]]


def test_shapes_that_do_not_fit_are_named():
  with pytest.raises(ValueError, match=r'\(4, 4, 3\)'):
    sampler.bilinear(jnp.zeros((4, 4, 3)), jnp.zeros((4, 2)))
  with pytest.raises(ValueError, match=r'\(1, 5, 3\)'):
    sampler.nearest(jnp.zeros((1, 4, 4, 3)), jnp.zeros((1, 5, 3)))
  with pytest.raises(ValueError, match=r'foreground \(4, 4\)'):
    sampler.nearest_foreground(
      jnp.zeros((1, 4, 4, 3)), jnp.zeros((1, 5, 2)), jnp.ones((4, 4), bool)
    )


def test_training_on_the_filled_image_is_nearest_foreground_at_pixel_centres():
  rng = np.random.default_rng(0)
  image = np.full((2, 8, 8, 3), 0.9, np.float32)
  image[:, 2:5, 3:7] = rng.random((2, 3, 4, 3)) * 0.5
  foreground = np.zeros((2, 8, 8), bool)
  foreground[:, 2:5, 3:7] = True
  centres = (np.stack(np.meshgrid(np.arange(8), np.arange(8)), -1) + 0.5) / 8
  flow = np.broadcast_to(centres, (2, 8, 8, 2)).astype(np.float32)
  found = sampler.bilinear_foreground(image, flow)
  np.testing.assert_allclose(found, sampler.nearest_foreground(image, flow, foreground), atol=1e-6)
  np.testing.assert_allclose(found, sampler.fill(image, foreground), atol=1e-6)
  np.testing.assert_array_equal(sampler.fill(image, foreground)[foreground], image[foreground])
  slope = jax.grad(lambda f: sampler.bilinear_foreground(image, f)[..., 0].sum())(flow + 0.01)
  assert np.isfinite(slope).all() and np.abs(slope[:, 3, 3:6]).min() > 0
