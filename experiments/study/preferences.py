"""Shares of choices for ours against others: intervals, a table, and the paper's bar chart.

The intervals are Wilson's for 95 %. They treat choices as independent. Several choices of one
subject or on one shape are not quite independent, so the true intervals are wider.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import matplotlib.figure
import numpy as np
from matplotlib.patches import Patch
from scipy import stats

from experiments.lib import markdown

ALL = 'all'  # in place of a category; the paper's average if all have the same number of shapes
OURS_COLOR = '#3b75af'
OTHER_COLORS = ('#e8923a', '#a3a3a3', '#6aa66a', '#a986b5', '#b39b6e')  # the paper's, then more


class Choice(NamedTuple):
  """One decision between ours and another."""

  category: str
  other: str
  ours: bool  # whether ours was chosen


class Share(NamedTuple):
  """How often ours was chosen."""

  ours: int
  choices: int
  share: float  # in [0, 1]
  low: float  # of the interval
  high: float


Table = dict[str, dict[str, Share]]  # by other, then by category with `ALL` last


def share(ours: int, choices: int) -> Share:
  """The share `ours` / `choices` and its interval; `choices` must not be 0."""
  interval = stats.binomtest(ours, choices).proportion_ci(method='wilson')
  return Share(ours, choices, ours / choices, float(interval.low), float(interval.high))


def tabulate(choices: Iterable[Choice], others: Sequence[str], names: Sequence[str]) -> Table:
  """Shares by other method and category; pairs of them without a choice are left out."""
  choices = list(choices)

  def row(other):
    found = {}
    for name in (*names, ALL):
      taken = [c.ours for c in choices if c.other == other and name in (ALL, c.category)]
      if taken:
        found[name] = share(sum(taken), len(taken))
    return found

  return {other: row(other) for other in others}


def to_markdown(table: Table, titles: Mapping[str, str], ours: str) -> str:
  """The table of `tabulate`, with the titles of the methods."""
  rows = [
    [
      markdown.escape(titles[other]),
      *(name, f'{100 * s.share:.1f} %', f'{100 * s.low:.0f} to {100 * s.high:.0f} %'),
      f'{s.ours} of {s.choices}',
    ]
    for other, row in table.items()
    for name, s in row.items()
  ]
  head = ['against', '', 'share', '95 % interval', 'choices']
  return markdown.numbers(head, rows, caption=f'{titles[ours]} preferred')


def draw(
  table: Table, titles: Mapping[str, str], ours: str, *, note: str
) -> matplotlib.figure.Figure:
  """The paper's bar chart (Figure "user_study"): our share in blue, the rest in the other's colour.

  Args:
    table: of `tabulate`.
    titles: of the methods.
    ours: the method of the shares.
    note: a line below the chart.
  """
  names = [*dict.fromkeys(c for row in table.values() for c in row if c != ALL), ALL]
  colors = {other: OTHER_COLORS[n % len(OTHER_COLORS)] for n, other in enumerate(table)}
  width = 0.8 / len(table)
  size = (2.2 + 1.1 * len(names), 4.5)
  figure = matplotlib.figure.Figure(figsize=size, layout='constrained')
  axes = figure.subplots()
  for n, (other, row) in enumerate(table.items()):
    at = np.array([names.index(c) for c in row]) + (n - (len(table) - 1) / 2) * width
    value, low, high = (
      100 * np.array([getattr(s, k) for s in row.values()]) for k in ('share', 'low', 'high')
    )
    bar = {'width': 0.9 * width, 'edgecolor': colors[other], 'linewidth': 1.5}
    axes.bar(at, value, color=OURS_COLOR, **bar)
    axes.bar(at, 100 - value, bottom=value, color=colors[other], **bar)
    whiskers = np.maximum(0, [value - low, high - value])  # rounding error at 0 %
    axes.errorbar(at, value, whiskers, fmt='none', ecolor='#222', capsize=3, linewidth=1.2)
    for x, v in zip(at, value, strict=True):
      axes.text(x, 102, f'{v:.0f}', ha='center', va='bottom', fontsize=9)
  axes.axhline(50, color='#222', linestyle=':', linewidth=1)
  axes.set_xticks(range(len(names)), names)
  axes.set(ylim=(0, 109), yticks=range(0, 101, 20), title='User study', ylabel='preferred, %')
  axes.spines[['top', 'right']].set_visible(False)
  handles = [
    Patch(color=color, label=titles[m]) for m, color in {ours: OURS_COLOR, **colors}.items()
  ]
  figure.legend(handles=handles, loc='outside upper center', ncols=len(handles), frameon=False)
  figure.supxlabel(note, fontsize=9, color='#555')
  return figure
