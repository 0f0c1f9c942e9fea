import numpy as np
import pytest
import trimesh

from cvn.camera import DISTANCE, camera_at, project
from datagen.geometry.mesh import TexturedMesh
from datagen.geometry.render import render

SIZE = 64


def colored(mesh, colors=(0.2, 0.4, 0.6)):
  """A trimesh -> ours, with one colour, or one a face [F, 3]."""
  f = len(mesh.faces)
  corners = np.ones((f, 3, 4), np.float32)
  corners[..., :3] = np.broadcast_to(np.reshape(colors, (-1, 1, 3)), (f, 3, 3))
  return TexturedMesh(
    np.asarray(mesh.vertices, np.float64),
    np.asarray(mesh.faces, np.int64),
    corners,
    np.zeros((f, 3, 2), np.float32),
    np.full(f, -1, np.int32),
    (),
  )


def quad(z, texture=None, color=(1, 1, 1, 1)):
  """The square [-0.25, 0.25]^2 at depth z, facing +z, under a texture."""
  x = 0.25
  vertices = np.array([[-x, -x, z], [x, -x, z], [x, x, z], [-x, x, z]])
  uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
  faces = np.array([[0, 1, 2], [0, 2, 3]])
  corners = np.broadcast_to(np.array(color, np.float32), (2, 3, 4)).copy()
  number = -1 if texture is None else 0
  return TexturedMesh(
    vertices, faces, corners, uv[faces], np.full(2, number, np.int32), (texture,) * (number + 1)
  )


def joined(a, b):
  """Two meshes as one; only `a` may have textures."""
  return TexturedMesh(
    np.concatenate([a.vertices, b.vertices]),
    np.concatenate([a.faces, b.faces + len(a.vertices)]),
    np.concatenate([a.corner_colors, b.corner_colors]),
    np.concatenate([a.corner_uv, b.corner_uv]),
    np.concatenate([a.texture, b.texture]),
    a.textures,
  )


@pytest.fixture(scope='module')
def odd():
  """An object without symmetry, each face of another colour."""
  parts = [
    trimesh.creation.box((0.8, 0.2, 0.5)).apply_translation((0.05, -0.3, 0.1)),
    trimesh.creation.icosphere(subdivisions=2, radius=0.2).apply_translation((-0.2, 0.1, 0.2)),
    trimesh.creation.cone(radius=0.1, height=0.5).apply_translation((0.25, 0.1, -0.1)),
  ]
  mesh = trimesh.util.concatenate(parts)
  return colored(mesh, np.random.default_rng(0).uniform(size=(len(mesh.faces), 3)))


def mesh_normals(mesh):
  a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
  cross = np.cross(b - a, c - a)
  return cross / np.linalg.norm(cross, axis=-1, keepdims=True)


def differing(a, b):
  """Share of pixels in which two images differ at all."""
  return (a != b).any(-1).mean()


def test_a_box_fills_the_pixels_it_must_at_the_depth_it_must():
  mesh = colored(trimesh.creation.box((0.5, 0.7, 0.3)))
  camera = camera_at(0, image_size=SIZE)
  views = render(mesh, [camera], image_size=SIZE)
  # From the front only the face z = 0.15 is seen.
  focal, depth = camera.K[0, 0], DISTANCE - 0.15
  at = np.arange(SIZE) + 0.5 - SIZE / 2
  inside = np.outer(np.abs(at) < 0.35 * focal / depth, np.abs(at) < 0.25 * focal / depth)
  np.testing.assert_array_equal(views.rgba[0, ..., 3], inside * 255)
  np.testing.assert_array_equal(views.rgba[0][inside][:, :3], [[51, 102, 153]] * inside.sum())
  np.testing.assert_array_equal(views.rgba[0][~inside], 0)
  np.testing.assert_allclose(views.depth[0][inside], depth, atol=1e-6)
  assert np.isinf(views.depth[0][~inside]).all()
  np.testing.assert_array_equal(views.seen, mesh_normals(mesh)[:, 2] > 0.5)


