"""What experiments.paper.people found, as Markdown for people and as JSON for programs."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from cvn.evaluation import intervals
from cvn.evaluation.intervals import Estimate
from experiments.lib import markdown
from experiments.paper.people.analysis import FRONT_AND_BACK, SIDES, Analysis, Colors, Group

IOU, PSNR = '.3f', '.2f'


class Study(NamedTuple):
  """Everything that was found."""

  category: str
  networks: list[str]  # and how long they were trained
  thresholds: list[float]  # of occupancy, one a seed
  models: list[str]  # ids of the N test models
  scores: dict[str, np.ndarray]  # of scoring.METRICS, [N, V], NaN where no voxel is occupied
  baseline: np.ndarray  # [N, V] the IoU of the mean training shape
  colors: Colors  # of all models, whatever their split
  tested: np.ndarray  # [N, V] the complexities of the test models' views
  analysis: Analysis


def to_markdown(s: Study) -> str:
  """The tables, and what they are tables of."""
  a, c = s.analysis, s.colors
  thresholds = ', '.join(f'{t:g}' for t in s.thresholds)
  psnr = ', '.join(
    f'{title} {_cell(_mean(s.scores[name]), PSNR)} dB'
    for name, title in (('psnr_rgb', 'RGB'), ('psnr_ycbcr', 'YCbCr'))
  )
  low, first, median, third, high = np.quantile(c.complexity, np.linspace(0, 1, 5))
  return '\n'.join(
    [
      f'{len(s.models)} test models ({s.category}), {s.tested.shape[1]} views each;'
      f' occupied: above {thresholds}; in brackets: 95 % over models',
      *s.networks,
      '',
      f'mean IoU {_cell(a.overall, IOU)}, of the mean training shape'
      f' {_cell(intervals.mean(s.baseline), IOU)}; surface PSNR: {psnr}',
      '',
      markdown.table(
        ('azimuth', 'IoU'),
        [(f'{azimuth:g}°', _cell(e, IOU)) for azimuth, e in a.by_azimuth.items()],
      ),
      '',
      f'sides ({_degrees(SIDES)}) {_cell(a.sides, IOU)}, front and back'
      f' ({_degrees(FRONT_AND_BACK)}) {_cell(a.front_and_back, IOU)}; difference, model by model:'
      f' {_cell(a.difference, "+" + IOU)}',
      '',
      markdown.table(
        ('colour complexity', 'test views', 'of models', 'IoU'),
        [(_range(g), g.views, g.models, _cell(g.iou, IOU)) for g in a.by_complexity],
      ),
      '',
      f"Spearman's correlation of complexity and IoU: of views {_cell(a.correlation, '+.2f')}, of"
      f" models' means {_cell(a.correlation_of_models, '+.2f')}",
      '',
      f'complexity of all {c.complexity.size} views of {len(c.complexity)} models: {low:g} to'
      f' {high:g}, median {median:g}, middle half {first:g} to {third:g}; {c.unique} colours, of'
      f' which {c.retained} have {c.t1} pixels or more ({c.coverage:.1%} of the foreground), in'
      f' {c.clusters} clusters; counted from {c.t2 + 1} pixels on',
    ]
  )


def to_json(s: Study) -> dict[str, Any]:
  """The same as JSON values: None where there is no number."""
  a, c = s.analysis, s.colors
  return {
    'category': s.category,
    'networks': s.networks,
    'thresholds': s.thresholds,
    'test_models': s.models,
    'iou': _numbers(a.overall),
    'baseline_iou': _numbers(intervals.mean(s.baseline)),
    **{k: _numbers(_mean(s.scores[k])) for k in ('psnr_rgb', 'psnr_ycbcr')},
    'by_azimuth': {f'{azimuth:g}': _numbers(e) for azimuth, e in a.by_azimuth.items()},
    'sides': _numbers(a.sides),
    'front_and_back': _numbers(a.front_and_back),
    'difference': _numbers(a.difference),
    'by_complexity': [{**g._asdict(), 'iou': _numbers(g.iou)} for g in a.by_complexity],
    'correlation': _numbers(a.correlation),
    'correlation_of_models': _numbers(a.correlation_of_models),
    'colors': {
      **{k: v for k, v in c._asdict().items() if k != 'complexity'},
      'views_by_complexity': np.bincount(c.complexity.ravel()).tolist(),
    },
    'views': {
      name: {'iou': iou.tolist(), 'complexity': complexity.tolist()}
      for name, iou, complexity in zip(s.models, s.scores['iou'], s.tested, strict=True)
    },
  }


def _mean(values):
  return intervals.mean(values, chosen=~np.isnan(values))


def _range(g: Group) -> str:
  return f'{g.lowest}' + (f' to {g.highest}' if g.highest > g.lowest else '')


def _cell(e: Estimate, form: str) -> str:
  if np.isnan(e.value):
    return '-'
  band = '' if np.isnan(e.low) else f' [{e.low:{form}}, {e.high:{form}}]'
  return f'{e.value:{form}}{band}'


def _numbers(e: Estimate) -> dict[str, float | None]:
  return {k: None if np.isnan(v) else v for k, v in e._asdict().items()}


def _degrees(azimuths: Sequence[int]) -> str:
  return ', '.join(f'{a}°' for a in azimuths)
