"""Cutting, lifting and joining surfaces, on sheets whose pieces are known."""

import numpy as np
import pytest

from datagen.geometry.mesh import albedo
from datagen.sources.people import layers
from datagen.sources.people.data import BodyData
from datagen.sources.people.layers import Layer, Paint

RED, BLUE = np.array([1.0, 0, 0]), np.array([0, 0, 1.0])


def _sheet(n=4):
  """A unit square of n x n quads in the plane z = 0 that looks to +z."""
  y, x = np.divmod(np.arange((n + 1) ** 2), n + 1)
  vertices = np.stack([x / n, y / n, np.zeros(len(x))], 1)
  i, j = (k.ravel() for k in np.meshgrid(np.arange(n), np.arange(n), indexing='ij'))
  a = i * (n + 1) + j
  return vertices, np.stack([a, a + 1, a + n + 2, a + n + 1], 1)


def _assemble(vertices, *found, transform=None):
  data = BodyData('', '', vertices, {}, ('root',), np.array([-1]), (), np.ones((len(vertices), 1)))
  outward = np.tile([0.0, 0, 1], (len(vertices), 1))
  bones = np.eye(4)[None] if transform is None else transform[None]
  return layers.assemble(data, found, [], vertices, outward, bones)


def _area(vertices, faces):
  a, b, c = np.moveaxis(vertices[faces], 1, 0)
  return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()


def _cut(vertices, faces, field):
  cut = layers.clip(faces, field)
  first, second = vertices[cut.edges[:, 0]], vertices[cut.edges[:, 1]]
  return np.concatenate([vertices, first + cut.shares[:, None] * (second - first)]), cut


@pytest.mark.parametrize('slope', [(1, 0, 0.3), (-1, 0, 0.3), (0.7, 1.1, 0.9), (1, -2, 0.111)])
def test_pieces_on_either_side_of_a_cut_make_the_whole(slope):
  vertices, quads = _sheet()
  faces = layers.triangles(quads)
  field = vertices[:, 0] * slope[0] + vertices[:, 1] * slope[1] - slope[2]
  areas = []
  for sign in (1, -1):
    points, cut = _cut(vertices, faces, sign * field)
    areas.append(_area(points, cut.faces))
    value = points[:, 0] * slope[0] + points[:, 1] * slope[1] - slope[2]
    assert (sign * value[cut.faces] > -1e-9).all()
    a, b, c = np.moveaxis(points[cut.faces], 1, 0)
    assert (np.cross(b - a, c - a)[:, 2] > -1e-12).all()  # none is turned over
    np.testing.assert_allclose(value[cut.rim], 0, atol=1e-9)
    edges = {(a, b) for f in cut.faces for a, b in zip(f, np.roll(f, -1), strict=True)}
    assert {tuple(e) for e in cut.rim} <= edges
  assert sum(areas) == pytest.approx(1)


def test_cuts_all_or_nothing():
  vertices, quads = _sheet()
  faces = layers.triangles(quads)
  assert len(layers.clip(faces, np.ones(len(vertices))).faces) == len(faces)
  assert len(layers.clip(faces, -np.ones(len(vertices))).faces) == 0


def test_normals_of_a_sheet_look_its_way():
  vertices, quads = _sheet()
  vertices = np.concatenate([vertices, [[9, 9, 9]]])  # no face has it
  normals = layers.normals(vertices, quads)
  np.testing.assert_allclose(normals[:-1], np.tile([0, 0, 1], (len(vertices) - 1, 1)))
  np.testing.assert_array_equal(normals[-1], 0)


def test_a_lifted_layer_has_a_rim_along_its_hem_but_none_along_its_seam():
  vertices, quads = _sheet()
  hem, seam = 0.6 - vertices[:, 1], 0.3 - vertices[:, 0]
  layer = Layer(quads, hem, np.full(len(vertices), 0.2), Paint(RED), (seam,))
  mesh = _assemble(vertices, layer)
  top = mesh.vertices[mesh.faces][..., 2].min(1) > 0.19
  assert _area(mesh.vertices, mesh.faces[top]) == pytest.approx(0.3 * 0.6)
  assert _area(mesh.vertices, mesh.faces[~top]) == pytest.approx(0.3 * 0.2)  # of the hem alone
  np.testing.assert_allclose(mesh.vertices[mesh.faces[~top]][..., 1], 0.6)
  a, b, c = np.moveaxis(mesh.vertices[mesh.faces[~top]], 1, 0)
  assert (np.cross(b - a, c - a)[:, 1] > 0).all()  # the rim looks outward
  flat = _assemble(vertices, layer._replace(lift=np.zeros(len(vertices))))
  assert _area(flat.vertices, flat.faces) == pytest.approx(0.3 * 0.6)


def test_pictures_stay_where_their_coordinates_say_also_across_cuts_and_the_seam_of_a_turn():
  vertices, quads = _sheet()
  picture = np.zeros((64, 64, 4), np.uint8)
  picture[..., 3] = 255
  picture[:, :16, 0] = 255  # u < 1/4 is red
  u = vertices[:, 0] + 0.625
  uv = np.stack([u % 1, vertices[:, 1]], 1)  # wraps at x = 0.375
  paint = Paint(BLUE, picture, uv, wraps=True)
  mesh = _assemble(vertices, Layer(quads, 0.55 - vertices[:, 1], np.zeros(len(u)), paint))
  third = np.full((len(mesh.faces), 3), 1 / 3)
  x = mesh.vertices[mesh.faces].mean(1)[:, 0]
  red = albedo(mesh, np.arange(len(mesh.faces)), third)[:, 0]
  expected = (x > 0.375) & (x < 0.625)
  sure = np.minimum(np.abs(x - 0.375), np.abs(x - 0.625)) > 0.03
  np.testing.assert_allclose(red[sure], expected[sure], atol=1e-6)
  assert sure.sum() > 20


def test_bones_move_the_lifted_surface():
  vertices, quads = _sheet(1)
  move = np.eye(4)
  move[:3, 3] = [5, 0, 0]
  lift = np.full(4, 0.5)
  mesh = _assemble(vertices, Layer(quads, np.ones(4), lift, Paint(RED)), transform=move)
  np.testing.assert_allclose(mesh.vertices.min(0), [5, 0, 0.5])
  np.testing.assert_array_equal(mesh.corner_colors[0, 0], [1, 0, 0, 1])


def test_layers_that_share_a_picture_share_the_texture():
  vertices, quads = _sheet(1)
  picture = np.full((4, 4, 4), 255, np.uint8)
  paint = Paint(RED, picture, vertices[:, :2])
  layer = Layer(quads, np.ones(4), np.zeros(4), paint)
  mesh = _assemble(vertices, layer, layer, layer._replace(paint=Paint(BLUE)))
  assert len(mesh.textures) == 1
  assert mesh.texture.tolist() == [0, 0, 0, 0, -1, -1]
  assert len(mesh.vertices) == 12 and mesh.faces.max() == 11
