import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from cvn.camera import AZIMUTHS, camera_at, project
from cvn.grid import index_to_world
from datagen.flow import target_flows
from datagen.mesh import TexturedMesh
from datagen.render import render
from datagen.voxelize import voxelize

COLORS = np.array(
  [[0.9, 0.1, 0.1], [0.1, 0.9, 0.1], [0.1, 0.1, 0.9], [0.9, 0.9, 0.1], [0.9, 0.1, 0.9], [0.1] * 3]
)


def made(mesh, azimuths=AZIMUTHS, size=128, **options):
  """Voxels, views and target flows of a trimesh whose faces have colours by their normals."""
  normals = np.round(mesh.face_normals @ np.linalg.inv(mesh.metadata.get('turn', np.eye(3)).T))
  side = np.abs(normals).argmax(1) + 3 * (normals.sum(1) > 0)
  corners = np.ones((len(mesh.faces), 3, 4), np.float32)
  corners[..., :3] = COLORS[side][:, None]
  blank = np.zeros((len(mesh.faces), 3, 2), np.float32)
  none = np.full(len(mesh.faces), -1, np.int32)
  ours = TexturedMesh(np.array(mesh.vertices), np.array(mesh.faces), corners, blank, none, ())
  cameras = [camera_at(a, image_size=size) for a in azimuths]
  views = render(ours, cameras, image_size=size)
  index, color = voxelize(ours)
  flows = target_flows(index, color, *views, cameras, **options)
  return index, color, views, cameras, flows


@pytest.fixture(scope='module')
def tilted_box():
  turn = Rotation.from_euler('xyz', [20, 35, 10], degrees=True).as_matrix()
  mesh = trimesh.creation.box((0.7, 0.5, 0.4))
  mesh.apply_transform(np.block([[turn, np.zeros((3, 1))], [np.zeros((1, 3)), 1]]))
  mesh.metadata['turn'] = turn
  return made(mesh)


def landed(rgba, flow):
  """The colours [V, S, 3] of the pixels that flows point at."""
  size = np.array(rgba.shape[2:0:-1])
  column, row = np.moveaxis(np.minimum((flow * size).astype(int), size - 1), -1, 0)
  return rgba[np.arange(len(rgba))[:, None], row, column]


def test_the_projection_of_a_visible_voxel_lands_on_a_pixel_of_its_colour(tilted_box):
  index, color, views, _, flows = tilted_box
  pixels = landed(views.rgba, flows.flow)
  assert (pixels[..., 3] == 255).all()
  distance = np.linalg.norm(pixels[..., :3].astype(float) - color, axis=-1) / 255
  # Near the edges of the box a voxel's colour is a mean of two faces', or its centre, up to half a
  # voxel off the surface, projects onto the face next to its own.
  volume = np.full((66, 66, 66, 3), -1)
  volume[tuple(index.T + 1)] = color
  steps = np.stack(np.meshgrid(*[(-1, 0, 1)] * 3), -1).reshape(-1, 3)
  around = volume[tuple(np.moveaxis(index[:, None] + 1 + steps, -1, 0))]
  alike = np.abs(around - color[:, None]).max(-1) <= 1
  inner = (alike | (around[..., 0] < 0)).all(1)
  assert inner.mean() > 0.7
  right = (distance < 0.01)[:, inner][flows.visible[:, inner]]
  assert right.mean() > 0.985
  assert 0.3 < flows.visible.mean() < 0.7  # one to three of the six faces


def test_visible_flow_is_the_projection(tilted_box):
  index, _, views, cameras, flows = tilted_box
  size = views.depth.shape[-1]
  for v, camera in enumerate(cameras):
    pixel, _ = project(index_to_world(index.astype(float)), camera)
    off = np.linalg.norm(flows.flow[v] * size - pixel, axis=-1)[flows.visible[v]]
    assert (off < 1e-4).mean() > 0.7
    assert off.max() < 1.5 * np.sqrt(2) + 1e-4  # past outlines, and where it is steep
  assert flows.flow.min() >= 0
  assert flows.flow.max() <= 1


