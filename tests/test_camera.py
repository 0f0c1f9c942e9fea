"""The camera's closed forms."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cvn import camera

CORNERS = np.array(list(itertools.product([-0.5, 0.5], repeat=3)))


def test_twelve_azimuths_in_steps_of_thirty():
  assert camera.AZIMUTHS == (0, 30, 60, 90, 120, 150, 180, 210, 240, 270, 300, 330)


@pytest.mark.parametrize('azimuth', camera.AZIMUTHS)
def test_rotation_is_proper(azimuth):
  R = camera.camera_at(azimuth).R
  np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-15)
  np.testing.assert_allclose(np.linalg.det(R), 1)


@pytest.mark.parametrize('azimuth', camera.AZIMUTHS)
def test_the_whole_cube_is_in_the_frame(azimuth):
  pixel, depth = camera.project(CORNERS, camera.camera_at(azimuth))
  assert pixel.min() > 0 and pixel.max() < camera.IMAGE_SIZE
  assert depth.min() > 0


def test_the_frame_is_used_well():
  """Some corner at some azimuth comes within 2 % of the frame's border."""
  pixels = [camera.project(CORNERS, camera.camera_at(a))[0] for a in range(0, 360, 5)]
  assert np.abs(np.array(pixels) - 64).max() > 0.96 * 64


@pytest.mark.parametrize('azimuth', camera.AZIMUTHS)
def test_the_origin_is_in_the_middle(azimuth):
  pixel, depth = camera.project(np.zeros(3), camera.camera_at(azimuth))
  np.testing.assert_allclose(pixel, [64, 64])
  np.testing.assert_allclose(depth, camera.DISTANCE)


@pytest.mark.parametrize('azimuth', camera.AZIMUTHS)
def test_the_camera_stands_where_the_module_says(azimuth):
  _, R, T = camera.camera_at(azimuth)
  a = np.deg2rad(azimuth)
  expected = camera.DISTANCE * np.array([np.sin(a), 0, np.cos(a)])
  np.testing.assert_allclose(-R.T @ T, expected, atol=1e-15)


def test_azimuth_0_sees_the_front_with_x_right_and_y_up():
  view = camera.camera_at(0)
  (right, up), depth = camera.project(np.array([[0.3, 0, 0], [0, 0.3, 0]]), view)
  assert right[0] > 64 and right[1] == 64
  assert up[0] == 64 and up[1] < 64  # image rows run down
  np.testing.assert_allclose(depth, camera.DISTANCE)
  _, front_and_back = camera.project(np.array([[0, 0, 0.5], [0, 0, -0.5]]), view)
  np.testing.assert_allclose(front_and_back, camera.DISTANCE + np.array([-0.5, 0.5]))


def test_azimuth_90_sees_the_side_that_faces_x():
  pixel, depth = camera.project(np.array([[0.5, 0, 0], [0, 0, 0.5]]), camera.camera_at(90))
  np.testing.assert_allclose(depth, [camera.DISTANCE - 0.5, camera.DISTANCE])
  assert pixel[1, 0] < 64  # the object's front is on the left


def test_projection_by_hand():
  """At depth 2 the frame is 2 * 2 * HALF_WIDTH = 1.6 wide: 128 pixels, 80 a unit."""
  pixel, _ = camera.project(np.array([0.1, -0.2, 0.0]), camera.camera_at(0))
  np.testing.assert_allclose(pixel, [64 + 8, 64 + 16])


@pytest.mark.parametrize('azimuth', camera.AZIMUTHS)
def test_turning_the_object_is_turning_the_camera_the_other_way(azimuth):
  points = np.random.default_rng(0).uniform(-0.5, 0.5, (50, 3))
  a = np.deg2rad(azimuth)
  turn = np.array([[np.cos(a), 0, -np.sin(a)], [0, 1, 0], [np.sin(a), 0, np.cos(a)]])
  pixel, depth = camera.project(points, camera.camera_at(azimuth))
  turned_pixel, turned_depth = camera.project(points @ turn.T, camera.camera_at(0))
  np.testing.assert_allclose(turned_pixel, pixel, atol=1e-10)
  np.testing.assert_allclose(turned_depth, depth, atol=1e-12)


@pytest.mark.parametrize('azimuth', [0, 30, 270])
def test_mirrored_object_mirrors_the_view_at_the_mirrored_azimuth(azimuth):
  points = np.random.default_rng(1).uniform(-0.5, 0.5, (50, 3))
  pixel, depth = camera.project(points, camera.camera_at(azimuth))
  mirrored, mirrored_depth = camera.project(points * [-1, 1, 1], camera.camera_at(-azimuth))
  np.testing.assert_allclose(mirrored[:, 0], 128 - pixel[:, 0])
  np.testing.assert_allclose(mirrored[:, 1], pixel[:, 1])
  np.testing.assert_allclose(mirrored_depth, depth)


def test_flow_does_not_depend_on_the_image_size():
  points = np.random.default_rng(2).uniform(-0.5, 0.5, (50, 3))
  small, _ = camera.project(points, camera.camera_at(60, image_size=32))
  large, _ = camera.project(points, camera.camera_at(60))
  np.testing.assert_allclose(small / 32, large / 128)


def test_jax_and_numpy_agree_under_jit():
  points = np.random.default_rng(3).uniform(-0.5, 0.5, (20, 3))
  view = camera.camera_at(210)
  on_jax = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), view)
  project_all = jax.jit(jax.vmap(camera.project, (0, None)))
  pixel, depth = project_all(jnp.asarray(points, jnp.float32), on_jax)
  expected_pixel, expected_depth = camera.project(points, view)
  np.testing.assert_allclose(pixel, expected_pixel, atol=1e-3)
  np.testing.assert_allclose(depth, expected_depth, atol=1e-5)
