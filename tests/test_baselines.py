import numpy as np

from cvn import metrics
from cvn.evaluation import baselines

SIZE = 6


def _surfaces(models, seed):
  """Random shapes around one they share."""
  rng = np.random.default_rng(seed)
  common = rng.random((SIZE,) * 3) < 0.3
  return [np.argwhere(common ^ (rng.random((SIZE,) * 3) < 0.25)) for _ in range(models)]


def _volume(surface):
  volume = np.zeros((SIZE,) * 3, bool)
  volume[tuple(surface.T)] = True
  return volume


def test_mean_shape_of_one_model_is_that_model():
  (surface,) = _surfaces(1, 0)
  np.testing.assert_array_equal(baselines.mean_shape([surface], SIZE), _volume(surface))


def test_mean_shape_has_the_best_mean_iou_of_all_thresholds():
  surfaces = _surfaces(9, 1)
  volumes = np.stack([_volume(s) for s in surfaces])
  count = volumes.sum(0)

  def score(occupancy):
    return metrics.iou(np.broadcast_to(occupancy, volumes.shape), volumes).mean()

  found = baselines.mean_shape([s.astype(np.uint8) for s in surfaces], SIZE)
  scores = [score(count >= k) for k in range(1, 10)]
  np.testing.assert_allclose(score(found), max(scores))
  np.testing.assert_array_equal(found, count >= 1 + np.argmax(scores))


def test_mean_color_weighs_voxels_alike():
  colors = [np.full((3, 3), 0.2), np.full((1, 3), 1.0)]
  np.testing.assert_allclose(baselines.mean_color(colors), [0.4] * 3)
