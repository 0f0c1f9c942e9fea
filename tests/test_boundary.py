"""The faces between occupied and empty voxels."""

import numpy as np

from cvn.boundary import find_faces


def test_one_voxel_has_six_faces_that_look_outwards():
  occupancy = np.zeros((3, 4, 5), bool)
  occupancy[1, 2, 4] = True
  faces = find_faces(occupancy)
  assert sorted(zip(faces.axis, faces.sign, strict=True)) == [
    (a, s) for a in range(3) for s in (-1, 1)
  ]
  assert (faces.voxel == [1, 2, 4]).all()
  for corners, axis, sign in zip(faces.corners, faces.axis, faces.sign, strict=True):
    assert (corners[:, axis] == [1, 2, 4][axis] + (sign > 0)).all()
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[1])
    np.testing.assert_array_equal(normal, sign * np.eye(3)[axis])
    assert len(np.unique(corners, axis=0)) == 4


def test_faces_are_where_occupancy_changes():
  occupancy = np.random.default_rng(0).random((6, 7, 8)) < 0.4
  faces = find_faces(occupancy)
  padded = np.pad(occupancy, 1)
  for axis in range(3):
    for sign in (-1, 1):
      mine = (faces.axis == axis) & (faces.sign == sign)
      step = np.diff(padded.astype(int), axis=axis)
      assert mine.sum() == (step == -sign).sum()
      neighbour = faces.voxel[mine] + 1 + sign * np.eye(3, dtype=int)[axis]
      assert occupancy[tuple(faces.voxel[mine].T)].all()
      assert not padded[tuple(neighbour.T)].any()


def test_nothing_occupied_has_no_face():
  faces = find_faces(np.zeros((2, 2, 2), bool))
  assert len(faces.voxel) == 0 and faces.corners.shape == (0, 4, 3)
