"""Drawing: where things land, which colour they get, how pictures are laid out."""

import numpy as np
import pytest

from cvn import camera, figures, grid
from cvn.infer import Reconstruction

SIZE = 16  # voxels


def _one_voxel(index, color=(1.0, 0.0, 0.0), size=SIZE):
  occupancy = np.zeros((size,) * 3, bool)
  occupancy[index] = True
  return grid.ColoredVoxels(occupancy, np.broadcast_to(color, (size,) * 3 + (3,)))


def _is_red(image):
  return (image[..., 0].astype(int) - image[..., 1]) > 100


def test_flow_code_has_its_corners_and_centre():
  flow = np.array([[0.0, 0], [1, 0], [0, 1], [1, 1], [0.5, 0.5]])
  expected = np.concatenate([figures.FLOW_CORNERS, figures.FLOW_CORNERS.mean(0, keepdims=True)])
  np.testing.assert_allclose(figures.flow_color_code(flow), expected)


def test_flow_code_gives_every_flow_its_own_colour():
  ticks = np.linspace(0, 1, 17)
  code = figures.flow_color_code(np.stack(np.meshgrid(ticks, ticks), -1)).reshape(-1, 3)
  distance = np.linalg.norm(code[:, None] - code[None], axis=-1)
  distance[np.diag_indices(len(code))] = np.inf
  assert distance.min() > 0.01
  assert code.min() >= 0 and code.max() <= 1


def test_weight_code_is_yellow_for_sampled_and_blue_for_regressed():
  regressed, sampled = figures.weight_color_code(np.array([0.0, 1.0]))
  assert regressed.argmax() == 2
  assert sampled.argmin() == 2 and sampled[:2].min() > 0.8


@pytest.mark.parametrize('azimuth', [0, 30, 90, 210])
@pytest.mark.parametrize('index', [(2, 13, 8), (12, 3, 5), (8, 8, 1)])
def test_level_drawing_agrees_with_the_camera(azimuth, index):
  image = figures.draw_voxels(_one_voxel(index), azimuth, elevation=0, size=128)
  row, column = np.argwhere(_is_red(image)).mean(0) + 0.5
  center = grid.index_to_world(np.array(index), size=SIZE)
  pixel, depth = camera.project(center, camera.camera_at(azimuth))
  np.testing.assert_allclose([column, row], pixel, atol=1.6)
  # A cube's picture covers between one face and its whole diagonal section.
  face = (160 / depth / SIZE) ** 2
  assert 0.9 * face < _is_red(image).sum() < 2.2 * face


def test_raised_camera_sees_the_top_and_no_side_is_mirrored():
  occupancy = np.ones((SIZE,) * 3, bool)
  color = np.zeros((SIZE,) * 3 + (3,))
  color[-1, :, :, 0] = 1  # red towards +x
  color[:, -1, :, 1] = 1  # green on top
  image = figures.draw_voxels(grid.ColoredVoxels(occupancy, color), 30, elevation=20, size=64)
  assert (image[..., 1] > 150).any()
  red = np.argwhere(_is_red(image))
  assert red[:, 1].mean() > 32  # at azimuth 30, +x is to the right
  below = figures.draw_voxels(grid.ColoredVoxels(occupancy, color), 30, elevation=-20, size=64)
  top_pixels = lambda x: ((x[..., 1] > 100) & (x.min(-1) < 100)).sum()  # noqa: E731
  assert top_pixels(below) < 0.3 * top_pixels(image)


def test_nearer_voxels_hide_those_behind():
  occupancy = np.zeros((SIZE,) * 3, bool)
  occupancy[:, :, 12] = occupancy[:, :, 3] = True
  color = np.zeros((SIZE,) * 3 + (3,))
  color[:, :, 12, 0] = 1
  color[:, :, 3, 2] = 1
  voxels = grid.ColoredVoxels(occupancy, color)
  front = figures.draw_voxels(voxels, 0, elevation=0, size=64)
  back = figures.draw_voxels(voxels, 180, elevation=0, size=64)
  assert not ((front[..., 2] > 100) & (front[..., 0] < 100)).any()
  assert not ((back[..., 0] > 100) & (back[..., 2] < 100)).any()


@pytest.mark.parametrize('azimuth', [0, 45, 75])
@pytest.mark.parametrize('elevation', [-60, 0, 20, 90])
def test_whole_cube_is_in_the_frame_without_holes(azimuth, elevation):
  full = grid.ColoredVoxels(np.ones((SIZE,) * 3, bool), np.zeros((SIZE,) * 3 + (3,)))
  image = figures.draw_voxels(full, azimuth, elevation=elevation, size=96)
  ink = image.max(-1) < 128
  assert not (ink[0].any() or ink[-1].any() or ink[:, 0].any() or ink[:, -1].any())
  for line in (*ink, *ink.T):  # convex, so every row and column is one run
    assert np.abs(np.diff(line.astype(int))).sum() in (0, 2)


