"""Dominant colours of hand-made tallies."""

import numpy as np
import pytest

from datagen.geometry import dominant
from datagen.geometry.dominant import EMPTY, add, dominant_colors

RED, WHITE, BLUE = [0.9, 0.1, 0.1], [1.0, 1.0, 1.0], [0.1, 0.1, 0.9]


def colors(voxel, area, color):
  return dominant_colors(add(EMPTY, np.array(voxel), np.array(area, float), np.array(color, float)))


def test_the_larger_area_wins_and_leaves_no_trace_of_the_other():
  voxel, color = colors([7, 7, 3, 3, 3], [1, 2, 1, 1, 1.5], [RED, WHITE, RED, RED, BLUE])
  np.testing.assert_array_equal(voxel, [3, 7])
  np.testing.assert_allclose(color, [RED, WHITE], rtol=1e-12)


def test_one_colour_is_exact():
  rng = np.random.default_rng(0)
  palette = rng.integers(0, 256, (500, 3)) / 255
  voxel = rng.integers(0, 500, 5000)
  found, color = colors(voxel, rng.uniform(1e-6, 1, 5000), palette[voxel])
  np.testing.assert_array_equal(found, np.unique(voxel))
  np.testing.assert_allclose(color, palette[found], atol=1e-9)


@pytest.mark.parametrize('middle', np.linspace(0.07, 0.93, 12))
def test_a_grain_is_averaged_wherever_the_borders_of_the_bins_lie(middle):
  rng = np.random.default_rng(0)
  area = rng.uniform(0.5, 1, 400)
  color = middle + rng.uniform(-0.5, 0.5, (400, 3)) / dominant.LEVELS
  _, found = colors(np.zeros(400, int), area, color)
  np.testing.assert_allclose(found[0], area @ color / area.sum(), rtol=1e-9)


def test_a_gradient_does_not_jump_from_voxel_to_voxel():
  """It changes by 0.2 a voxel, more than a bin: what is cut off at its ends moves it by little."""
  at = (np.arange(4000) + 0.5) / 1000  # in voxels
  ramp = np.repeat(0.1 + 0.2 * at[:, None], 3, 1)
  _, found = colors(at.astype(int), np.ones(4000), ramp)
  np.testing.assert_allclose(found[:, 0], [0.2, 0.4, 0.6, 0.8], atol=0.03)


def test_pieces_may_come_in_any_order_and_in_any_parts(monkeypatch):
  rng = np.random.default_rng(0)
  voxel, area = rng.integers(0, 300, 20000), rng.uniform(0.1, 1, 20000)
  color = rng.uniform(0, 1, (20000, 3))
  expected = dominant_colors(add(EMPTY, voxel, area, color))
  monkeypatch.setattr(dominant, 'CHUNK', 100)
  tally = EMPTY
  for part in np.array_split(rng.permutation(20000), 9):
    tally = add(tally, voxel[part], area[part], color[part])
  found = dominant_colors(tally)
  np.testing.assert_array_equal(found[0], expected[0])
  np.testing.assert_allclose(found[1], expected[1], rtol=1e-9)


def test_brute_force_over_windows():
  rng = np.random.default_rng(1)
  area, color = rng.uniform(0.1, 1, 60), rng.uniform(0, 1, (60, 3))
  _, found = colors(np.zeros(60, int), area, color)
  most = (0, None)
  for low in np.ndindex((dominant.LEVELS - 1,) * 3):
    inside = (np.abs(np.floor(color * dominant.LEVELS) - low - 0.5) <= 0.5).all(-1)
    if area[inside].sum() > most[0]:
      most = area[inside].sum(), area[inside] @ color[inside] / area[inside].sum()
  np.testing.assert_allclose(found[0], most[1], rtol=1e-9)


def test_nothing():
  voxel, color = dominant_colors(EMPTY)
  assert voxel.shape == (0,) and color.shape == (0, 3)
