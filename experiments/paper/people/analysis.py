"""The dependence of the IoU on the view's azimuth and colour complexity.

Tables are [N, V]: N test models, V views of each.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cvn.errors import UserError
from cvn.evaluation import complexity, intervals
from cvn.evaluation.intervals import Estimate

SIDES, FRONT_AND_BACK = (90, 270), (0, 180)  # degrees
GROUPS = 6  # of views by complexity, of about as many views each


class Colors(NamedTuple):
  """The colours of a set of views."""

  complexity: np.ndarray  # [N, V]
  unique: int  # number of colours
  retained: int  # colours with at least t1 pixels
  coverage: float  # share of foreground pixels with a retained colour
  clusters: int  # fewer than asked for if too few colours are retained
  t1: int  # as of cvn.evaluation.complexity
  t2: int


class Group(NamedTuple):
  """Views of about the same complexity."""

  lowest: int
  highest: int
  views: int
  models: int
  iou: Estimate


class Analysis(NamedTuple):
  """Mean IoU, by azimuth and by colour complexity."""

  overall: Estimate
  by_azimuth: dict[float, Estimate]
  sides: Estimate
  front_and_back: Estimate
  difference: Estimate  # sides - front and back, model by model
  by_complexity: list[Group]
  correlation: Estimate  # Spearman's, between complexity and IoU of views
  correlation_of_models: Estimate  # the same for the models' means


def check_azimuths(azimuths: Sequence[float]) -> None:
  """Raises UserError unless there are views from both sides, the front and the back."""
  missing = [f'{a}°' for a in (*FRONT_AND_BACK, *SIDES) if a not in azimuths]
  if missing:
    raise UserError(
      f'the data set has no views from {", ".join(missing)}: make one with these azimuths'
    )


def analyze(azimuths: Sequence[float], iou: np.ndarray, complexities: np.ndarray) -> Analysis:
  """The analysis of a table of IoUs.

  Args:
    azimuths: [V] degrees, as `check_azimuths` wants them.
    iou: [N, V].
    complexities: [N, V] of the input views.
  """
  sides, others = (_mean_at(azimuths, iou, wanted) for wanted in (SIDES, FRONT_AND_BACK))
  return Analysis(
    intervals.mean(iou),
    {a: intervals.mean(iou[:, [v]]) for v, a in enumerate(azimuths)},
    intervals.mean(sides),
    intervals.mean(others),
    intervals.mean(sides - others),
    group_by_complexity(complexities, iou),
    intervals.rank_correlation(complexities, iou),
    intervals.rank_correlation(*(x.mean(1, keepdims=True) for x in (complexities, iou))),
  )


def group_by_complexity(complexities: np.ndarray, iou: np.ndarray) -> list[Group]:
  """IoU in groups of views from low to high complexity; views of equal complexity stay together."""
  highest = np.quantile(complexities, np.arange(1, GROUPS + 1) / GROUPS, method='inverted_cdf')
  group = np.searchsorted(np.unique(highest), complexities)
  return [
    Group(
      int(complexities[group == g].min()),
      int(complexities[group == g].max()),
      int(np.sum(group == g)),
      int(np.sum((group == g).any(1))),
      intervals.mean(iou, chosen=group == g),
    )
    for g in range(group.max() + 1)
  ]


def measure_colors(
  palettes: Sequence[Sequence[complexity.Palette]], *, t1: int, clusters: int, t2: int
) -> Colors:
  """The complexity of all views of a set.

  Args:
    palettes: [N][V] of the views' foreground.
    t1, clusters, t2: as of cvn.evaluation.complexity.

  Raises:
    UserError: no colour has t1 pixels.
  """
  whole = complexity.merge([p for views in palettes for p in views])
  centers = complexity.cluster(whole, t1=t1, clusters=clusters)
  retained = whole.count >= t1
  return Colors(
    np.array([[complexity.complexity(p, centers, t2=t2) for p in views] for views in palettes]),
    len(retained),
    int(retained.sum()),
    float(whole.count[retained].sum() / whole.count.sum()),
    len(centers),
    t1,
    t2,
  )


def _mean_at(azimuths, iou, wanted):
  """[N, 1] means over the views at some azimuths."""
  return iou[:, [list(azimuths).index(a) for a in wanted]].mean(1, keepdims=True)
