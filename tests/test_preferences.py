"""Shares, their intervals, the table and the chart."""

import math

import markdown_cells
import numpy as np
import pytest

from experiments.study import preferences
from experiments.study.preferences import Choice

TITLES = {'a': 'A', 'b': 'B', 'c': 'C'}


def _choices(category, other, ours, rest):
  return [Choice(category, other, True)] * ours + [Choice(category, other, False)] * rest


@pytest.mark.parametrize('ours, count', [(0, 7), (3, 10), (8, 10), (20, 20)])
def test_interval_is_wilsons(ours, count):
  z, p = 1.959963985, ours / count
  middle = (p + z**2 / (2 * count)) / (1 + z**2 / count)
  half = z / (1 + z**2 / count) * math.sqrt(p * (1 - p) / count + z**2 / (4 * count**2))
  found = preferences.share(ours, count)
  assert found[:3] == (ours, count, p)
  np.testing.assert_allclose([found.low, found.high], [middle - half, middle + half], atol=1e-6)


def test_shares_are_counted_by_other_and_category():
  choices = _choices('car', 'b', 3, 1) + _choices('chair', 'b', 1, 1) + _choices('car', 'c', 0, 2)
  table = preferences.tabulate(choices, ['b', 'c'], ['car', 'chair'])
  assert {o: {c: s[:2] for c, s in row.items()} for o, row in table.items()} == {
    'b': {'car': (3, 4), 'chair': (1, 2), 'all': (4, 6)},
    'c': {'car': (0, 2), 'all': (0, 2)},
  }
  (cells,) = markdown_cells.read(preferences.to_markdown(table, TITLES, 'a'))
  assert [row[:3] for row in cells[1:]] == [
    ['B', 'car', '75.0 %'],
    ['B', 'chair', '50.0 %'],
    ['B', 'all', '66.7 %'],
    ['C', 'car', '0.0 %'],
    ['C', 'all', '0.0 %'],
  ]


def test_bars_of_ours_and_of_the_other_make_up_all():
  choices = _choices('car', 'b', 3, 1) + _choices('chair', 'b', 1, 1) + _choices('car', 'c', 0, 2)
  table = preferences.tabulate(choices, ['b', 'c'], ['car', 'chair'])
  figure = preferences.draw(table, TITLES, 'a', note='a note')
  (axes,) = figure.axes
  bars = [[b.get_height() for b in axes.containers[n]] for n in (0, 1)]
  np.testing.assert_allclose(bars, [[75, 50, 400 / 6], [25, 50, 200 / 6]])
  assert [t.get_text() for t in axes.get_xticklabels()] == ['car', 'chair', 'all']
  (legend,) = figure.legends
  assert [t.get_text() for t in legend.get_texts()] == ['A', 'B', 'C']
  assert figure.get_supxlabel() == 'a note'


def test_whiskers_are_the_interval():
  table = preferences.tabulate(_choices('car', 'b', 8, 2), ['b'], ['car'])
  (axes,) = preferences.draw(table, TITLES, 'a', note='').axes
  (errorbar,) = (c for c in axes.containers if hasattr(c, 'has_yerr'))
  (lines,) = errorbar.lines[2]
  low, high = lines.get_segments()[0][:, 1]
  np.testing.assert_allclose([low, high], [49.02, 94.33], atol=0.01)


def test_what_has_no_choice_has_no_bar():
  table = preferences.tabulate(_choices('car', 'b', 1, 0), ['b', 'c'], ['car'])
  assert table['c'] == {}
  preferences.draw(table, TITLES, 'a', note='').canvas.draw()
