"""What becomes of parts: one mesh, with pictures unpacked and what is invisible left out."""

import io

import numpy as np
import PIL.Image
import pytest
import trimesh
from solids import textured as from_solid

from cvn.errors import UserError
from datagen.geometry.mesh import NO_COLOR, TexturedMesh, albedo, check, is_surface
from datagen.reading import notes as notes_lib
from datagen.reading import parts as parts_lib
from datagen.reading.colors import grey
from datagen.reading.parts import (
  BLEND,
  MASK,
  MAX_TEXTURE_SIDE,
  OPAQUE,
  UNKNOWN,
  Part,
  Picture,
  assemble,
  placed,
)

QUAD = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
FACES = np.array([[0, 1, 2], [0, 2, 3]])
UV = QUAD[:, :2]
RED, GREEN, BLUE, WHITE = [255, 0, 0, 255], [0, 255, 0, 255], [0, 0, 255, 255], [255] * 4
FOUR = np.array([[RED, GREEN], [BLUE, WHITE]], np.uint8)  # row 0 is the image's top


def png(pixels, *, repeat=8):
  stream = io.BytesIO()
  PIL.Image.fromarray(np.repeat(np.repeat(pixels, repeat, 0), repeat, 1)).save(stream, 'PNG')
  return stream.getvalue()


def quad(picture=None, uv=UV, color=(1, 1, 1, 1), faces=FACES):
  colors = np.tile(np.array(color, np.float32), (len(faces), 3, 1))
  part = Part(QUAD, faces, colors, None if uv is None else uv[faces].astype(float))
  if picture is None:
    return part
  return part._replace(texture=np.zeros(len(faces), np.int32), pictures=(picture,))


def mesh_of(*parts):
  return assemble(parts, set())


def noted(*parts):
  notes = set()
  return assemble(parts, notes), notes


def color_at(mesh, x, y):
  """Albedo of the quad's point (x, y) in 0..255."""
  face = int(x < y)
  a, b, c = mesh.vertices[mesh.faces[face]][:, :2]
  v, w = np.linalg.solve(np.stack([b - a, c - a], 1), np.array([x, y]) - a)
  return 255 * albedo(mesh, np.array([face]), np.array([[1 - v - w, v, w]]))[0]


def assert_color(actual, expected):
  np.testing.assert_allclose(actual[: len(expected)], expected, atol=0.6)


@pytest.mark.parametrize('shift', [-1, 3, 1000, -70000])
def test_textures_repeat(shift):
  mesh = mesh_of(quad(Picture(png(FOUR), ''), UV + shift))
  assert_color(color_at(mesh, 0.25, 0.75), RED)
  twice = mesh_of(quad(Picture(png(FOUR), ''), 2 * UV + shift))
  for x in (0.125, 0.625):
    assert_color(color_at(twice, x, x + 0.25), RED)


@pytest.mark.parametrize(
  ('wrap', 'right', 'top'),
  [
    (('repeat', 'repeat'), [RED, BLUE], [BLUE, WHITE]),
    (('mirror', 'mirror'), [GREEN, WHITE], [RED, GREEN]),
    (('clamp', 'clamp'), [GREEN, WHITE], [RED, GREEN]),
    (('mirror', 'repeat'), [GREEN, WHITE], [BLUE, WHITE]),
    (('repeat', 'clamp'), [RED, BLUE], [RED, GREEN]),
  ],
)
@pytest.mark.parametrize('shift', [0, 2, -2000])
def test_beyond_its_border_a_texture_goes_on_as_its_sampler_says(wrap, right, top, shift):
  """The tiles to the right of the first one and above it, near where they meet it."""
  shift = np.array([0 if mode == 'clamp' else shift for mode in wrap])
  mesh = mesh_of(quad(Picture(png(FOUR), '', wrap=wrap), 2 * UV + shift))
  for y, expected in zip((0.375, 0.125), right, strict=True):
    assert_color(color_at(mesh, 0.625, y), expected)
  for x, expected in zip((0.125, 0.375), top, strict=True):
    assert_color(color_at(mesh, x, 0.625), expected)


