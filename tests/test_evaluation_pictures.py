import numpy as np
import pytest
from skimage.metrics import peak_signal_noise_ratio

from cvn import camera, figures, grid
from cvn.evaluation import pictures
from cvn.grid import ColoredVoxels


def make(size=32):
  """A lop-sided box of many colours with a bar behind it."""
  occupancy = np.zeros((size,) * 3, bool)
  occupancy[6:20, 4:24, 12:16] = True
  occupancy[14:30, 10:12, 4:8] = True
  color = np.random.default_rng(0).random((size,) * 3 + (3,))
  return ColoredVoxels(occupancy, color)


@pytest.mark.parametrize('azimuth', [0, 30, 100, 270])
def test_silhouettes_are_those_of_the_other_renderer(azimuth):
  voxels = make()
  drawn = pictures.draw(voxels, azimuth)
  lit = figures.draw_voxels(
    voxels._replace(color=np.zeros_like(voxels.color)), azimuth, elevation=0
  )
  ours, theirs = (drawn != pictures.GREY).any(-1), lit.mean(-1) < 128
  assert (ours & theirs).sum() / (ours | theirs).sum() > 0.95


def test_a_pixel_shows_the_first_voxel_along_its_ray():
  """Against a march along the rays, away from the borders of projected voxels."""
  voxels, azimuth = make(), 60
  drawn = pictures.draw(voxels, azimuth)
  view = camera.camera_at(azimuth)
  eye = -view.R.T @ view.T
  pixel = np.stack(np.meshgrid(*[np.arange(128) + 0.5] * 2), -1)  # (column, row)
  ray = np.concatenate([pixel, np.ones((128, 128, 1))], -1) @ np.linalg.inv(view.K).T @ view.R
  seen = np.full((128, 128, 3), pictures.GREY)
  found = np.zeros((128, 128), bool)
  for depth in np.arange(1.3, 2.7, 0.002):
    at = np.floor(grid.world_to_grid(eye + depth * ray, size=32)).astype(int)
    inside = ((at >= 0) & (at < 32)).all(-1)
    at = np.where(inside[..., None], at, 0)
    hit = inside & voxels.occupancy[tuple(np.moveaxis(at, -1, 0))] & ~found
    seen[hit] = voxels.color[tuple(at[hit].T)]
    found |= hit
  same = np.isclose(drawn, seen).all(-1)
  assert same[found].mean() > 0.7 and same.mean() > 0.9


def test_the_same_shape_scores_best_and_nothing_worst():
  true = make()
  seen = pictures.draw_all(true, azimuths=(0, 90))
  assert seen.images.shape == (2, 128, 128, 3)
  assert pictures.compare(true, seen) == (pictures.CEILING, pytest.approx(1))
  other = pictures.compare(true._replace(occupancy=np.zeros_like(true.occupancy)), seen)
  blank = np.full((128, 128, 3), pictures.GREY)
  expected = np.mean([peak_signal_noise_ratio(i, blank, data_range=1) for i in seen.images])
  assert other.psnr == pytest.approx(expected) and other.ssim < 0.99