def test_occluded_voxels_find_their_colour_where_the_view_has_it(tilted_box):
  _, color, views, _, flows = tilted_box
  pixels = landed(views.rgba, flows.flow)[..., :3].astype(float)
  distance = np.linalg.norm(pixels - color, axis=-1) / 255
  for v in range(len(distance)):
    seen = np.unique(views.rgba[v][views.rgba[v, ..., 3] > 0][:, :3], axis=0).astype(float)
    least = np.linalg.norm(seen[:, None] - color, axis=-1).min(0) / 255
    hidden = ~flows.visible[v]
    assert (distance[v] <= np.maximum(least, 0.1) + 1e-6)[hidden].all()


def test_statistics_agree_with_the_flows(tilted_box):
  _, color, views, _, (flow, visible, stats) = tilted_box
  distance = np.linalg.norm(landed(views.rgba, flow)[..., :3].astype(float) - color, axis=-1) / 255
  np.testing.assert_allclose(stats.visible + stats.matched + stats.fallback, 1)
  np.testing.assert_allclose(stats.visible, visible.mean())
  np.testing.assert_allclose(stats.error, distance.mean(), rtol=1e-3)
  np.testing.assert_allclose(stats.visible_error, distance[visible].mean(), rtol=1e-3)
  np.testing.assert_allclose(stats.visible_faithful, (distance[visible] < 0.1).mean(), rtol=1e-3)


def test_what_is_visible_of_a_box_from_the_front():
  index, _, _, _, flows = made(trimesh.creation.box((0.5, 0.7, 0.3)), azimuths=[0])
  front = index[:, 2] == index[:, 2].max()
  assert flows.visible[0][front].all()
  assert not flows.visible[0][index[:, 2] < index[:, 2].max() - 2].any()


def test_a_wider_tolerance_sees_more(tilted_box):
  index, color, views, cameras, flows = tilted_box
  rgba, depth = views
  wide = target_flows(index, color, rgba[:1], depth[:1], cameras[:1], tolerance=2.0)
  assert (wide.visible >= flows.visible[:1]).all()
  assert wide.visible.sum() > flows.visible[0].sum()


# By hand: an image of 5 x 5 pixels before the camera at azimuth 0, all of it nearer than any voxel
# unless the test says otherwise.

CAMERA = camera_at(0, image_size=5)
GREY = (128, 128, 128)


def canvas(pixels, depth=1.0):
  """Views and depths of one view from {(row, column): colour}, the rest is background."""
  rgba, depths = np.zeros((1, 5, 5, 4), np.uint8), np.full((1, 5, 5), np.inf, np.float32)
  for at, color in pixels.items():
    rgba[(0, *at)] = (*color, 255)
    depths[(0, *at)] = depth
  return rgba, depths


def one(voxel, color, pixels, depth=1.0, grid_size=16, **options):
  """Where the flow of one voxel points, (row, column) continuous, and whether it is visible."""
  flows = target_flows(
    np.array([voxel]),
    np.array([color], np.uint8),
    *canvas(pixels, depth),
    [CAMERA],
    grid_size=grid_size,
    **options,
  )
  u, v = flows.flow[0, 0] * 5
  return (v, u), flows.visible[0, 0], flows.stats


def test_the_closest_of_the_similar_pixels():
  # The voxel projects to the middle; the middle itself is not of its colour.
  pixels = {(2, 2): (255, 0, 0), (0, 0): GREY, (2, 4): (130, 126, 128), (4, 4): GREY}
  at, visible, stats = one((8, 8, 8), GREY, pixels)
  assert not visible
  np.testing.assert_allclose(at, (2.5, 4.5), rtol=1e-6)
  assert (stats.visible, stats.matched, stats.fallback) == (0, 1, 0)


def test_the_most_similar_pixel_where_none_is_similar():
  pixels = {(2, 2): (255, 0, 0), (0, 0): (128, 128, 200), (4, 4): (128, 128, 200)}
  at, visible, stats = one((9, 7, 8), GREY, pixels)  # right of the middle, and below it
  assert not visible
  np.testing.assert_allclose(at, (4.5, 4.5), rtol=1e-6)
  assert (stats.visible, stats.matched, stats.fallback) == (0, 0, 1)


def test_similarity_is_an_argument():
  pixels = {(2, 3): (128, 128, 178), (0, 0): GREY}
  near, _, _ = one((8, 8, 8), GREY, pixels, similarity=0.2)
  far, _, _ = one((8, 8, 8), GREY, pixels, similarity=0.19)
  np.testing.assert_allclose([*near, *far], [2.5, 3.5, 0.5, 0.5], rtol=1e-6)


