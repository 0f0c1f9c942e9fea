import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from cvn.camera import AZIMUTHS, camera_at, project
from cvn.data import composite
from cvn.grid import index_to_world
from cvn.sampler import bilinear, nearest
from datagen.geometry.flow import sampling_error, target_flows
from datagen.geometry.mesh import TexturedMesh
from datagen.geometry.render import render
from datagen.geometry.voxelize import voxelize

COLORS = np.array(
  [[0.9, 0.1, 0.1], [0.1, 0.9, 0.1], [0.1, 0.1, 0.9], [0.9, 0.9, 0.1], [0.9, 0.1, 0.9], [0.1] * 3]
)


def made(mesh, azimuths=AZIMUTHS, size=128, **options):
  """Voxels, views, cameras, target flows of a trimesh whose faces have colours by their normals."""
  normals = np.round(mesh.face_normals @ np.linalg.inv(mesh.metadata.get('turn', np.eye(3)).T))
  side = np.abs(normals).argmax(1) + 3 * (normals.sum(1) > 0)
  corners = np.ones((len(mesh.faces), 3, 4), np.float32)
  corners[..., :3] = COLORS[side][:, None]
  blank = np.zeros((len(mesh.faces), 3, 2), np.float32)
  none = np.full(len(mesh.faces), -1, np.int32)
  ours = TexturedMesh(np.array(mesh.vertices), np.array(mesh.faces), corners, blank, none, ())
  cameras = [camera_at(a, image_size=size) for a in azimuths]
  views = render(ours, cameras, image_size=size)
  voxels = voxelize(ours)
  flows = target_flows(voxels.point, voxels.color, views.rgba, views.depth, cameras, **options)
  return voxels, views, cameras, flows


TURN = Rotation.from_euler('xyz', [20, 35, 10], degrees=True).as_matrix()


@pytest.fixture(scope='module')
def tilted_box():
  mesh = trimesh.creation.box((0.7, 0.5, 0.4))
  mesh.apply_transform(np.block([[TURN, np.zeros((3, 1))], [np.zeros((1, 3)), 1]]))
  mesh.metadata['turn'] = TURN
  return made(mesh)


def landed(rgba, flow):
  """The colours [V, S, 3] of the pixels that flows point at."""
  size = np.array(rgba.shape[2:0:-1])
  column, row = np.moveaxis(np.minimum((flow * size).astype(int), size - 1), -1, 0)
  return rgba[np.arange(len(rgba))[:, None], row, column]


def test_the_flow_of_a_visible_voxel_fetches_its_colour(tilted_box):
  voxels, views, _, flows = tilted_box
  size = views.depth.shape[-1]
  # At the box's edges a voxel has two faces' colours, and a view may show the smaller one only.
  gap = np.sort(np.array([0.35, 0.25, 0.2]) - np.abs(voxels.point @ TURN))[:, 1]
  pure = gap * 64 > (1 + np.sqrt(3)) / 2  # nothing that far from its point is in the voxel
  assert pure.mean() > 0.8
  right = []
  for view, flow, visible in zip(views.rgba, flows.flow, flows.visible, strict=True):
    right.append(sampling_error(view, flow * size, voxels.color)[visible & pure] < 0.1)
  assert np.concatenate(right).mean() > 0.98  # not all: next to an edge, of the face behind it
  assert 0.25 < flows.visible.mean() < 0.7  # one to three of the six faces


def test_visible_flow_is_the_projection_or_the_closest_right_pixel_around(tilted_box):
  voxels, views, cameras, flows = tilted_box
  size = views.depth.shape[-1]
  moved, stuck = 0, 0
  for v, camera in enumerate(cameras):
    visible = flows.visible[v]
    pixel, distance = (x[visible] for x in project(voxels.point, camera))
    color, flow = voxels.color[visible].astype(float), flows.flow[v, visible] * size
    off = np.linalg.norm(flow - pixel, axis=-1)
    assert off.max() < 1.5 * np.sqrt(2) + 1e-4
    wrong = sampling_error(views.rgba[v], pixel, color) > 0.1
    np.testing.assert_allclose(off[~wrong], 0, atol=1e-4)
    for i in np.flatnonzero(wrong):
      column, row = np.floor(pixel[i]).astype(int)
      reach = [
        np.hypot(c + 0.5 - pixel[i, 0], r + 0.5 - pixel[i, 1])
        for r in range(row - 1, row + 2)
        for c in range(column - 1, column + 2)
        if abs(views.depth[v, r, c] - distance[i]) <= 1 / 64
        and np.linalg.norm(views.rgba[v, r, c, :3] - color[i]) <= 25.5
      ]
      np.testing.assert_allclose(off[i], min(reach, default=0), atol=1e-4)
      moved, stuck = moved + bool(reach), stuck + (not reach)
  assert moved > 100 and stuck > 10
  assert flows.flow.min() >= 0
  assert flows.flow.max() <= 1


