"""Shares of choices for ours against others: intervals, a table, and the paper's bar chart.

Intervals are Wilson's for 95 %. They take choices as independent of each other: several choices of
one subject or on one shape are not quite that, and the true intervals are then wider.
"""

import json
import os
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import matplotlib.figure
import numpy as np
from matplotlib.patches import Patch
from scipy import stats

from cvn.files import atomic_write
from experiments.lib.stages import argv

ALL = 'all'  # in the place of a category; as many shapes each, and it is the paper's average
OURS_COLOR = '#3b75af'
OTHER_COLORS = ('#e8923a', '#a3a3a3', '#6aa66a', '#a986b5', '#b39b6e')  # the paper's, then more


class Choice(NamedTuple):
  """One decision between ours and another."""

  category: str
  other: str
  ours: bool  # whether ours was taken


class Share(NamedTuple):
  """How often ours was taken."""

  ours: int
  choices: int
  share: float  # in [0, 1]
  low: float  # of the interval
  high: float


Table = dict[str, dict[str, Share]]  # by other, then by category with `ALL` last


def share(ours: int, choices: int) -> Share:
  """The share `ours` / `choices` and its interval; some choice is needed."""
  interval = stats.binomtest(ours, choices).proportion_ci(method='wilson')
  return Share(ours, choices, ours / choices, float(interval.low), float(interval.high))


def tabulate(choices: Iterable[Choice], others: Sequence[str], names: Sequence[str]) -> Table:
  """Shares by other and category; pairs of them without a choice are left out."""
  choices = list(choices)

  def row(other):
    found = {}
    for name in (*names, ALL):
      taken = [c.ours for c in choices if c.other == other and name in (ALL, c.category)]
      if taken:
        found[name] = share(sum(taken), len(taken))
    return found

  return {other: row(other) for other in others}


def to_json(table: Table) -> dict[str, Any]:
  return {o: {c: s._asdict() for c, s in row.items()} for o, row in table.items()}


def format_table(table: Table, titles: Mapping[str, str], heading: str) -> str:
  """The table as text.

  Args:
    table: of `tabulate`.
    titles: of the methods.
    heading: what the shares are.
  """
  lines = [heading, f'{"against":<28}{"":<10}{"share":>9}{"95 % interval":>18}']
  for other, row in table.items():
    for name, s in row.items():
      interval = f'{100 * s.low:.0f} to {100 * s.high:.0f} %'
      count = f'{s.ours} of {s.choices}'
      lines.append(f'{titles[other]:<28}{name:<10}{100 * s.share:>7.1f} %{interval:>18}{count:>14}')
  return '\n'.join(lines)


def draw(
  panels: Mapping[str, Table],
  titles: Mapping[str, str],
  ours: str,
  *,
  note: str,
  axis: str = 'preferred, %',
) -> matplotlib.figure.Figure:
  """The paper's bar chart (Figure "user_study"): shares of ours in blue, the rest in the other's.

  Args:
    panels: tables of the same others, by what stands above each; one below the other.
    titles: of the methods.
    ours: the method that the shares are of.
    note: a line below.
    axis: what the shares are.
  """
  tables = list(panels.values())
  others = list(tables[0])
  names = list(dict.fromkeys(c for t in tables for row in t.values() for c in row if c != ALL))
  names.append(ALL)
  colors = {other: OTHER_COLORS[n % len(OTHER_COLORS)] for n, other in enumerate(others)}
  width = 0.8 / len(others)
  figure = matplotlib.figure.Figure(
    figsize=(2.2 + 1.1 * len(names), 1.2 + 3.3 * len(panels)), layout='constrained'
  )
  rows_of_axes = np.ravel(figure.subplots(len(panels), 1))
  for axes, (title, table) in zip(rows_of_axes, panels.items(), strict=True):
    for n, other in enumerate(others):
      row = table[other]
      at = np.array([names.index(c) for c in row]) + (n - (len(others) - 1) / 2) * width
      value, low, high = (
        100 * np.array([getattr(s, k) for s in row.values()]) for k in ('share', 'low', 'high')
      )
      bar = {'width': 0.9 * width, 'edgecolor': colors[other], 'linewidth': 1.5}
      axes.bar(at, value, color=OURS_COLOR, **bar)
      axes.bar(at, 100 - value, bottom=value, color=colors[other], **bar)
      whiskers = np.maximum(0, [value - low, high - value])  # rounding puts 0 % a hair off
      axes.errorbar(at, value, whiskers, fmt='none', ecolor='#222', capsize=3, linewidth=1.2)
      for x, v in zip(at, value, strict=True):
        axes.text(x, 102, f'{v:.0f}', ha='center', va='bottom', fontsize=9)
    axes.axhline(50, color='#222', linestyle=':', linewidth=1)
    axes.set_xticks(range(len(names)), names)
    axes.set(ylim=(0, 109), yticks=range(0, 101, 20), title=title, ylabel=axis)
    axes.spines[['top', 'right']].set_visible(False)
  handles = [
    Patch(color=color, label=titles[m]) for m, color in {ours: OURS_COLOR, **colors}.items()
  ]
  figure.legend(handles=handles, loc='outside upper center', ncols=len(handles), frameon=False)
  figure.supxlabel(note, fontsize=9, color='#555')
  return figure


def write(
  output: str, name: str, report: Mapping[str, Any], chart: matplotlib.figure.Figure
) -> None:
  """Writes NAME.json, with the command, and NAME.png to a folder, and says where they are."""
  path = os.path.join(output, name)
  with atomic_write(f'{path}.json') as temporary, open(temporary, 'w') as out:
    out.write(json.dumps({'argv': argv(), **report}, indent=1) + '\n')
  with atomic_write(f'{path}.png') as temporary:
    chart.savefig(temporary, dpi=150, metadata={'Software': None})
  print(f'{path}.png, {path}.json')