def test_a_centre_past_the_outline_is_visible_at_the_neighbour():
  depth = project(index_to_world(np.array([8, 8, 8]), size=16), CAMERA)[1]
  at, visible, _ = one((8, 8, 8), GREY, {(2, 3): (0, 0, 255)}, depth)
  assert visible
  np.testing.assert_allclose(at, (2.5, 3.5), rtol=1e-6)
  _, visible, _ = one((8, 8, 8), GREY, {(2, 4): (0, 0, 255)}, depth)  # two pixels away
  assert not visible
  _, visible, _ = one((8, 8, 8), GREY, {(2, 3): (0, 0, 255)}, depth - 0.1)  # 1.6 voxels nearer
  assert not visible


def test_what_is_hidden_is_not_visible_at_a_neighbour():
  depth = project(index_to_world(np.array([8, 8, 8]), size=16), CAMERA)[1]
  rgba, depths = canvas({(2, 2): (0, 0, 0), (2, 3): GREY}, depth)
  depths[0, 2, 2] = 1
  flows = target_flows(
    np.array([[8, 8, 8]]), np.array([GREY]), rgba, depths, [CAMERA], grid_size=16
  )
  assert not flows.visible[0, 0]


def test_the_occluded_rule_against_brute_force():
  rng = np.random.default_rng(0)
  size, count = 24, 400
  cameras = [camera_at(a, image_size=size) for a in (0, 60)]
  index = rng.integers(16, 48, (count, 3))
  palette = rng.integers(0, 256, (60, 3))
  color = palette[rng.integers(0, 60, count)].astype(np.uint8)
  rgba = np.full((2, size, size, 4), 255, np.uint8)
  rgba[..., :3] = palette[rng.integers(0, 40, (2, size, size))]  # 20 colours are not there
  depth = np.where(rng.uniform(size=(2, size, size)) < 0.7, 1.0, np.inf).astype(np.float32)
  flows = target_flows(index, color, rgba, depth, cameras)
  assert not flows.visible.any()
  fallbacks = 0
  for v, camera in enumerate(cameras):
    row, column = np.nonzero(np.isfinite(depth[v]))
    centers = np.stack([column, row], -1) + 0.5
    seen = rgba[v, row, column, :3] / 255
    pixel, _ = project(index_to_world(index.astype(float)), camera)
    for i in range(count):
      distance = np.linalg.norm(seen - color[i] / 255, axis=-1)
      similar = distance <= 0.1
      if not similar.any():
        fallbacks += 1
        similar = distance <= distance.min() + 1e-9
      reach = np.linalg.norm(centers - pixel[i], axis=-1)
      chosen = np.abs(centers - flows.flow[v, i] * size).max(1).argmin()
      assert similar[chosen]
      np.testing.assert_allclose(reach[chosen], reach[similar].min(), atol=1e-3)
  assert fallbacks > 50
  np.testing.assert_allclose(flows.stats.fallback, fallbacks / (2 * count))


def test_a_voxel_out_of_the_frame_is_occluded():
  # A camera this close sees only the middle of the cube.
  camera = camera_at(0, image_size=5)._replace(T=np.array([0, 0, 0.8]))
  rgba, depth = canvas({(r, c): GREY for r in range(5) for c in range(5)}, 0.3)
  flows = target_flows(
    np.array([[0, 8, 15], [15, 0, 15]]), np.array([GREY] * 2), rgba, depth, [camera], grid_size=16
  )
  assert not flows.visible.any()
  np.testing.assert_allclose(flows.flow[0, 0, 0], 0.1, rtol=1e-6)
  np.testing.assert_allclose(flows.flow[0, 1], [0.9, 0.9], rtol=1e-6)


def test_bad_input():
  rgba, depth = canvas({(2, 2): GREY})
  index, color = np.zeros((3, 3), np.uint8), np.zeros((3, 3), np.uint8)
  with pytest.raises(ValueError, match='cameras'):
    target_flows(index, color, rgba, depth, [CAMERA, CAMERA])
  with pytest.raises(ValueError, match='colours'):
    target_flows(index, color[:2], rgba, depth, [CAMERA])
  with pytest.raises(ValueError, match='empty'):
    target_flows(index, color, rgba, np.full_like(depth, np.inf), [CAMERA])
