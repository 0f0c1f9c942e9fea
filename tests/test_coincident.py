"""Of faces in the same place one is kept, and which."""

import numpy as np

from datagen.coincident import seen_faces

# The cube's side x = 1 and, from corner to corner through its middle, a sheet.
VERTICES = np.array(
  [[1, 0, 0], [1, 1, 0], [1, 1, 1], [1, 0, 1], [0, 0, 0], [0, 0, 1], [0, 1, 0]], float
)
OUT, IN = [0, 1, 2], [2, 1, 0]  # seen from x > 1 counter-clockwise, and clockwise
SHEET, SHEET_BACK = [4, 1, 2], [2, 1, 4]


def kept(faces, textured=None, vertices=VERTICES):
  faces = np.array(faces)
  textured = np.zeros(len(faces), bool) if textured is None else np.array(textured)
  return np.flatnonzero(seen_faces(vertices, faces, textured)).tolist()


def test_faces_in_places_of_their_own_stay():
  assert kept([OUT, [0, 2, 3], SHEET]) == [0, 1, 2]
  assert seen_faces(VERTICES, np.zeros((0, 3), int), np.zeros(0, bool)).shape == (0,)


def test_the_first_of_the_same_stays():
  assert kept([OUT, [0, 2, 3], OUT, [1, 2, 0]]) == [0, 1]


def test_outside_before_inside_whatever_the_order_and_the_texture():
  assert kept([IN, OUT, SHEET]) == [1, 2]
  assert kept([OUT, IN, SHEET]) == [0, 2]
  assert kept([IN, OUT, SHEET], [True, False, False]) == [1, 2]


def test_texture_before_none():
  assert kept([OUT, OUT], [False, True]) == [1]


def test_a_sheet_through_the_middle_has_no_outside():
  """Rounding must not choose: one side wins all along the sheet."""
  everything = [[4, 5, 3], [4, 6, 1]]  # they span the cube, so that its middle is the mesh's
  assert kept([SHEET_BACK, SHEET, *everything]) == [0, 2, 3]
  assert kept([SHEET, SHEET_BACK, *everything]) == [0, 2, 3]
  assert kept([SHEET, SHEET_BACK, *everything], [False, True, False, False]) == [1, 2, 3]
  moved = VERTICES * 0.3 + 100.1
  assert kept([SHEET_BACK, SHEET, *everything], vertices=moved) == [0, 2, 3]


def test_same_positions_under_other_indices():
  vertices = np.concatenate([VERTICES, VERTICES])
  vertices[7:] *= np.where(vertices[7:] == 0, -1, 1)  # -0.0 is 0.0
  assert kept([OUT, [7, 8, 9]], vertices=vertices) == [0]


def test_no_two_of_many_faces_are_taken_for_one():
  rng = np.random.default_rng(0)
  vertices = rng.integers(0, 64, (4000, 3)) / 64
  faces = np.unique(np.sort(rng.integers(0, 4000, (100_000, 3)), 1), axis=0)
  positions = np.unique(vertices, axis=0, return_inverse=True)[1][faces]
  places = np.unique(np.sort(positions, 1), axis=0)
  assert seen_faces(vertices, faces, np.zeros(len(faces), bool)).sum() == len(places)


def test_not_a_number_is_left_to_others():
  vertices = VERTICES.copy()
  vertices[0] = np.nan
  assert kept([OUT, OUT, [0, 2, 3]], vertices=vertices) == [0, 2]