def test_nothing_to_draw_is_background():
  empty = grid.ColoredVoxels(np.zeros((4,) * 3, bool), np.zeros((4, 4, 4, 3)))
  image = figures.draw_voxels(empty, 0, size=8, background=(1, 2, 3))
  np.testing.assert_array_equal(image, np.broadcast_to(np.uint8([1, 2, 3]), (8, 8, 3)))


def test_grid_places_images_and_skips_empty_places():
  red, green = (np.full((4, 6, 3), c, np.uint8) for c in ([255, 0, 0], [0, 255, 0]))
  image = figures.grid_of_images([[red, None], [green, red]], gap=2, background=(9, 9, 9))
  assert image.shape == (2 + 4 + 2 + 4 + 2, 2 + 6 + 2 + 6 + 2, 3)
  np.testing.assert_array_equal(image[2:6, 2:8], red)
  np.testing.assert_array_equal(image[8:12, 2:8], green)
  np.testing.assert_array_equal(image[8:12, 10:16], red)
  assert (image[2:6, 10:16] == 9).all()


def test_grid_makes_room_for_titles():
  tile = np.full((10, 10, 3), 255, np.uint8)
  plain = figures.grid_of_images([[tile]])
  titled = figures.grid_of_images([[tile]], column_titles=['a wide\ntitle'], row_titles=['row'])
  assert titled.shape[0] > plain.shape[0] + 20 and titled.shape[1] > plain.shape[1] + 20
  assert titled.min() < 100


def test_transparent_pixels_show_the_background():
  rgba = np.zeros((1, 3, 4), np.uint8)
  rgba[0, 1:, 0] = 255
  rgba[0, :, 3] = 0, 255, 51
  expected = [[[100, 100, 100], [255, 0, 0], [131, 80, 80]]]
  np.testing.assert_array_equal(figures.over(rgba, background=(100, 100, 100)), expected)


def test_panel_shows_each_volume_on_the_voxels():
  n = 8
  flat = lambda *c: np.broadcast_to(np.float32(c), (n, n, n, len(c)))  # noqa: E731
  volumes = Reconstruction(
    occupancy=np.ones((n,) * 3, bool),
    probability=None,
    color=flat(1, 1, 0),
    regressed=flat(1, 0, 0),
    sampled=flat(0, 1, 0),
    flow=flat(0, 0),
    weight=flat(1.0)[..., 0],
  )
  view = np.full((16, 16, 4), 255, np.uint8)
  panel = figures.reconstruction_panel(view, volumes, size=160)
  left, right = (
    {tuple(c) for c in np.unique((half > 100).reshape(-1, 3), axis=0)}
    for half in np.array_split(panel, 2, axis=1)
  )
  red, green, blue, yellow = (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0)
  assert {blue, yellow} <= left  # flow, weight
  assert {green, red, yellow} <= right  # sampled, regressed, result
  assert not {green, red} & left


def test_enlarged_pixels_stay_pixels():
  view = np.zeros((2, 2, 4), np.uint8)
  view[0, 1] = 255, 0, 0, 255
  image = figures.enlarge(view, 6)
  assert image.shape == (6, 6, 3)
  np.testing.assert_array_equal(image[:3, 3:], np.broadcast_to([255, 0, 0], (3, 3, 3)))
  assert (image[3:] == 255).all() and (image[:, :3] == 255).all()


def test_stacked_images_are_filled_with_white():
  red, green = (np.full((2, w, 3), c, np.uint8) for w, c in ((3, [255, 0, 0]), (5, [0, 255, 0])))
  image = figures.stack([red, green])
  assert image.shape == (4, 5, 3)
  np.testing.assert_array_equal(image[:2, :3], red)
  np.testing.assert_array_equal(image[2:], green)
  assert (image[:2, 3:] == 255).all()


def test_trimming_keeps_rows_and_columns_aligned():
  def dot(row, column):
    image = np.full((20, 30, 3), 255, np.uint8)
    image[row, column] = 0
    return image

  rows = figures.trim([[dot(8, 10), dot(11, 20)], [dot(5, 12), dot(5, 20)]], margin=2)
  assert [[x.shape for x in row] for row in rows] == [
    [(8, 7, 3), (8, 5, 3)],
    [(5, 7, 3), (5, 5, 3)],
  ]
  assert [[tuple(np.argwhere(x[..., 0] == 0)[0]) for x in row] for row in rows] == [
    [(2, 2), (5, 2)],
    [(2, 4), (2, 2)],
  ]


def test_trimming_leaves_white_and_full_images():
  white, black = (np.full((4, 4, 3), v, np.uint8) for v in (255, 0))
  for image in (white, black):
    np.testing.assert_array_equal(figures.trim([[image]])[0][0], image)