def test_occluded_voxels_find_their_colour_where_the_view_has_it(tilted_box):
  voxels, views, _, flows = tilted_box
  color = voxels.color
  pixels = landed(views.rgba, flows.flow)[..., :3].astype(float)
  distance = np.linalg.norm(pixels - color, axis=-1) / 255
  for v in range(len(distance)):
    seen = np.unique(views.rgba[v][views.rgba[v, ..., 3] > 0][:, :3], axis=0).astype(float)
    least = np.linalg.norm(seen[:, None] - color, axis=-1).min(0) / 255
    hidden = ~flows.visible[v]
    assert (distance[v] <= np.maximum(least, 0.1) + 1e-6)[hidden].all()


def test_statistics_agree_with_the_flows(tilted_box):
  voxels, views, _, (flow, visible, stats) = tilted_box
  size = views.depth.shape[-1]
  error = np.stack(
    [sampling_error(a, b * size, voxels.color) for a, b in zip(views.rgba, flow, strict=True)]
  )
  np.testing.assert_allclose(stats.visible + stats.matched + stats.fallback, 1)
  np.testing.assert_allclose(stats.visible, visible.mean())
  np.testing.assert_allclose(stats.error, error.mean(), rtol=1e-3)
  np.testing.assert_allclose(stats.visible_error, error[visible].mean(), rtol=1e-3)
  np.testing.assert_allclose(stats.visible_faithful, (error[visible] < 0.1).mean(), rtol=1e-3)


def test_what_is_visible_of_a_box_from_the_front():
  (index, *_), _, _, flows = made(trimesh.creation.box((0.5, 0.7, 0.3)), azimuths=[0])
  front = index[:, 2] == index[:, 2].max()
  low, high = index[:, :2].min(0), index[:, :2].max(0)
  rim = ((index[:, :2] == low) | (index[:, :2] == high)).any(1)  # may just miss a pixel
  assert flows.visible[0][front & ~rim].all()
  assert not flows.visible[0][index[:, 2] < index[:, 2].max() - 2].any()


def test_a_wider_tolerance_sees_more(tilted_box):
  (_, color, point), (rgba, depth, _), cameras, flows = tilted_box
  wide = target_flows(point, color, rgba[:1], depth[:1], cameras[:1], tolerance=2.0)
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


def centers(voxels, grid_size=16):
  return index_to_world(np.array(voxels, float), size=grid_size)


