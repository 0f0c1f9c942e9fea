"""Of faces in the same place one is kept, and which."""

import numpy as np
import pytest
import trimesh

from datagen.geometry import coincident
from datagen.geometry.coincident import without_coincident
from datagen.geometry.mesh import TexturedMesh

TRIANGLE = np.array([[-0.4, -0.4, 0], [0.4, -0.4, 0], [0, 0.4, 0.0]])
OUT, IN, OTHER = (0.9, 0.1, 0.1), (0.1, 0.1, 0.9), (0.5, 0.5, 0.5)


def mesh_of(vertices, faces, colors, texture=None):
  """A mesh whose faces have a colour each and, where `texture` is not -1, that texture."""
  faces, colors = np.array(faces), np.array(colors, np.float32)
  rgba = np.concatenate([colors, np.ones((len(faces), 1), np.float32)], 1)
  return TexturedMesh(
    vertices=np.asarray(vertices, float),
    faces=faces,
    corner_colors=rgba[:, None].repeat(3, 1),
    corner_uv=np.zeros((len(faces), 3, 2), np.float32),
    texture=np.full(len(faces), -1, np.int32) if texture is None else np.array(texture, np.int32),
    textures=(np.full((4, 4, 4), 255, np.uint8),),
  )


def double_sided(*parts, inside_first):
  """The faces of closed parts, outside, and the same turned over, inside, as one mesh."""
  vertices = np.concatenate([p.vertices for p in parts])
  starts = np.cumsum([0, *(len(p.vertices) for p in parts)])
  out = np.concatenate([p.faces + start for p, start in zip(parts, starts[:-1], strict=True)])
  faces, colors = [out, out[:, [1, 0, 2]]], [[OUT] * len(out), [IN] * len(out)]
  if inside_first:
    faces, colors = faces[::-1], colors[::-1]
  return mesh_of(vertices, np.concatenate(faces), np.concatenate(colors))


def colors_of(mesh):
  return {tuple(c) for c in np.round(mesh.corner_colors[:, 0, :3].astype(float), 3).tolist()}


def box(extents, center):
  return trimesh.creation.box(extents, trimesh.transformations.translation_matrix(center))


def test_faces_in_places_of_their_own_stay():
  mesh = mesh_of(np.concatenate([TRIANGLE, TRIANGLE + 0.01]), [[0, 1, 2], [3, 4, 5]], [OUT, IN])
  assert without_coincident(mesh) is mesh


def test_the_first_of_the_same_stays_with_all_that_is_its_own():
  faces = [[0, 1, 2], [1, 2, 0], [3, 4, 5], [2, 0, 1]]
  vertices = np.concatenate([TRIANGLE, TRIANGLE + 0.01])
  mesh = mesh_of(vertices, faces, [OUT, IN, OTHER, IN])
  mesh = mesh._replace(corner_uv=mesh.corner_uv + np.arange(4)[:, None, None])
  kept = without_coincident(mesh)
  assert kept.faces.tolist() == [faces[0], faces[2]]
  np.testing.assert_array_equal(kept.corner_colors, mesh.corner_colors[[0, 2]])
  np.testing.assert_array_equal(kept.corner_uv, mesh.corner_uv[[0, 2]])
  assert kept.texture.tolist() == [-1, -1]


@pytest.mark.parametrize('turned', [[0, 1, 2], [2, 1, 0]])
def test_texture_before_none(turned):
  kept = without_coincident(mesh_of(TRIANGLE, [[0, 1, 2], turned], [OUT, IN], [-1, 0]))
  assert kept.texture.tolist() == [0] and colors_of(kept) == {IN}


def test_the_same_place_under_other_indices():
  again = np.where(TRIANGLE == 0, -0.0, TRIANGLE)
  mesh = mesh_of(np.concatenate([TRIANGLE, again]), [[0, 1, 2], [4, 5, 3]], [OUT, IN])
  assert colors_of(without_coincident(mesh)) == {OUT}


@pytest.mark.parametrize('inside_first', [False, True])
def test_outsides_are_kept_also_where_they_look_to_the_middle(inside_first):
  """The front of a chair's back looks to the chair's middle, and so does the top of its seat."""
  seat = box((0.8, 0.1, 0.8), (0, -0.2, 0))
  back = box((0.8, 0.7, 0.05), (0, 0.2, -0.4))
  leg = box((0.05, 0.3, 0.05), (0.3, -0.4, 0.3))
  mesh = double_sided(seat, back, leg, inside_first=inside_first)
  kept = without_coincident(mesh)
  assert len(kept.faces) == 36 and colors_of(kept) == {OUT}


@pytest.mark.parametrize('inside_first', [False, True])
def test_textures_inside_are_not_kept(inside_first):
  mesh = double_sided(box((0.8, 0.8, 0.8), (0, 0, 0)), inside_first=inside_first)
  mesh = mesh._replace(texture=np.where(mesh.corner_colors[:, 0, 2] > 0.5, 0, -1))
  assert colors_of(without_coincident(mesh)) == {OUT}


@pytest.mark.parametrize('inside_first', [False, True])
def test_faces_that_no_ray_meets_look_like_the_others(monkeypatch, inside_first):
  monkeypatch.setattr(coincident, 'RESOLUTION', 24)
  ball = trimesh.creation.icosphere(4, radius=0.45)
  kept = without_coincident(double_sided(ball, inside_first=inside_first))
  assert len(kept.faces) == 5120 and colors_of(kept) == {OUT}


def test_a_sheet_that_is_seen_from_both_sides_has_one_color():
  axis = np.linspace(-0.45, 0.45, 8)
  x, y = np.meshgrid(axis, axis)
  vertices = np.stack([x, y, 0.2 * np.sin(6 * x)], -1).reshape(-1, 3)
  i = (np.arange(7)[:, None] * 8 + np.arange(7)).ravel()
  faces = np.concatenate([np.stack([i, i + 1, i + 9], 1), np.stack([i, i + 9, i + 8], 1)])
  mesh = mesh_of(
    vertices,
    np.concatenate([faces, faces[:, ::-1]]),
    [OUT] * len(faces) + [IN] * len(faces),
  )
  kept = without_coincident(mesh)
  assert len(kept.faces) == 98 and len(colors_of(kept)) == 1


def test_no_two_of_many_faces_are_taken_for_one():
  rng = np.random.default_rng(0)
  vertices = rng.integers(0, 64, (4000, 3)) / 64 - 0.5
  faces = rng.integers(0, 4000, (100_000, 3))
  kept = without_coincident(mesh_of(vertices, faces, [OUT] * len(faces)))
  positions = np.unique(vertices, axis=0, return_inverse=True)[1]
  assert len(kept.faces) == len(np.unique(np.sort(positions[faces], 1), axis=0))
