"""The grid's closed forms."""

import jax.numpy as jnp
import numpy as np
import pytest

from cvn import grid


def test_first_and_last_centres_lie_half_a_voxel_inside_the_cube():
  first, last = grid.index_to_world(np.array([[0, 0, 0], [63, 63, 63]]))
  np.testing.assert_allclose(first, -0.5 + 0.5 / 64, rtol=1e-15)
  np.testing.assert_allclose(last, 0.5 - 0.5 / 64, rtol=1e-15)


def test_axes_keep_their_order():
  np.testing.assert_allclose(
    grid.index_to_world(np.array([0, 1, 3]), size=4), [-0.375, -0.125, 0.375]
  )


@pytest.mark.parametrize('size', [4, 64])
def test_world_to_grid_puts_a_centre_in_the_middle_of_its_voxel(size):
  index = np.stack(np.meshgrid(*[np.arange(size)] * 3, indexing='ij'), -1)
  points = grid.index_to_world(index, size=size)
  np.testing.assert_allclose(grid.world_to_grid(points, size=size), index + 0.5, atol=1e-12)


def test_the_cube_spans_the_grid():
  np.testing.assert_array_equal(grid.world_to_grid(np.array([-0.5, 0.0, 0.5])), [0, 32, 64])


def test_a_normalised_object_leaves_a_voxel_free_at_either_end():
  half = np.array([-grid.OBJECT_EXTENT, grid.OBJECT_EXTENT]) / 2
  np.testing.assert_array_equal(grid.world_to_grid(half), [1, 63])


def test_padding_is_no_index_of_the_grid_and_fits_a_byte():
  assert grid.GRID_SIZE <= grid.PADDING_INDEX <= np.iinfo(np.uint8).max


def test_scatter_drops_padding():
  volume = jnp.zeros((64, 64, 64)).at[jnp.full(3, grid.PADDING_INDEX)].set(1, mode='drop')
  assert volume.sum() == 0


def test_jax_and_numpy_agree():
  index = np.array([[0, 5, 63], [1, 2, 3]])
  world = grid.index_to_world(jnp.asarray(index))
  np.testing.assert_allclose(world, grid.index_to_world(index), atol=1e-7)
  np.testing.assert_allclose(grid.world_to_grid(world), index + 0.5, atol=1e-5)


def test_voxels_of_a_padded_list():
  index = np.array([[1, 2, 3], [4, 5, 6], [grid.PADDING_INDEX] * 3])
  color = np.array([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6], [0, 0, 0]])
  voxels = grid.to_voxels(index, color)
  np.testing.assert_array_equal(np.argwhere(voxels.occupancy), index[:2])
  np.testing.assert_allclose(voxels.color[4, 5, 6], color[1], rtol=1e-6)
  assert voxels.color.sum() == pytest.approx(color.sum())