def one(voxel, color, pixels, depth=1.0, grid_size=16, **options):
  """Where the flow of one voxel points, (row, column) continuous, and whether it is visible."""
  flows = target_flows(
    centers([voxel], grid_size),
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


# A voxel that projects into the middle pixel, right of its centre and above it.
PLACE, DEPTH = project(centers([8, 8, 8]), CAMERA)


def test_a_voxel_on_a_pixel_of_its_colour_keeps_its_projection():
  at, visible, stats = one((8, 8, 8), GREY, {k: GREY for k in np.ndindex(5, 5)}, DEPTH)
  assert visible
  np.testing.assert_allclose(at, PLACE[::-1], atol=1e-3)
  assert (stats.visible, stats.visible_faithful) == (1, 1)


def test_a_visible_voxel_moves_to_the_closest_right_pixel_around():
  red = (255, 0, 0)
  pixels = {k: red for k in np.ndindex(5, 5)} | {(1, 2): GREY, (2, 1): GREY, (2, 4): GREY}
  at, visible, stats = one((8, 8, 8), GREY, pixels, DEPTH)
  assert visible and stats.visible_faithful == 1
  np.testing.assert_allclose(at, (1.5, 2.5))


@pytest.mark.parametrize('right', [(2, 4), (0, 2), None])
def test_it_stays_where_no_pixel_around_is_right(right):
  pixels = {k: (255, 0, 0) for k in np.ndindex(5, 5)} | ({right: GREY} if right else {})
  at, visible, stats = one((8, 8, 8), GREY, pixels, DEPTH)
  assert visible and stats.visible_faithful == 0
  np.testing.assert_allclose(at, PLACE[::-1], atol=1e-3)


def test_it_does_not_move_to_another_surface():
  rgba, depths = canvas({k: (255, 0, 0) for k in np.ndindex(5, 5)} | {(1, 2): GREY}, DEPTH)
  depths[0, 1, 2] += 1.1 / 16
  flows = target_flows(
    centers([[8, 8, 8]]), np.array([GREY], np.uint8), rgba, depths, [CAMERA], grid_size=16
  )
  np.testing.assert_allclose(flows.flow[0, 0] * 5, PLACE, atol=1e-3)


def test_the_background_beside_a_pixel_is_kept_out():
  # The sample at the projection would be the background's by a twentieth or more.
  color = (0, 0, 0)
  at, visible, stats = one((9, 6, 8), color, {(2, 2): color}, DEPTH)
  assert visible and stats.visible_faithful == 1
  np.testing.assert_allclose(at, (2.5, 2.5))


def test_what_is_past_the_outline_or_behind_is_occluded():
  # 0.1 is 1.6 voxels.
  for pixels, depth in (({(2, 3): GREY}, DEPTH), ({(2, 2): GREY, (2, 3): GREY}, DEPTH - 0.1)):
    at, visible, _ = one((8, 8, 8), GREY, pixels, depth)
    assert not visible
    np.testing.assert_allclose(at, [p + 0.5 for p in min(pixels)])


@pytest.mark.parametrize('color, background', [((20, 0, 100), 1.0), ((200, 255, 130), 0.0)])
def test_sampling_error_against_the_samplers(color, background):
  rng = np.random.default_rng(0)
  rgba = rng.integers(0, 256, (6, 7, 4), np.uint8)
  rgba[..., 3] = 255 * (rgba[..., 3] > 100)
  pixel = rng.uniform(0, [7, 6], (200, 2))
  image = composite(rgba, background=background)[None]
  flow = (pixel / [7, 6])[None].astype(np.float32)
  error = [
    np.linalg.norm(np.asarray(sample(image, flow)[0]) - np.array(color) / 255, axis=-1)
    for sample in (bilinear, nearest)
  ]
  expected = np.maximum(*error)
  found = sampling_error(rgba, pixel, np.tile(color, (200, 1)))
  np.testing.assert_allclose(found, expected, atol=1e-4)
  assert (error[0] > error[1] + 0.01).any() and (error[1] > error[0] + 0.01).any()


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
  flows = target_flows(centers(index, 64), color, rgba, depth, cameras)
  assert not flows.visible.any()
  fallbacks = 0
  for v, camera in enumerate(cameras):
    row, column = np.nonzero(np.isfinite(depth[v]))
    middles = np.stack([column, row], -1) + 0.5
    seen = rgba[v, row, column, :3] / 255
    pixel, _ = project(centers(index, 64), camera)
    for i in range(count):
      distance = np.linalg.norm(seen - color[i] / 255, axis=-1)
      similar = distance <= 0.1
      if not similar.any():
        fallbacks += 1
        similar = distance <= distance.min() + 1e-9
      reach = np.linalg.norm(middles - pixel[i], axis=-1)
      chosen = np.abs(middles - flows.flow[v, i] * size).max(1).argmin()
      assert similar[chosen]
      np.testing.assert_allclose(reach[chosen], reach[similar].min(), atol=1e-3)
  assert fallbacks > 50
  np.testing.assert_allclose(flows.stats.fallback, fallbacks / (2 * count))


def test_a_voxel_out_of_the_frame_is_occluded():
  # A camera this close sees only the middle of the cube.
  camera = camera_at(0, image_size=5)._replace(T=np.array([0, 0, 0.8]))
  rgba, depth = canvas({(r, c): GREY for r in range(5) for c in range(5)}, 0.3)
  flows = target_flows(
    centers([[0, 8, 15], [15, 0, 15]]), np.array([GREY] * 2), rgba, depth, [camera], grid_size=16
  )
  assert not flows.visible.any()
  np.testing.assert_allclose(flows.flow[0, 0, 0], 0.1, rtol=1e-6)
  np.testing.assert_allclose(flows.flow[0, 1], [0.9, 0.9], rtol=1e-6)


def test_an_image_that_is_not_square():
  """u is a share of its width and v of its height."""
  rgba, depth = np.zeros((1, 5, 9, 4), np.uint8), np.full((1, 5, 9), np.inf, np.float32)
  rgba[0, 4, 8], depth[0, 4, 8] = (*GREY, 255), 1
  flows = target_flows(
    centers([[8, 8, 8]]), np.array([GREY], np.uint8), rgba, depth, [CAMERA], grid_size=16
  )
  np.testing.assert_allclose(flows.flow[0, 0], [8.5 / 9, 4.5 / 5], rtol=1e-6)


def test_bad_input():
  rgba, depth = canvas({(2, 2): GREY})
  point, color = np.zeros((3, 3)), np.zeros((3, 3), np.uint8)
  with pytest.raises(ValueError, match='cameras'):
    target_flows(point, color, rgba, depth, [CAMERA, CAMERA])
  with pytest.raises(ValueError, match='colours'):
    target_flows(point, color[:2], rgba, depth, [CAMERA])
  with pytest.raises(ValueError, match='empty'):
    target_flows(point, color, rgba, np.full_like(depth, np.inf), [CAMERA])
