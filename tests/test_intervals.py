"""Bootstrap intervals: known formulas, coverage, and what cannot be told."""

import numpy as np
import pytest
from scipy import stats

from cvn.evaluation import intervals


def test_mean_of_models_as_the_normal_distribution_has_it():
  values = np.random.default_rng(0).normal(3, 1, (200, 1))
  found = intervals.mean(values)
  half = 1.96 * values.std() / np.sqrt(200)
  assert found.value == pytest.approx(values.mean())
  assert found.low == pytest.approx(values.mean() - half, abs=0.1 * half)
  assert found.high == pytest.approx(values.mean() + half, abs=0.1 * half)


def test_views_of_a_model_are_no_models():
  """Twelve times the same view tells no more than one."""
  once = np.random.default_rng(0).normal(size=(30, 1))
  assert intervals.mean(np.repeat(once, 12, axis=1)) == pytest.approx(intervals.mean(once))


def test_mean_of_chosen_views():
  values = np.array([[1.0, 100.0], [2.0, 3.0], [100.0, 100.0]])
  chosen = np.array([[True, False], [True, True], [False, False]])
  found = intervals.mean(values, chosen=chosen)
  assert found.value == 2
  # Of the two models that have such views: twice the first, both, twice the second.
  assert (found.low, found.high) == (1, 2.5)


def test_rank_correlation_is_spearmans():
  rng = np.random.default_rng(0)
  x = rng.integers(5, 15, (20, 4))
  y = x + rng.normal(0, 3, x.shape)
  found = intervals.rank_correlation(x, y)
  assert found.value == pytest.approx(stats.spearmanr(x.ravel(), y.ravel()).statistic)
  assert 0 < found.low < found.value < found.high < 1
  assert intervals.rank_correlation(x, np.exp(x)).value == pytest.approx(1)
  assert intervals.rank_correlation(x, -x).value == pytest.approx(-1)


def test_intervals_hold_the_truth_as_often_as_they_say():
  rng = np.random.default_rng(0)
  held = 0
  for _ in range(100):
    models = rng.normal(size=(30, 1)) + 0.5 * rng.normal(size=(30, 3))
    found = intervals.mean(models)
    held += found.low < 0 < found.high
  assert 85 <= held <= 100


def test_too_little_has_no_interval():
  one = intervals.mean(np.array([[1.0, 2.0]]))
  assert one.value == 1.5 and np.isnan([one.low, one.high]).all()
  assert np.isnan(intervals.mean(np.zeros((0, 3)))).all()
  assert np.isnan(intervals.mean(np.ones((3, 2)), chosen=np.zeros((3, 2), bool))).all()
  assert np.isnan(intervals.rank_correlation(np.ones((4, 2)), np.arange(8).reshape(4, 2))).all()


def test_the_same_table_has_the_same_interval():
  values = np.random.default_rng(0).normal(size=(9, 2))
  assert intervals.mean(values) == intervals.mean(values)