def test_the_depth_of_a_sphere():
  mesh = colored(trimesh.creation.icosphere(subdivisions=5, radius=0.4))
  for azimuth in (0, 30):
    camera = camera_at(azimuth, image_size=SIZE)
    depth = render(mesh, [camera], image_size=SIZE).depth[0]
    at = (np.arange(SIZE) + 0.5 - SIZE / 2) / camera.K[0, 0]
    # The ray t (x, y, 1) meets |p - (0, 0, D)| = r.
    square = np.add.outer(at**2, at**2) + 1
    root = DISTANCE**2 - square * (DISTANCE**2 - 0.4**2)
    with np.errstate(invalid='ignore'):
      expected = (DISTANCE - np.sqrt(root)) / square
    inner = root > 0.02  # at the very rim the facets differ from the sphere
    np.testing.assert_allclose(depth[inner], expected[inner], atol=5e-4)
    assert np.isinf(depth[root < -0.02]).all()


def test_points_are_rendered_where_they_project():
  points = np.random.default_rng(1).uniform(-0.4, 0.4, (8, 3))
  cubes = [trimesh.creation.box((0.06,) * 3).apply_translation(p) for p in points]
  colors = np.repeat(np.eye(8)[:, :3] * 0.5 + np.arange(8)[:, None] / 16, 12, axis=0)
  mesh = colored(trimesh.util.concatenate(cubes), colors)
  cameras = [camera_at(a, image_size=256) for a in (0, 60, 210)]
  views = render(mesh, cameras, image_size=256)
  seen = 0
  for view, camera in zip(views.rgba, cameras, strict=True):
    pixel, depth = project(points, camera)
    for i, color in enumerate(np.round(colors[::12] * 255)):
      row, column = np.nonzero((np.abs(view[..., :3] - color) <= 1).all(-1) & (view[..., 3] > 0))
      half = 0.03 * camera.K[0, 0] / depth[i]
      if len(row) < 3.6 * half**2:  # something hides a part of it
        continue
      seen += 1
      middle = [(column.min() + column.max() + 1) / 2, (row.min() + row.max() + 1) / 2]
      np.testing.assert_allclose(middle, pixel[i], atol=1.0)
  assert seen >= 15


def test_pixels_lie_on_the_surface_they_show():
  # Foreground pixels, thrown back by their depth, lie on the plane of a tilted triangle.
  triangle = np.array([[-0.4, -0.3, 0.2], [0.45, -0.2, -0.3], [0.0, 0.4, 0.1]])
  mesh = colored(trimesh.Trimesh(triangle, [[0, 1, 2]], process=False))
  camera = camera_at(30, image_size=SIZE)
  depth = render(mesh, [camera], image_size=SIZE).depth[0]
  row, column = np.nonzero(np.isfinite(depth))
  ray = np.linalg.solve(camera.K, np.stack([column + 0.5, row + 0.5, np.ones(len(row))])).T
  points = (ray * depth[row, column, None] - camera.T) @ camera.R
  normal = np.cross(triangle[1] - triangle[0], triangle[2] - triangle[0])
  np.testing.assert_allclose((points - triangle[0]) @ normal, 0, atol=1e-6)
  assert len(row) > 100


def test_azimuth_90_is_the_object_turned_by_minus_90(odd):
  side = render(odd, [camera_at(90, image_size=SIZE)], image_size=SIZE)
  x, y, z = odd.vertices.T
  turned = odd._replace(vertices=np.stack([-z, y, x], -1))
  front = render(turned, [camera_at(0, image_size=SIZE)], image_size=SIZE)
  assert differing(side.rgba[0], front.rgba[0]) < 0.002
  # But for a ray that grazes an edge, the depths are the same too.
  same = np.isclose(side.depth[0], front.depth[0], atol=1e-5)
  assert same.mean() > 0.998


@pytest.mark.parametrize('azimuth', [0, 60, 270])
def test_a_mirrored_object_gives_the_mirrored_view_at_the_mirrored_azimuth(odd, azimuth):
  view = render(odd, [camera_at(azimuth, image_size=SIZE)], image_size=SIZE).rgba[0]
  mirrored = odd._replace(vertices=odd.vertices * [-1, 1, 1])
  other = render(mirrored, [camera_at(-azimuth, image_size=SIZE)], image_size=SIZE).rgba[0]
  assert differing(view[:, ::-1], other) < 0.002
  assert differing(view, other) > 0.02