def test_clamped_far_out():
  mesh = mesh_of(quad(Picture(png(FOUR), '', wrap=('clamp', 'clamp')), 10 * UV - 5))
  assert_color(color_at(mesh, 0.1, 0.9), RED)
  assert_color(color_at(mesh, 0.9, 0.1), WHITE)


def test_corner_colors_multiply_the_texture():
  mesh = mesh_of(quad(Picture(png(FOUR), ''), color=(1, 0, 1, 0.5)))
  assert_color(color_at(mesh, 0.75, 0.25), [255, 0, 255, 127.5])


def test_texture_without_coordinates_is_its_mean():
  mesh, notes = noted(quad(Picture(png(FOUR), ''), None))
  assert_color(color_at(mesh, 0.1, 0.2), [127.5, 127.5, 127.5, 255])
  assert not np.any(mesh.texture >= 0) and notes == {notes_lib.NO_COORDINATES}


def test_one_face_without_coordinates_loses_the_texture_alone():
  part = quad(Picture(png(FOUR), ''))
  part.uv[0, 1] = np.nan
  mesh, notes = noted(part)
  assert mesh.texture.tolist() == [-1, 0] and notes == {notes_lib.BAD_COORDINATES}
  assert_color(color_at(mesh, 0.7, 0.3), [127.5] * 3)
  assert_color(color_at(mesh, 0.25, 0.75), RED)


def test_large_texture_shrinks():
  mesh = mesh_of(quad(Picture(png(FOUR, repeat=MAX_TEXTURE_SIDE), '')))
  assert mesh.textures[0].shape == (MAX_TEXTURE_SIDE, MAX_TEXTURE_SIDE, 4)
  assert_color(color_at(mesh, 0.25, 0.75), RED)


def test_vertex_and_face_colors():
  mesh = from_solid(trimesh.Trimesh(QUAD, FACES, vertex_colors=[RED, GREEN, BLUE, WHITE]))
  assert_color(color_at(mesh, 0.5, 0.0), [127.5, 127.5, 0])
  mesh = mesh_of(quad()._replace(colors=grey(2)))
  assert_color(color_at(mesh, 0.3, 0.7), [NO_COLOR * 255] * 3 + [255])


def test_glass_keeps_its_alpha_and_is_surface():
  mesh = mesh_of(quad(color=(0.2, 0.4, 0.6, 0.25)))
  assert_color(color_at(mesh, 0.3, 0.7), [51, 102, 153, 255 * 0.25])
  assert is_surface(mesh, np.array([0]), np.array([[0.2, 0.3, 0.5]])).all()


def test_invisible_faces_are_left_out_unless_all_are():
  clear = quad(color=(1, 1, 1, 0.01))
  mesh, notes = noted(clear, quad()._replace(vertices=QUAD + 1))
  assert len(mesh.faces) == 2 and mesh.vertices[mesh.faces].min() == 1 and not notes
  mesh, notes = noted(clear)
  assert len(mesh.faces) == 2 and notes == {notes_lib.ALPHA_IGNORED}
  assert_color(color_at(mesh, 0.3, 0.7), WHITE)


@pytest.mark.parametrize('alpha', [MASK, BLEND, UNKNOWN])
def test_alpha_that_leaves_nothing_cuts_nothing(alpha):
  clear = np.full((2, 2, 4), [9, 9, 9, 0], np.uint8)
  mesh, notes = noted(quad(Picture(png(clear), '', alpha)))
  assert_color(color_at(mesh, 0.3, 0.7), [9, 9, 9, 255])
  assert notes == {notes_lib.ALPHA_IGNORED}


@pytest.mark.parametrize(
  ('alpha', 'cutoff', 'value', 'solid'),
  [
    (OPAQUE, 0.5, 0, True),
    (MASK, 0.3, 110, True),
    (MASK, 0.5, 110, False),
    (BLEND, 0.5, 110, True),  # the window of a car
    (BLEND, 0.5, 5, False),
    (UNKNOWN, 0.5, 110, True),  # a wide stretch of it
    (UNKNOWN, 0.5, 5, False),
  ],
)
def test_alpha_of_a_texture(alpha, cutoff, value, solid):
  picture = FOUR.copy()
  picture[1, 0, 3] = value
  mesh = mesh_of(quad(Picture(png(picture), '', alpha, cutoff)))
  at = np.array([0]), np.array([[0.8, 0.1, 0.1]])  # (0.2, 0.1)
  assert is_surface(mesh, *at)[0] == solid


