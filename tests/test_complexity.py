"""Colour complexity: known palettes, clusters and counts."""

import numpy as np
import pytest

from cvn.errors import UserError
from cvn.evaluation import complexity
from cvn.evaluation.complexity import Palette

RED, GREEN, BLUE, WHITE = (255, 0, 0), (0, 255, 0), (0, 0, 255), (255, 255, 255)


def palette(**counts):
  """A palette of named colours."""
  known = {'red': RED, 'green': GREEN, 'blue': BLUE, 'white': WHITE}
  colors = np.array([known[k] for k in counts], np.uint8).reshape(-1, 3)
  return Palette(colors, np.array([*counts.values()], np.int64))


def test_palette_counts_the_foreground_alone():
  view = np.zeros((2, 3, 4), np.uint8)
  view[0] = (*GREEN, 255)
  view[1, 0] = (*RED, 128)  # half opaque: its own colour, not a mixture with a ground
  view[1, 1] = (*RED, 127)
  found = complexity.find_palette(view)
  assert found.color.tolist() == [[0, 255, 0], [255, 0, 0]] and found.count.tolist() == [3, 1]
  nothing = complexity.find_palette(np.zeros((2, 3, 4), np.uint8))
  assert nothing.color.shape == (0, 3) and nothing.count.shape == (0,)


def test_palettes_of_views_make_that_of_the_set():
  views = np.random.default_rng(0).integers(0, 4, (5, 8, 8, 4), np.uint8) * 85
  whole = complexity.find_palette(views)
  merged = complexity.merge([complexity.find_palette(v) for v in views])
  np.testing.assert_array_equal(merged.color, whole.color)
  np.testing.assert_array_equal(merged.count, whole.count)
  colors, counts = np.unique(views[views[..., 3] >= 128][:, :3], axis=0, return_counts=True)
  np.testing.assert_array_equal(whole.color, colors)
  np.testing.assert_array_equal(whole.count, counts)


def test_rare_colors_are_left_out():
  whole = palette(red=50, green=49, blue=51)
  assert complexity.cluster(whole, t1=50).tolist() == [[255, 0, 0], [0, 0, 255]]
  assert len(complexity.cluster(whole, t1=49)) == 3
  with pytest.raises(UserError, match='no colour has t1 = 52 pixels, the most is 51'):
    complexity.cluster(whole, t1=52)
  with pytest.raises(UserError, match='the most is 0'):
    complexity.cluster(palette(), t1=1)


def test_no_more_colors_than_clusters_are_the_centers():
  colors = np.arange(30, dtype=np.uint8).reshape(10, 3)
  whole = Palette(colors, np.full(10, 100))
  np.testing.assert_array_equal(complexity.cluster(whole, clusters=10), colors)


def test_clusters_of_well_separated_colors_are_their_means():
  # Four groups; counts do not matter.
  corners = np.array([RED, GREEN, BLUE, WHITE]) * 0.8 + 10
  offsets = np.stack(np.meshgrid([-6, 0, 6], [-6, 0, 6], [-6, 0, 6]), -1).reshape(-1, 3)
  colors = (corners[:, None] + offsets).reshape(-1, 3).astype(np.uint8)
  counts = np.random.default_rng(0).integers(50, 10**6, len(colors))
  found = complexity.cluster(Palette(colors, counts), clusters=4, seed=3)
  expected = colors.reshape(4, -1, 3).mean(1)
  order = [int(np.argmin(np.abs(found - e).sum(-1))) for e in expected]
  np.testing.assert_allclose(found[order], expected)


def test_clusters_are_the_same_for_a_seed_and_each_color_is_near_one():
  rng = np.random.default_rng(1)
  colors = np.unique(rng.integers(0, 256, (3000, 3)), axis=0).astype(np.uint8)
  whole = Palette(colors, np.full(len(colors), 50))
  first, again = (complexity.cluster(whole, seed=5) for _ in range(2))
  np.testing.assert_array_equal(first, again)
  assert first.shape == (128, 3)
  distance = np.linalg.norm(colors[:, None] - first[None], axis=-1).min(1)
  # A cube of 256^3 in 128 balls of one volume has radius 31.5; clusters come near it.
  assert distance.mean() < 31.5


def test_a_cluster_that_loses_its_colors_keeps_its_centre():
  # Begun at 50, 80 and 164, the clusters on both sides take 80's two colours from it.
  reds = [80, 120, 50, 164, *[64] * 4, *[125] * 4]
  greens = [0, 0, 0, 0, *range(4), *range(4)]
  colors = np.stack([reds, greens, np.zeros(12)], -1).astype(np.uint8)
  found = complexity.cluster(Palette(colors, np.full(12, 50)), clusters=3, seed=25)
  assert sorted(found.tolist()) == [
    pytest.approx([193 / 3, 1, 0]),
    pytest.approx([100, 0, 0]),
    pytest.approx([392 / 3, 1, 0]),
  ]


def test_complexity_counts_the_centers_with_more_than_t2_pixels():
  centers = np.array([RED, GREEN, BLUE], float)
  assert complexity.complexity(palette(red=6, green=5, blue=100), centers) == 2
  assert complexity.complexity(palette(red=6, green=5, blue=100), centers, t2=4) == 3
  assert complexity.complexity(palette(), centers) == 0
  # Two colours, 3 pixels each, of one centre: 6 pixels.
  reds = Palette(np.array([(250, 0, 0), (240, 20, 0)], np.uint8), np.array([3, 3]))
  assert complexity.complexity(reds, centers) == 1
  # Colours that were left out of the clusters belong to the nearest one all the same.
  assert complexity.complexity(palette(white=9), np.array([RED, (200, 200, 200)], float)) == 1


def test_the_papers_parameters():
  assert (complexity.T1, complexity.CLUSTERS, complexity.T2) == (50, 128, 5)