def test_surfaces_have_two_sides(odd):
  camera = camera_at(60, image_size=SIZE)
  inverted = odd._replace(faces=odd.faces[:, ::-1], corner_colors=odd.corner_colors[:, ::-1].copy())
  a, b = (render(m, [camera], image_size=SIZE).rgba[0] for m in (odd, inverted))
  assert differing(a, b) < 0.002


def test_a_texture_is_upright():
  texture = np.zeros((2, 2, 4), np.uint8)
  texture[..., 3] = 255
  texture[0, 0, 0] = texture[0, 1, 1] = texture[1, 0, 2] = 200  # red, green; blue, black
  texture = texture.repeat(8, 0).repeat(8, 1)
  view = render(quad(0, texture), [camera_at(0, image_size=SIZE)], image_size=SIZE).rgba[0]
  np.testing.assert_array_equal(view[26, 26], [200, 0, 0, 255])
  np.testing.assert_array_equal(view[26, 38], [0, 200, 0, 255])
  np.testing.assert_array_equal(view[38, 26], [0, 0, 200, 255])
  np.testing.assert_array_equal(view[38, 38], [0, 0, 0, 255])


def test_holes_in_a_texture_are_looked_through():
  texture = np.full((16, 16, 4), 255, np.uint8)
  texture[:, :8, 3] = 0
  mesh = joined(quad(0.2, texture), quad(-0.2, color=(1, 0, 0, 1)))
  mesh = joined(mesh, quad(-0.3, color=(0, 1, 0, 1)))
  views = render(mesh, [camera_at(0, image_size=SIZE)], image_size=SIZE)
  np.testing.assert_array_equal(views.rgba[0, 32, 26], [255, 0, 0, 255])
  np.testing.assert_array_equal(views.rgba[0, 32, 38], [255, 255, 255, 255])
  np.testing.assert_allclose(views.depth[0, 32, [26, 38]], [DISTANCE + 0.2, DISTANCE - 0.2])


def test_a_hole_with_nothing_behind_it_is_background():
  texture = np.zeros((4, 4, 4), np.uint8)
  views = render(quad(0, texture), [camera_at(0, image_size=SIZE)], image_size=SIZE)
  np.testing.assert_array_equal(views.rgba, 0)


def test_glass_is_surface():
  mesh = quad(0, color=(0.2, 0.4, 0.6, 0.1))
  view = render(mesh, [camera_at(0, image_size=SIZE)], image_size=SIZE).rgba[0]
  np.testing.assert_array_equal(view[32, 32], [51, 102, 153, 255])


def test_a_pixel_on_a_seam_is_the_mean_of_its_rays():
  # The seam x = 0 moved so that it leaves one of three columns of rays of pixel 32 on its left.
  camera = camera_at(0, image_size=SIZE)
  seam = 1 / 3 * DISTANCE / camera.K[0, 0]
  left, right = (quad(0, color=(c, c, c, 1)) for c in (0, 1))
  left.vertices[[1, 2], 0] = right.vertices[[0, 3], 0] = seam
  view = render(joined(left, right), [camera], image_size=SIZE).rgba[0]
  np.testing.assert_array_equal(view[32, 31:34, 0], [0, 170, 255])


def test_light_changes_colours_and_nothing_else():
  ground = trimesh.creation.box((0.9, 0.05, 0.9)).apply_translation((0, -0.3, 0))
  ball = trimesh.creation.icosphere(subdivisions=3, radius=0.3)
  mesh = colored(trimesh.util.concatenate([ground, ball]), (0.8, 0.8, 0.8))
  camera = camera_at(0, image_size=SIZE)
  flat, lit, again = (
    render(mesh, [camera], image_size=SIZE, shading=s) for s in ('flat', 'lit', 'lit')
  )
  np.testing.assert_array_equal(lit.rgba[..., 3], flat.rgba[..., 3])
  np.testing.assert_array_equal(lit.depth, flat.depth)
  np.testing.assert_array_equal(lit.rgba, again.rgba)
  column = lit.rgba[0, :, SIZE // 2, 0].astype(int)
  assert column[24] > column[36] + 40  # the ball's top and its underside
  assert lit.rgba[0, 30, 24, 0] > lit.rgba[0, 30, 40, 0] + 10  # the lamp is on the left


def test_an_unknown_shading():
  with pytest.raises(ValueError, match='phong'):
    render(quad(0), [camera_at(0)], shading='phong')