def test_a_soft_rim_of_unknown_alpha_is_cut_in_its_middle():
  ramp = np.full((4, 16, 4), 255, np.uint8)
  ramp[..., 3] = np.clip((np.arange(16) - 6) * 64, 0, 255)  # 0, 64, 128, 192, 255 from the seventh
  pixels = mesh_of(quad(Picture(png(ramp, repeat=1), ''))).textures[0]
  assert (pixels[..., 3] == np.where(np.arange(16) >= 8, 255, 0)).all()


@pytest.mark.parametrize('grey_mask', [True, False])
def test_a_mask_of_its_own(grey_mask):
  """White or opaque in its left half, at half the picture's size."""
  mask = np.array([[WHITE, [0, 0, 0, 255] if grey_mask else [255, 255, 255, 0]]] * 2, np.uint8)
  mesh = mesh_of(quad(Picture(png(FOUR), '', MASK, mask=png(mask, repeat=4))))
  assert (mesh.textures[0][:, :8, 3] == 255).all() and (mesh.textures[0][:, 8:, 3] == 0).all()
  assert_color(color_at(mesh, 0.25, 0.75), RED)
  alone = Picture(png(mask), '', MASK, mask=png(mask), color=(0.2, 0.4, 0.6))
  mesh = mesh_of(quad(alone))
  assert_color(color_at(mesh, 0.25, 0.75), [51, 102, 153])
  assert not is_surface(mesh, np.array([0]), np.array([[0.2, 0.6, 0.2]]))[0]


def test_mirrors_turn_faces():
  solid = trimesh.creation.box((1, 1, 1))
  part = Part(np.asarray(solid.vertices), np.asarray(solid.faces), grey(12))
  mirror = np.diag([-1.0, 1, 1, 1])
  mirror[0, 3] = -5
  mesh = mesh_of(placed(part, np.diag([2.0, 2, 2, 1])), placed(part, mirror))
  np.testing.assert_allclose(mesh.vertices.min(0), [-5.5, -1, -1])
  # Every copy, mirrored too, has its faces turned outwards: the volumes add up.
  volume = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).volume
  assert volume == pytest.approx(8 + 1)


def test_one_picture_is_one_texture_but_not_with_another_sampler():
  same, other = Picture(png(FOUR), 'a'), Picture(png(FOUR), 'b')
  mesh = mesh_of(quad(same), quad(other), quad(other._replace(wrap=('clamp', 'clamp'))))
  assert len(mesh.textures) == len(mesh.wraps) == 2 and mesh.texture.tolist() == [0, 0, 0, 0, 1, 1]


def test_textures_that_are_too_large_together(monkeypatch):
  monkeypatch.setattr(parts_lib, 'MAX_TEXTURES', 300)
  with pytest.raises(UserError, match='its textures take more'):
    mesh_of(quad(Picture(png(FOUR), '')))


def test_faces_without_area_are_left_out():
  faces = np.concatenate([FACES, [[0, 0, 1], [2, 2, 2]]])
  mesh = mesh_of(quad(faces=faces))
  assert len(mesh.faces) == len(mesh.corner_colors) == 2


@pytest.mark.parametrize(
  ('vertices', 'faces', 'reason'),
  [
    (QUAD, np.zeros((0, 3), int), 'no faces'),
    (np.where(QUAD == 0, np.nan, QUAD), FACES, 'not finite'),
    (np.zeros((4, 3)), FACES, 'no faces'),
    (QUAD, FACES + 1, 'out of bounds'),
    (QUAD, FACES - 1, 'out of bounds'),
  ],
)
def test_bad_meshes_are_rejected_with_the_reason(vertices, faces, reason):
  with pytest.raises(UserError, match=reason):
    check(mesh_of(Part(vertices, faces, grey(len(faces)))))


def test_types():
  mesh = mesh_of(quad(Picture(png(FOUR), '')))
  expected = TexturedMesh('f8', 'i8', 'f4', 'f4', 'i4', None)
  assert [a.dtype for a in mesh[:5]] == [np.dtype(t) for t in expected[:5]]
  assert mesh.textures[0].dtype == np.uint8
