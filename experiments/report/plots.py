"""The report's charts."""

import math
from collections.abc import Mapping, Sequence

import matplotlib
import matplotlib.figure
import numpy as np

from experiments.lib import protocol
from experiments.lib.charts import GRID, INK, STYLE, to_picture
from experiments.lib.evaluation import ALPHAS
from experiments.lib.page import Picture
from experiments.lib.results import Comparison, Line, Table, mean_over_models
from experiments.report.read import Training

_COLORS = {
  'r2n2': '#8b8b8b',
  'cross_entropy': '#e0893a',
  'msfcel': '#2f6fb5',
  'regression': '#e0893a',
  'flow': '#55a06c',
  'unified': '#9a6fb5',
  **dict(
    zip(
      (f'blended_{a:g}' for a in ALPHAS),
      ('#2f6fb5', '#5b8fc9', '#82abd8', '#a6c4e4', '#c6d9ee'),
      strict=True,
    )
  ),
}
TITLES = {'iou': 'IoU'}  # of metrics
LONG = 40  # characters: longer names stand in a single column
_BY_TITLE = {protocol.METHODS[m].title: c for m, c in _COLORS.items()}
_SERIES = ('#2f6fb5', '#e0893a', '#55a06c', '#9a6fb5', '#c2504a', '#7a7a7a', '#b59a2f')
_OTHERS = ('#3d9a9a', '#b5567a', '#7a7a3a')


def bars(panels: Mapping[str, Sequence[Line]], name: str, unit: str, caption: str) -> Picture:
  """Bars for each method by category, whiskers of one standard error, diamonds for the paper's.

  Args:
    panels: methods by the title of the panel.
    name: of the picture.
    unit: of the bars.
    caption: below the picture.
  """
  wide = max(len(line.categories) for lines in panels.values() for line in lines) > 1
  rows, columns = (len(panels), 1) if wide else (1, len(panels))
  with matplotlib.rc_context(STYLE):
    figure = matplotlib.figure.Figure(figsize=(9, 2.4 * rows + 0.7), layout='constrained')
    all_axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes, (title, lines) in zip(all_axes, panels.items(), strict=True):
      _draw_bars(axes, lines)
      axes.set_title(title, loc='left')
      axes.set_ylabel(unit)
    handles, labels = all_axes[0].get_legend_handles_labels()
    columns = min(5, len(labels))
    figure.legend(handles, labels, loc='outside lower left', ncols=columns, fontsize=8.5)
    return to_picture(figure, name, caption)


def _draw_bars(axes, rows: Sequence[Line]) -> None:
  names = list(dict.fromkeys(c for row in rows for c in row.categories))
  width = 0.84 / len(rows)
  spare = iter(_OTHERS * len(rows))
  for n, row in enumerate(rows):
    at = np.arange(len(names)) + (n - (len(rows) - 1) / 2) * width
    found = [row.categories.get(c) for c in names]
    mean, error, published = (
      np.array([math.nan if x is None else getattr(x, k) for x in found])
      for k in ('mean', 'error', 'published')
    )
    if row.title.startswith('Mean training'):
      style = {'facecolor': 'none', 'edgecolor': INK, 'hatch': '////', 'linewidth': 0.6}
    else:
      style = {'color': _BY_TITLE.get(row.title) or next(spare)}
    axes.bar(at, mean, 0.92 * width, label=row.title, **style)
    axes.errorbar(at, mean, error, fmt='none', ecolor=INK, elinewidth=0.8, capsize=1.5)
    label = 'paper' if n == len(rows) - 1 else None
    diamond = {'color': INK, 'markersize': 3.6, 'markerfacecolor': 'white', 'markeredgewidth': 0.8}
    axes.plot(at, published, 'D', label=label, linestyle='none', **diamond)
  axes.set_xticks(range(len(names)), names)
  axes.tick_params('x', length=0)
  axes.grid(axis='y', **GRID)
  axes.set_xlim(-0.5, len(names) - 0.5)


