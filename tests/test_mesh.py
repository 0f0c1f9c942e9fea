"""The plain form of a mesh: where its colours are, what is surface, what is fit."""

import numpy as np
import pytest

from cvn.errors import UserError
from cvn.grid import OBJECT_EXTENT
from datagen.geometry.mesh import TexturedMesh, albedo, check, is_surface, normalize

QUAD = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
FACES = np.array([[0, 1, 2], [0, 2, 3]])
RED, GREEN, BLUE, WHITE = [255, 0, 0, 255], [0, 255, 0, 255], [0, 0, 255, 255], [255] * 4
FOUR = np.array([[RED, GREEN], [BLUE, WHITE]], np.uint8)  # row 0 is the image's top


def quad(image=None, *, tiles=1, vertices=QUAD, corners=None):
  """A square with the image on it so many times along a side, or with its corners' colours."""
  colors = np.ones((4, 4), np.float32) if corners is None else np.array(corners, np.float32)
  return TexturedMesh(
    vertices=np.array(vertices, float),
    faces=FACES,
    corner_colors=colors[FACES],
    corner_uv=tiles * QUAD[FACES][..., :2].astype(np.float32),
    texture=np.full(2, -1 if image is None else 0, np.int32),
    textures=() if image is None else (np.asarray(image, np.uint8),),
  )


def place(x, y):
  """The point (x, y) of the square: (face [1], barycentric weights [1, 3])."""
  face = int(x < y)
  weights = [1 - x, x - y, y] if face == 0 else [1 - y, x, y - x]
  return np.array([face]), np.array([weights], float)


def color_at(mesh, x, y):
  """Albedo in 0..255."""
  return 255 * albedo(mesh, *place(x, y))[0]


def repeated(image, times):
  return np.asarray(image).repeat(times, 0).repeat(times, 1)


def test_texture_is_the_right_way_up():
  mesh = quad(repeated(FOUR, 8))
  for (x, y), color in {(0, 1): RED, (1, 1): GREEN, (0, 0): BLUE, (1, 0): WHITE}.items():
    np.testing.assert_allclose(color_at(mesh, x / 2 + 0.25, y / 2 + 0.25), color, atol=1e-3)


def test_textures_repeat():
  mesh = quad(repeated(FOUR, 8), tiles=3)
  for k in range(3):
    np.testing.assert_allclose(color_at(mesh, (k + 0.25) / 3, (k + 0.75) / 3), RED, atol=1e-3)


def test_bilinear_at_texel_centres_between_them_and_across_the_seam():
  mesh = quad(repeated(FOUR, 2))  # 4 x 4 texels
  for at, color in {
    (0.375, 0.875): RED,
    (0.5, 0.875): [127.5, 127.5, 0, 255],
    (1.0, 0.875): [127.5, 127.5, 0, 255],  # the image begins again
    (0.0, 0.0): [127.5, 127.5, 127.5, 255],
  }.items():
    np.testing.assert_allclose(color_at(mesh, *at), color, atol=1e-3)


def test_corner_colors_are_interpolated_and_multiply_the_texture():
  corners = [[0, 0, 0, 1], [1, 0, 0, 1], [1, 1, 0, 1], [0, 1, 0, 1]]
  np.testing.assert_allclose(color_at(quad(corners=corners), 0.7, 0.2), [178.5, 51, 0, 255])
  mesh = quad(np.full((2, 2, 4), [100, 50, 25, 255]), corners=corners)
  np.testing.assert_allclose(color_at(mesh, 0.7, 0.2), [70, 10, 0, 255], rtol=1e-5)


def test_points_of_several_textures_at_once():
  mesh = quad(np.full((1, 1, 4), RED))
  mesh = mesh._replace(
    texture=np.array([1, 0], np.int32), textures=(*mesh.textures, np.full((2, 3, 4), 51, np.uint8))
  )
  weights = np.full((3, 3), 1 / 3)
  colors = albedo(mesh, np.array([1, 0, 1]), weights)
  np.testing.assert_allclose(255 * colors, [RED, [51] * 4, RED], rtol=1e-5)


def test_holes_are_no_surface_and_glass_is():
  holed = FOUR.copy()
  holed[0, 0, 3] = 0
  mesh = quad(repeated(holed, 8), corners=[[1, 1, 1, 0.1]] * 4)
  for at, expected in {(0.1, 0.9): False, (0.9, 0.9): True, (0.3, 0.1): True}.items():
    assert is_surface(mesh, *place(*at)).tolist() == [expected]
  assert is_surface(quad(corners=[[1, 1, 1, 0.1]] * 4), *place(0.1, 0.9)).all()


def test_normalize_centres_and_scales_what_faces_use():
  vertices = np.array([[0, 0, 0], [4, 0, 0], [4, 1, 0], [0, 1, 2], [100, 100, 100]], float)
  used = normalize(quad(vertices=vertices)).vertices[:4]
  np.testing.assert_allclose(used.max(0), np.array([4, 1, 2]) / 8 * OBJECT_EXTENT)
  np.testing.assert_allclose(used.min(0), -used.max(0))


@pytest.mark.parametrize(
  ('vertices', 'reason'),
  [
    (np.where(QUAD == 0, np.nan, QUAD), 'not finite'),
    (np.where(QUAD == 1, np.inf, QUAD), 'not finite'),
    (QUAD * 1e200, 'beyond'),
    (np.full((4, 3), 0.3), 'no extent'),
  ],
)
def test_unfit_vertices_are_rejected_with_the_reason(vertices, reason):
  with pytest.raises(UserError, match=reason):
    check(quad(vertices=vertices))


def test_no_faces_are_rejected_and_a_flat_mesh_is_fit():
  check(quad())
  with pytest.raises(UserError, match='no faces'):
    check(quad()._replace(faces=np.zeros((0, 3), int)))


def test_vertices_that_no_face_uses_do_not_matter():
  check(quad(vertices=np.concatenate([QUAD, [[np.nan] * 3]])))
