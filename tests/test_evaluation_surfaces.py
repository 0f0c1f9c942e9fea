import numpy as np
import pytest
from scipy.spatial import cKDTree

from cvn.evaluation import surfaces


def draw(seed, share=0.02, size=16):
  return np.random.default_rng(seed).random((size,) * 3) < share


@pytest.mark.parametrize('seed', range(4))
def test_distances_are_those_of_a_tree_over_the_centres(seed):
  predicted, true = draw(seed), draw(seed + 10, 0.05)
  found = surfaces.measure(predicted, true)
  points = [(np.argwhere(v) + 0.5) / 16 - 0.5 for v in (predicted, true)]
  for got, (here, there) in zip(found, (points, points[::-1]), strict=True):
    np.testing.assert_allclose(got, cKDTree(there).query(here)[0], atol=1e-12)


def test_f_scores_against_counting_pairs():
  predicted, true = draw(0), draw(1)
  tolerances = (0.01, 1 / 16, 0.1, 0.2)
  gap = np.linalg.norm(np.argwhere(predicted)[:, None] - np.argwhere(true)[None], axis=-1) / 16
  for tolerance, got in zip(
    tolerances,
    surfaces.f_scores(surfaces.measure(predicted, true), tolerances=tolerances),
    strict=True,
  ):
    close = gap <= tolerance + 1e-9
    precision, recall = close.any(1).mean(), close.any(0).mean()
    expected = 2 * precision * recall / (precision + recall) if precision + recall else 0
    assert got == pytest.approx(expected)


def test_below_a_voxel_the_f_score_is_that_of_the_voxels():
  predicted, true = draw(0, 0.3), draw(1, 0.3)
  common = (predicted & true).sum()
  expected = 2 * common / (predicted.sum() + true.sum())
  found = surfaces.f_scores(surfaces.measure(predicted, true), tolerances=(1 / 200, 1 / 100))
  np.testing.assert_allclose(found, expected)


def test_a_shifted_surface():
  true = np.zeros((64,) * 3, bool)
  true[10:20, 30, 10:20] = True
  distances = surfaces.measure(np.roll(true, 2, axis=1), true)
  np.testing.assert_array_equal(surfaces.f_scores(distances), [0, 0, 0, 1])  # 2/64 < 1/20
  assert surfaces.chamfer(distances) == pytest.approx(2 / 64)


def test_the_same_surface_and_empty_ones():
  true, empty = draw(0), np.zeros((16,) * 3, bool)
  same = surfaces.measure(true, true)
  np.testing.assert_array_equal(surfaces.f_scores(same), 1)
  assert surfaces.chamfer(same) == 0
  for predicted, other, expected in ((empty, true, 0), (true, empty, 0), (empty, empty, 1)):
    distances = surfaces.measure(predicted, other)
    np.testing.assert_array_equal(surfaces.f_scores(distances), expected)
    assert np.isnan(surfaces.chamfer(distances))


def test_what_does_not_fit_is_refused():
  with pytest.raises(ValueError, match='differ'):
    surfaces.measure(draw(0), draw(0, size=8))