def differences(
  panels: Mapping[str, Mapping[str, Sequence[Comparison]]], name: str, caption: str
) -> Picture:
  """How far a method is above others: a panel for each measure, a line for each other method.

  Args:
    panels: comparisons by series, by the title of the panel.
    name: of the picture.
    caption: below it.
  """
  series = list(dict.fromkeys(s for by_series in panels.values() for s in by_series))
  places = {title: _places(by_series) for title, by_series in panels.items()}
  height = 0.19 * max(sum(max(len(p), 2) for p in found.values()) for found in places.values())
  columns = 1 if max(map(len, series)) > LONG else 3
  legend = 0.2 * -(-len(series) // columns) * (len(series) > 1)
  with matplotlib.rc_context(STYLE):
    size = (9, 1 + height + legend)
    figure = matplotlib.figure.Figure(figsize=size, layout='constrained')
    all_axes = figure.subplots(1, len(panels), squeeze=False)[0]
    for axes, (title, by_series) in zip(all_axes, panels.items(), strict=True):
      others = [*places[title]]
      for label, found in by_series.items():
        n = series.index(label)
        at = [others.index(c.other) + places[title][c.other][label] for c in found]
        value, error = np.array([(c.difference, c.error) for c in found]).T
        style = {'color': _SERIES[n % len(_SERIES)], 'markersize': 4.5, 'elinewidth': 1.4}
        axes.errorbar(value, at, xerr=error, fmt='o', label=label, **style)
        for y, c in zip(at, found, strict=True):
          axes.plot(c.seeds, [y] * len(c.seeds), '|', color=style['color'], markersize=7, alpha=0.7)
      axes.axvline(0, color=INK, linewidth=0.8)
      axes.set_yticks(range(len(others)), others)
      axes.set_ylim(len(others) - 0.5, -0.5)
      axes.set_title(title.replace(': ', ':\n', 1), loc='left')
      axes.tick_params('y', length=0)
      axes.spines['left'].set_visible(False)
      axes.grid(axis='x', **GRID)
    if len(series) > 1:
      found = [a.get_legend_handles_labels() for a in all_axes]
      handles = {label: h for hs, labels in found for h, label in zip(hs, labels, strict=True)}
      ordered = [handles[s] for s in series]
      figure.legend(ordered, series, loc='outside lower left', ncols=columns)
    return to_picture(figure, name, caption)


def _places(by_series):
  """The offset of each series from the line of its method."""
  found: dict[str, list[str]] = {}
  for label, comparisons in by_series.items():
    for c in comparisons:
      found.setdefault(c.other, []).append(label)
  return {
    other: {s: (n - (len(own) - 1) / 2) * 0.8 / max(len(own), 3) for n, s in enumerate(own)}
    for other, own in found.items()
  }


def ablation(parts: Mapping[str, Table], name: str, caption: str) -> Picture:
  """The means after each step on val and test, one panel for each metric."""
  metrics = {'iou': 'IoU', 'psnr_rgb': 'surface PSNR RGB, dB'}
  with matplotlib.rc_context(STYLE):
    figure = matplotlib.figure.Figure(figsize=(9, 2.5), layout='constrained')
    all_axes = figure.subplots(1, len(metrics), sharey=True)
    for axes, (metric, title) in zip(all_axes, metrics.items(), strict=True):
      for split, color in (('val', '#e0893a'), ('test', '#2f6fb5')):
        rows = parts[f'{split} {metric}'].lines
        values = [mean_over_models(row) for row in rows]
        axes.plot(values, range(len(rows)), 'o-', color=color, markersize=4, lw=1.2, label=split)
      axes.set_xlabel(title)
      axes.grid(**GRID)
    all_axes[0].set_yticks(range(len(rows)), [row.title for row in rows])
    all_axes[0].invert_yaxis()
    all_axes[0].legend(loc='best')
    return to_picture(figure, name, caption)


def training_curves(
  trainings: Sequence[Training], name: str, caption: str, *, metrics: Sequence[str] = ('loss',)
) -> Picture:
  """Metrics in training (lines) and on val (dots), a colour for each network.

  Args:
    trainings: all trainings of a kind share panels.
    name: of the picture.
    caption: below it.
    metrics: with a panel for each kind of training that has it.
  """
  kinds = list(dict.fromkeys(t.training for t in trainings))
  kinds.sort(key=[*protocol.TRAININGS, *kinds].index)
  curves = {
    (kind, metric): [_curves(t, metric) for t in trainings if t.training == kind]
    for kind in kinds
    for metric in metrics
  }
  curves = {panel: found for panel, found in curves.items() if any(a or b for _, a, b in found)}
  columns = min(3, len(curves))
  rows = -(-len(curves) // columns)
  labels = list(dict.fromkeys(_label(t) for t in trainings))
  with matplotlib.rc_context(STYLE):
    figure = matplotlib.figure.Figure(figsize=(9, 2.1 * rows + 0.3), layout='constrained')
    all_axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes in all_axes[len(curves) :]:
      axes.set_axis_off()
    for axes, ((kind, metric), found) in zip(all_axes, curves.items(), strict=False):
      for label, logged, held_out in found:
        color = f'C{labels.index(label) % 10}'
        if logged:
          axes.plot(*zip(*logged, strict=True), color=color, linewidth=1, label=label)
        if held_out:
          axes.plot(*zip(*held_out, strict=True), 'o', color=color, markersize=3.5)
      axes.set_title(f'{kind.replace("_", " ")}: {TITLES.get(metric, metric)}', loc='left')
      axes.set_ylim(bottom=0)
      axes.grid(**GRID)
    for axes in all_axes[max(0, len(curves) - columns) : len(curves)]:
      axes.set_xlabel('thousand views seen')
    if len(labels) > 1:
      all_axes[0].legend(fontsize=8)
    return to_picture(figure, name, caption)


def _curves(t: Training, metric: str):
  """(label, points in training, points on val), in thousand views."""
  points = [
    [(n / 1000, v[metric]) for n, v in lines if metric in v] for lines in (t.logged, t.validation)
  ]
  return _label(t), *points


def _label(t: Training) -> str:
  return f'{t.scope}, seed {t.seed}'
