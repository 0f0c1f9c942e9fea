"""IoU by azimuth and complexity: tables made by hand."""

import itertools

import numpy as np
import pytest

from cvn.errors import UserError
from cvn.evaluation.complexity import Palette
from experiments.paper.people import analysis as people_analysis

AZIMUTHS = (0, 90, 180, 270)


def test_means_by_azimuth_and_the_sides_against_front_and_back():
  models = np.array([[0.1], [0.2], [0.3]])
  iou = models + [0.0, 0.04, 0.02, 0.06]
  found = people_analysis.analyze(AZIMUTHS, iou, np.arange(12).reshape(3, 4))
  assert found.overall.value == pytest.approx(0.23)
  assert [e.value for e in found.by_azimuth.values()] == pytest.approx([0.2, 0.24, 0.22, 0.26])
  assert found.by_azimuth[90].low < 0.24 < found.by_azimuth[90].high
  assert (found.sides.value, found.front_and_back.value) == pytest.approx((0.25, 0.21))
  # Models differ, but not in this: the comparison is paired.
  assert found.difference == pytest.approx((0.04, 0.04, 0.04))


def test_views_are_grouped_by_complexity():
  complexities = np.array([[1, 1, 2, 3], [4, 5, 6, 6]])
  iou = np.array([[0.0, 0.2, 0.3, 0.4], [0.5, 0.6, 0.7, 0.9]])
  groups = people_analysis.group_by_complexity(complexities, iou)
  # Sixths of eight views, the first two of which cannot be told apart.
  assert [(g.lowest, g.highest, g.views, g.models) for g in groups] == [
    (1, 1, 2, 1),
    (2, 2, 1, 1),
    (3, 3, 1, 1),
    (4, 5, 2, 1),
    (6, 6, 2, 1),
  ]
  assert [g.iou.value for g in groups] == pytest.approx([0.1, 0.3, 0.4, 0.55, 0.8])


def test_every_view_is_in_one_group():
  rng = np.random.default_rng(0)
  for _ in range(20):
    complexities = rng.integers(0, rng.integers(2, 30), (rng.integers(1, 9), 12))
    groups = people_analysis.group_by_complexity(complexities, complexities / 30)
    assert sum(g.views for g in groups) == complexities.size
    assert all(a.highest < b.lowest for a, b in itertools.pairwise(groups))
    mean = sum(g.views * g.iou.value for g in groups) / complexities.size
    assert mean == pytest.approx(complexities.mean() / 30)


def test_views_of_one_complexity_are_one_group():
  (group,) = people_analysis.group_by_complexity(np.full((3, 4), 7), np.full((3, 4), 0.5))
  assert (group.lowest, group.highest, group.views, group.models) == (7, 7, 12, 3)


def test_complexity_of_a_set():
  red, green, rare = (255, 0, 0), (0, 255, 0), (0, 200, 0)

  def view(*counted):
    colors, counts = zip(*counted, strict=True)
    return Palette(np.array(colors, np.uint8), np.array(counts, np.int64))

  palettes = [[view((red, 60), (green, 4)), view((green, 60), (rare, 6))], [view((rare, 9))] * 2]
  found = people_analysis.measure_colors(palettes, t1=50, clusters=8, t2=5)
  assert found.complexity.tolist() == [[1, 1], [1, 1]]
  assert (found.unique, found.retained, found.clusters) == (3, 2, 2)
  assert found.coverage == pytest.approx(124 / 148)
  found = people_analysis.measure_colors(palettes, t1=1, clusters=8, t2=3)
  assert found.complexity.tolist() == [[2, 2], [1, 1]] and found.coverage == 1


def test_azimuths_that_are_compared_must_be_there():
  people_analysis.check_azimuths(AZIMUTHS)
  with pytest.raises(UserError, match='no views from 180°, 270°'):
    people_analysis.check_azimuths((0, 90, 200))
