"""The results of experiments.paper.people, as JSON values and as Markdown."""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from cvn.evaluation import intervals
from cvn.evaluation.intervals import Estimate
from experiments.lib import markdown, stages, tables
from experiments.lib.markdown import escape
from experiments.paper.people.analysis import FRONT_AND_BACK, SIDES, Analysis, Colors


class Study(NamedTuple):
  """All results."""

  category: str
  networks: list[str]  # and how long they were trained
  thresholds: list[float]  # of occupancy, one for each seed
  models: list[str]  # ids of the N test models
  scores: dict[str, np.ndarray]  # by the keys of scoring.METRICS, [N, V], NaN without voxels
  baseline: np.ndarray  # [N, V] the IoU of the mean training shape
  colors: Colors  # of all models of all splits
  tested: np.ndarray  # [N, V] the complexities of the test models' views
  analysis: Analysis


def to_json(s: Study) -> dict[str, Any]:
  """The results as JSON values; null where there is no number."""
  c = s.colors
  low, first, median, third, high = np.quantile(c.complexity, np.linspace(0, 1, 5)).tolist()
  found = {
    'category': s.category,
    'networks': s.networks,
    'thresholds': s.thresholds,
    'test_models': s.models,
    'baseline_iou': intervals.mean(s.baseline),
    **{k: _mean(s.scores[k]) for k in ('psnr_rgb', 'psnr_ycbcr')},
    **s.analysis._asdict(),
    'by_azimuth': {f'{azimuth:g}': e for azimuth, e in s.analysis.by_azimuth.items()},
    'colors': {
      **{k: v for k, v in c._asdict().items() if k != 'complexity'},
      'models': len(c.complexity),
      'views_by_complexity': np.bincount(c.complexity.ravel()).tolist(),
      'quartiles': [low, first, median, third, high],
    },
    'views': {
      name: {'iou': iou.tolist(), 'complexity': complexity.tolist()}
      for name, iou, complexity in zip(s.models, s.scores['iou'], s.tested, strict=True)
    },
  }
  return stages.plain(found)


def to_markdown(found: Mapping[str, Any]) -> str:
  """The tables of `to_json`'s values."""

  def cell(e: Mapping[str, float | None], form: str) -> str:
    return tables.estimate_cell(Estimate(*(_float(e[k]) for k in Estimate._fields)), form)

  sides, front = (', '.join(f'{a}°' for a in x) for x in (SIDES, FRONT_AND_BACK))
  rows = {
    'mean IoU': ('overall', '.3f'),
    'mean IoU of the mean training shape': ('baseline_iou', '.3f'),
    'surface PSNR RGB, dB': ('psnr_rgb', '.2f'),
    'surface PSNR YCbCr, dB': ('psnr_ycbcr', '.2f'),
    f'IoU of side views ({sides})': ('sides', '.3f'),
    f'IoU of front and back views ({front})': ('front_and_back', '.3f'),
    'difference, model by model': ('difference', '+.3f'),
    'rank correlation of colour complexity and IoU: views': ('correlation', '+.2f'),
    'the same: means of models': ('correlation_of_models', '+.2f'),
  }
  by_azimuth = [(f'{azimuth}°', cell(e, '.3f')) for azimuth, e in found['by_azimuth'].items()]
  groups = [
    (_span(g['lowest'], g['highest']), g['views'], g['models'], cell(g['iou'], '.3f'))
    for g in found['by_complexity']
  ]
  c = found['colors']
  low, first, median, third, high = c['quartiles']
  views = sum(c['views_by_complexity'])
  return '\n\n'.join(
    [
      f'{len(found["test_models"])} test models ({escape(found["category"])}),'
      f' {len(found["by_azimuth"])} views each; occupied: above'
      f' {", ".join(f"{t:g}" for t in found["thresholds"])}. In brackets: 95 % intervals over'
      ' models.',
      markdown.items(found['networks']),
      markdown.numbers(
        ['', 'here'],
        [(title, cell(found[key], form)) for title, (key, form) in rows.items()],
        caption='People: shapes and colours',
      ),
      markdown.numbers(['azimuth', 'IoU'], by_azimuth, caption='People: IoU by azimuth'),
      markdown.numbers(
        ['colour complexity', 'test views', 'of models', 'IoU'],
        groups,
        caption='People: IoU by colour complexity',
      ),
      f'Complexity of all {views} views of {c["models"]} models: {low:g} to {high:g}, median'
      f' {median:g}, middle half {first:g} to {third:g}. Of {c["unique"]} colours {c["retained"]}'
      f' have at least {c["t1"]} pixels ({c["coverage"]:.1%} of the foreground); they form'
      f' {c["clusters"]} clusters, counted from {c["t2"] + 1} pixels on.',
    ]
  )


def _mean(values):
  return intervals.mean(values, chosen=~np.isnan(values))


def _float(x: float | None) -> float:
  return math.nan if x is None else float(x)


def _span(lowest: int, highest: int) -> str:
  return f'{lowest}' + (f' to {highest}' if highest > lowest else '')
