"""Bootstrap intervals of numbers that were measured on some models.

Tables are [N, V]: N models, V views of each. Views of one model are alike, so models are resampled,
each with all its views. An interval runs from the 2.5th to the 97.5th percentile of the resampled
numbers. The random seed is fixed: the same table has the same intervals.
"""

import warnings
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy import stats

LEVEL = 0.95
RESAMPLES = 9999
_BATCH = 250  # resamples at a time: of a thousand models, 24 MB of indices and views


class Estimate(NamedTuple):
  """A number and its interval; NaN without data."""

  value: float
  low: float
  high: float


def mean(values: np.ndarray, *, chosen: np.ndarray | None = None) -> Estimate:
  """The mean of chosen views.

  Args:
    values: [N, V].
    chosen: [N, V] bool; all by default. Models without a chosen view are not among those drawn.
  """
  chosen = np.ones(values.shape, bool) if chosen is None else chosen
  kept = chosen.any(axis=1)
  totals = np.sum(np.where(chosen, values, 0), axis=1)[kept]
  counts = np.sum(chosen, axis=1)[kept]
  return _bootstrap(lambda n: totals[n].sum(-1) / counts[n].sum(-1), len(totals))


def rank_correlation(x: np.ndarray, y: np.ndarray) -> Estimate:
  """Spearman's correlation over all views of the tables x and y [N, V]."""

  def centered_ranks(table, drawn):
    ranks = stats.rankdata(table[drawn].reshape(*drawn.shape[:-1], -1), axis=-1)
    return ranks - ranks.mean(-1, keepdims=True)

  def correlate(drawn):
    a, b = centered_ranks(x, drawn), centered_ranks(y, drawn)
    with np.errstate(invalid='ignore'):  # 0 / 0 where all views are the same
      return (a * b).sum(-1) / np.sqrt((a * a).sum(-1) * (b * b).sum(-1))

  return _bootstrap(correlate, len(x))


def _bootstrap(statistic: Callable[[np.ndarray], np.ndarray], models: int) -> Estimate:
  """A statistic of models, and its interval.

  Args:
    statistic: of drawn models [..., N] int, to [...].
    models: N.
  """
  everyone = np.arange(models)
  if models < 2:  # nothing varies
    return Estimate(float(statistic(everyone)) if models else np.nan, np.nan, np.nan)
  with warnings.catch_warnings():
    # Where drawn models may have no correlation there is no interval: NaN says so.
    warnings.simplefilter('ignore', stats.DegenerateDataWarning)
    found = stats.bootstrap(
      (everyone,),
      lambda drawn, axis: statistic(drawn),
      vectorized=True,
      n_resamples=RESAMPLES,
      batch=_BATCH,
      confidence_level=LEVEL,
      method='percentile',
      rng=np.random.default_rng(0),
    )
  low, high = found.confidence_interval
  return Estimate(float(statistic(everyone)), float(low), float(high))
