import jax
import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image
from skimage.metrics import peak_signal_noise_ratio

from cvn import metrics
from cvn.grid import ColoredVoxels


def _voxels(indices, colors, size=8):
  occupancy, color = np.zeros((size,) * 3, bool), np.zeros((size,) * 3 + (3,))
  for index, c in zip(indices, colors, strict=True):
    occupancy[index], color[index] = True, c
  return ColoredVoxels(occupancy, color)


def test_iou_of_boxes():
  a, b = np.zeros((2, 4, 4, 4), bool), np.zeros((2, 4, 4, 4), bool)
  a[:, :2], b[0, 1:3], b[1] = True, True, a[1]
  np.testing.assert_allclose(metrics.iou(a, b), [1 / 3, 1])
  np.testing.assert_allclose(jax.jit(metrics.iou)(jnp.array(a), jnp.array(b)), [1 / 3, 1])


def test_iou_of_disjoint_and_of_empty_shapes():
  empty, full = np.zeros((4, 4, 4), bool), np.ones((4, 4, 4), bool)
  assert metrics.iou(empty, full) == 0
  assert metrics.iou(empty, empty) == 1


def test_iou_names_shapes_that_differ():
  with pytest.raises(ValueError, match=r'\(4, 4, 4\)'):
    metrics.iou(np.zeros((4, 4, 4), bool), np.zeros((1, 4, 4, 4), bool))


def test_psnr_agrees_with_other_libraries():
  rng = np.random.default_rng(0)
  a, b = rng.integers(0, 256, (2, 500, 3)).astype(np.uint8)
  result = metrics.psnr(a / 255, b / 255)
  np.testing.assert_allclose(result.rgb, peak_signal_noise_ratio(a, b), rtol=1e-9)
  # Pillow's conversion is the same one, rounded to whole numbers.
  a, b = (np.asarray(Image.fromarray(x[None]).convert('YCbCr')) for x in (a, b))
  np.testing.assert_allclose(result.ycbcr, peak_signal_noise_ratio(a, b), atol=0.05)


def test_psnr_of_grey_is_the_same_error_in_one_channel_of_three():
  result = metrics.psnr(np.full((5, 3), 0.6), np.full((5, 3), 0.5))
  np.testing.assert_allclose(result, [20, 20 + 10 * np.log10(3)], rtol=1e-9)


def test_equal_colours_are_infinitely_good():
  shape = _voxels([(1, 2, 3), (4, 4, 4)], [(0.1, 0.2, 0.3), (1, 0, 0)])
  assert metrics.surface_psnr(shape, shape) == (np.inf, np.inf)


@pytest.mark.parametrize('which', ['predicted', 'true', 'both'])
def test_without_voxels_there_is_no_psnr(which):
  some, none = _voxels([(1, 1, 1)], [(1, 1, 1)]), _voxels([], [])
  predicted = none if which in ('predicted', 'both') else some
  true = none if which in ('true', 'both') else some
  assert np.isnan(metrics.surface_psnr(predicted, true)).all()


def test_every_predicted_voxel_meets_the_nearest_true_one():
  true = _voxels([(1, 1, 1), (6, 6, 6)], [(1, 0, 0), (0, 0, 1)])
  predicted = _voxels([(0, 0, 0), (1, 1, 1), (7, 6, 5)], [(0, 1, 0)] * 3)
  np.testing.assert_array_equal(
    metrics.aligned_colors(predicted.occupancy, true), [(1, 0, 0), (1, 0, 0), (0, 0, 1)]
  )
  # All three differ by 1 in two of three channels.
  np.testing.assert_allclose(
    metrics.surface_psnr(predicted, true).rgb, -10 * np.log10(2 / 3), rtol=1e-9
  )


def test_shared_voxels_are_compared_with_themselves():
  rng = np.random.default_rng(1)
  occupancy, color = rng.random((12, 12, 12)) < 0.4, rng.random((12, 12, 12, 3))
  true = ColoredVoxels(occupancy, color)
  both = occupancy & (rng.random((12, 12, 12)) < 0.5)
  np.testing.assert_array_equal(metrics.aligned_colors(both, true), color[both])


def test_equally_near_voxels_count_in_row_major_order():
  rng = np.random.default_rng(2)
  predicted = rng.random((14, 14, 14)) < 0.3
  true = ColoredVoxels(rng.random((14, 14, 14)) < 0.05, rng.random((14, 14, 14, 3)))
  surface = np.argwhere(true.occupancy)
  squared = ((np.argwhere(predicted)[:, None] - surface[None]) ** 2).sum(-1)
  assert np.any(np.sort(squared, 1)[:, 0] == np.sort(squared, 1)[:, 1])
  np.testing.assert_array_equal(
    metrics.aligned_colors(predicted, true), true.color[true.occupancy][squared.argmin(1)]
  )


def test_iou_at_many_thresholds_is_the_iou_at_each():
  rng = np.random.default_rng(3)
  score, true = rng.random((5, 5, 5)).astype(np.float32), rng.random((5, 5, 5)) > 0.7
  thresholds = np.array([0.0, 0.3, float(score[0, 0, 0]), 2.0])
  expected = [metrics.iou(score > t, true) for t in sorted(thresholds)]
  np.testing.assert_allclose(metrics.iou_at(score, true, sorted(thresholds)), expected)
  nothing = np.zeros_like(true)
  np.testing.assert_array_equal(metrics.iou_at(score, nothing, [-1.0, 2.0]), [0, 1])
