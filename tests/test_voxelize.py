"""Voxels against exact distances, floods, rods and known colours."""

import numpy as np
import pytest
import scipy.ndimage
import trimesh
from scipy.spatial.transform import Rotation
from solids import textured

from cvn.errors import UserError
from cvn.grid import GRID_SIZE, index_to_world
from datagen.benchmark import lumpy_ball
from datagen.geometry.mesh import TexturedMesh, normalize
from datagen.geometry.voxelize import voxelize

FAR = 0.5  # voxels: no occupied centre is farther from the surface
NEAR = 0.5 / np.sqrt(3)  # every centre nearer than this is occupied
SLACK = 1e-4  # voxels: the tie-breaking shift, in docstring and code 1e-6 of the size
CENTERS = index_to_world(np.moveaxis(np.indices((GRID_SIZE,) * 3), 0, -1))


def turned(mesh, seed):
  """A mesh turned at random about the origin and shifted by less than a voxel."""
  rng = np.random.default_rng(seed)
  rotation = Rotation.random(random_state=seed).as_matrix()
  shift = rng.uniform(-0.5, 0.5, 3) / GRID_SIZE
  vertices = mesh.vertices @ rotation.T + shift
  return trimesh.Trimesh(vertices, mesh.faces, process=False), rotation, shift


def occupied(mesh, size=GRID_SIZE):
  index, *_ = voxelize(mesh if isinstance(mesh, TexturedMesh) else textured(mesh), size)
  grid = np.zeros((size,) * 3, bool)
  grid[tuple(index.T)] = True
  return grid


def outside(grid):
  """What a flood in steps to face neighbours reaches from beyond the grid."""
  labels, _ = scipy.ndimage.label(~np.pad(grid, 1))
  return (labels == labels[0, 0, 0])[1:-1, 1:-1, 1:-1]


def box_distance(points, half):
  """Signed distance to a box about the origin, below 0 inside."""
  q = np.abs(points) - half
  return np.linalg.norm(np.maximum(q, 0), axis=-1) + np.minimum(q.max(-1), 0)


@pytest.mark.parametrize('radius', [0.05, 0.2, 0.43])
def test_sphere_lies_within_its_stated_distances(radius):
  ball = trimesh.creation.icosphere(subdivisions=4, radius=radius)
  flatness = radius * GRID_SIZE * 2e-3  # how far the fine polyhedron is from the sphere, at most
  distance = np.abs(np.linalg.norm(CENTERS, axis=-1) - radius) * GRID_SIZE
  grid = occupied(ball)
  assert distance[grid].max() <= FAR + SLACK + flatness
  assert grid[distance <= NEAR - SLACK - flatness].all()


@pytest.mark.parametrize('seed', range(5))
def test_tilted_box_lies_within_its_stated_distances(seed):
  half = np.array([0.31, 0.17, 0.08])
  box, rotation, shift = turned(trimesh.creation.box(2 * half), seed)
  distance = np.abs(box_distance((CENTERS - shift) @ rotation, half)) * GRID_SIZE
  grid = occupied(box)
  assert distance[grid].max() <= FAR + SLACK
  assert grid[distance <= NEAR - SLACK].all()


@pytest.mark.parametrize('seed', range(5))
def test_a_face_without_height_is_its_edge(seed):
  """Occupied is every centre within half a voxel, whichever way the needle points."""
  rng = np.random.default_rng(seed)
  start, end = rng.uniform(-0.4, 0.4, (2, 3))
  across = np.cross(end - start, rng.standard_normal(3))
  apex = (start + end) / 2 + 1e-9 * across / np.linalg.norm(across)
  along = end - start
  t = np.clip((CENTERS - start) @ along / (along @ along), 0, 1)
  distance = np.linalg.norm(CENTERS - start - t[..., None] * along, axis=-1) * GRID_SIZE
  grid = occupied(trimesh.Trimesh([start, end, apex], [[0, 1, 2]], process=False))
  assert distance[grid].max() <= np.sqrt(0.5) + SLACK  # of a rod, where no centre is as near
  assert grid[distance <= FAR - SLACK].all()


@pytest.mark.parametrize('cuts', [0, 3, 6])
@pytest.mark.parametrize('seed', range(3))
def test_sheet_is_one_layer(seed, cuts):
  """Far from its rim a sheet holds the centres within cos(b) / 2, however finely it is cut."""
  sheet = trimesh.Trimesh(
    [[-0.3, -0.3, 0], [0.3, -0.3, 0], [0.3, 0.3, 0], [-0.3, 0.3, 0]], [[0, 1, 2], [0, 2, 3]]
  )
  for _ in range(cuts):
    sheet = sheet.subdivide()
  sheet, rotation, shift = turned(sheet, seed)
  local = (CENTERS - shift) @ rotation
  inner = np.abs(local[..., :2]).max(-1) < 0.28
  distance = np.abs(local[..., 2]) * GRID_SIZE
  limit = np.abs(rotation[:, 2]).max() / 2
  grid = occupied(sheet)
  assert grid[inner & (distance < limit - SLACK)].all()
  assert not grid[inner & (distance > limit + SLACK)].any()
  # Which is a single voxel in each row along the axis nearest to the normal.
  axis = np.abs(rotation[:, 2]).argmax()
  rows = (inner & (distance < 0.6)).any(axis) & ~(~inner & (distance < 0.6)).any(axis)
  assert rows.sum() > 500
  assert (grid.sum(axis)[rows] == 1).all()


@pytest.mark.parametrize('seed', range(6))
@pytest.mark.parametrize('half', [(0.3, 0.2, 0.25), (0.4, 0.3, 0.03)])
def test_no_flood_enters_a_closed_box(half, seed):
  box, rotation, shift = turned(trimesh.creation.box(2 * np.array(half)), seed)
  grid = occupied(box)
  inner = box_distance((CENTERS - shift) @ rotation, np.array(half)) * GRID_SIZE < -FAR - SLACK
  assert inner.any()
  assert not (outside(grid) & inner).any()


@pytest.mark.parametrize('seed', range(4))
@pytest.mark.parametrize('faces', [200, 20000])
def test_no_flood_enters_a_lumpy_ball(faces, seed):
  mesh = lumpy_ball(faces, 1)
  rotation = Rotation.random(random_state=seed).as_matrix()
  grid = occupied(normalize(mesh._replace(vertices=mesh.vertices @ rotation.T)))
  flooded = outside(grid)
  assert not flooded[31:33, 31:33, 31:33].any()
  assert (~flooded & ~grid).sum() > 20000  # it is all of the inside


@pytest.mark.parametrize('subdivisions', [1, 4])
def test_no_flood_enters_a_closed_ball(subdivisions):
  ball = trimesh.creation.icosphere(subdivisions=subdivisions, radius=0.4)
  assert not outside(occupied(ball))[32, 32, 32]


def test_axis_aligned_box_is_one_voxel_thick_and_keeps_the_margin():
  mesh = normalize(textured(trimesh.creation.box((1, 1, 1))))
  grid = occupied(mesh)
  expected = np.zeros_like(grid)
  expected[1:-1, 1:-1, 1:-1] = True
  expected[2:-2, 2:-2, 2:-2] = False
  np.testing.assert_array_equal(grid, expected)


@pytest.mark.parametrize('thickness', [0.02, 0.3, 0.9])
@pytest.mark.parametrize('seed', range(4))
def test_thin_rod_does_not_vanish(thickness, seed):
  """Every slice of voxels across a rod holds some of it, however thin it is."""
  side = thickness / GRID_SIZE
  rod, rotation, shift = turned(trimesh.creation.box((side, side, 0.9)), seed)
  grid = occupied(rod)
  direction = rotation[:, 2]
  axis = np.abs(direction).argmax()
  tips = shift[axis] + np.array([-0.44, 0.44]) * np.abs(direction[axis])
  first, last = np.floor((tips + 0.5) * GRID_SIZE).astype(int)
  assert grid.any(tuple(a for a in range(3) if a != axis))[first : last + 1].all()
  # All of it is one piece, and within the stated distance.
  assert scipy.ndimage.label(grid, np.ones((3, 3, 3)))[1] == 1
  local = (CENTERS - shift) @ rotation
  distance = np.abs(box_distance(local, np.array([side, side, 0.9]) / 2)) * GRID_SIZE
  assert distance[grid].max() <= np.sqrt(0.5) + SLACK


def test_index_is_sorted_and_unique_and_small():
  index, color, _ = voxelize(textured(trimesh.creation.icosphere(radius=0.4)), 32)
  assert index.dtype == color.dtype == np.uint8
  assert index.shape == color.shape and index.max() < 32
  flat = index.astype(int) @ [32 * 32, 32, 1]
  assert (np.diff(flat) > 0).all()


def test_points_are_the_nearest_of_the_surface():
  half = np.array([0.31, 0.17, 0.08])
  box, rotation, shift = turned(trimesh.creation.box(2 * half), 0)
  voxels = voxelize(textured(box))
  center = index_to_world(voxels.index.astype(float))
  np.testing.assert_allclose(box_distance((voxels.point - shift) @ rotation, half), 0, atol=1e-9)
  far = np.linalg.norm(voxels.point - center, axis=-1) * GRID_SIZE
  least = np.abs(box_distance((center - shift) @ rotation, half)) * GRID_SIZE
  assert far.max() <= FAR + SLACK
  # Next to an edge it may be the edge's point, by which alone the voxel is occupied.
  assert (far - least < SLACK).mean() > 0.98


def test_points_of_a_thin_rod_are_beside_their_voxels():
  """A rod between the centres of four rows of voxels, which no centre is within half a voxel of."""
  side = 0.02 / GRID_SIZE
  voxels = voxelize(textured(trimesh.creation.box((side, side, 0.9))))
  center = index_to_world(voxels.index.astype(float))
  far = np.linalg.norm(voxels.point - center, axis=-1) * GRID_SIZE
  assert far.max() <= np.sqrt(0.5) + SLACK


def test_subdividing_faces_changes_colors_little():
  """Same surface, other triangles: the same colours on the voxels that both have."""
  coarse = trimesh.creation.box((0.9, 0.7, 0.5))
  fine = coarse.subdivide().subdivide().subdivide()
  pairs = []
  for box in (coarse, fine):
    box.visual.vertex_colors = np.column_stack([box.vertices + 0.5, np.ones(len(box.vertices))])
    index, color, _ = voxelize(textured(box))
    pairs.append({tuple(i): c.astype(int) for i, c in zip(index, color, strict=True)})
  shared = pairs[0].keys() & pairs[1].keys()
  assert len(shared) > 0.95 * len(pairs[0])
  assert max(np.abs(pairs[0][i] - pairs[1][i]).max() for i in shared) <= 4


def test_faces_of_a_box_have_their_colors():
  box = trimesh.creation.box((0.9, 0.9, 0.9))
  palette = {k: [200 * (k[0] + 1) // 2, 90 * (k[1] + 1), 120 * (k[2] + 1), 255] for k in SIDES}
  box.visual.face_colors = [palette[tuple(np.rint(n).astype(int))] for n in box.face_normals]
  index, color, _ = voxelize(textured(box))
  position = index_to_world(index.astype(float))
  for side, expected in palette.items():
    axis = np.flatnonzero(side)[0]
    others = np.delete(position, axis, 1)
    # Away from the edges, where two colours meet in a voxel.
    of_side = (position[:, axis] * side[axis] > 0.4) & (np.abs(others) < 0.42).all(-1)
    assert of_side.sum() > 2000
    assert (color[of_side] == expected[:3]).all()


SIDES = [(s, 0, 0) for s in (-1, 1)] + [(0, s, 0) for s in (-1, 1)] + [(0, 0, s) for s in (-1, 1)]


def quad(image, tiles=1, half=0.45, z=0.003):
  """A square facing +z with an image on it `tiles` times each way."""
  vertices = np.array([[-half, -half, z], [half, -half, z], [half, half, z], [-half, half, z]])
  faces = np.array([[0, 1, 2], [0, 2, 3]])
  uv = tiles * np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
  return TexturedMesh(
    vertices,
    faces,
    np.ones((2, 3, 4), np.float32),
    uv[faces],
    np.zeros(2, np.int32),
    (np.asarray(image, np.uint8),),
  )


def opaque(rgb):
  rgb = np.asarray(rgb)
  return np.concatenate([rgb, np.full_like(rgb[..., :1], 255)], -1).astype(np.uint8)


def test_fine_checkerboard_averages_to_grey():
  board = 255 * (np.indices((8, 8)).sum(0) % 2)
  index, color, _ = voxelize(quad(opaque(np.repeat(board[..., None], 3, -1)), tiles=64))
  inner = (np.abs(index_to_world(index.astype(float))[:, :2]) < 0.43).all(-1)
  values = color[inner].astype(float)
  assert abs(values.mean() - 127.5) < 1
  assert values.std() < 45  # 16 or more independent points each would have 128 / 4


def test_coarse_checkerboard_keeps_its_squares_and_repeats():
  """Two by two tiles, 2 x 2 texels each: squares of an eighth and more of the side."""
  board = np.zeros((32, 32, 3))
  board[:16, :16] = board[16:, 16:] = [250, 10, 30]
  index, color, _ = voxelize(quad(opaque(board), tiles=2))
  u, v = ((index_to_world(index.astype(float))[:, :2] + 0.45) / 0.9 * 2).T
  clear = (np.abs(u * 2 - np.rint(u * 2)) > 0.15) & (np.abs(v * 2 - np.rint(v * 2)) > 0.15)
  # Row 0 is the top, v = 1: red is where u is in the left half and v in the upper, or neither.
  red = (u % 1 < 0.5) == (v % 1 > 0.5)
  assert (color[clear & red] == [250, 10, 30]).all() and (clear & red).sum() > 500
  assert (color[clear & ~red] == 0).all() and (clear & ~red).sum() > 500


def sheets(*parts):
  """Rectangles facing +z, each (left, right, z, colour), from y = -0.4 to 0.4; two faces each."""
  vertices = [
    (x, y, z) for a, b, z, _ in parts for x, y in ((a, -0.4), (b, -0.4), (b, 0.4), (a, 0.4))
  ]
  faces = np.concatenate([4 * i + np.array([[0, 1, 2], [0, 2, 3]]) for i in range(len(parts))])
  colors = np.repeat([[*color, 1] for *_, color in parts], 2, 0)
  return TexturedMesh(
    np.array(vertices, float),
    faces,
    np.repeat(colors[:, None], 3, 1).astype(np.float32),
    np.zeros((len(faces), 3, 2), np.float32),
    np.full(len(faces), -1, np.int32),
    (),
  )


RED, WHITE = (1, 0, 0), (1, 1, 1)


@pytest.mark.parametrize('share', [0.3, 0.7])
def test_at_a_border_the_larger_colour_wins(share):
  """Red up to `share` of the voxels of column 40."""
  border = (40 + share) / GRID_SIZE - 0.5
  mesh = sheets((-0.4, border, 0.003, RED), (border, 0.4, 0.003, WHITE))
  index, color, _ = voxelize(mesh)
  red = index[:, 0] < (41 if share > 0.5 else 40)
  assert (color[red] == [255, 0, 0]).all() and red.sum() > 500
  assert (color[~red] == 255).all() and (~red).sum() > 500


def test_what_no_view_shows_counts_only_where_nothing_else_is():
  """White over red, within one layer of voxels; the red sheet, twice, is the wider one."""
  mesh = sheets((-0.2, 0.2, 0.009, WHITE), (-0.4, 0.4, 0.005, RED), (-0.4, 0.4, 0.004, RED))
  index, color, _ = voxelize(mesh, seen=np.array([True] * 2 + [False] * 4))
  x = index_to_world(index.astype(float))[:, 0]
  assert len(index) == len(np.unique(index[:, :2], axis=0))
  assert (color[np.abs(x) < 0.19] == 255).all()
  assert (color[np.abs(x) > 0.21] == [255, 0, 0]).all()
  _, color, _ = voxelize(mesh)
  assert (color == [255, 0, 0]).all()


def test_cut_out_is_no_surface_and_glass_is():
  image = opaque(np.full((32, 32, 3), 90))
  image[:, 8:24, 3] = 0
  mesh = quad(image)
  index, *_ = voxelize(mesh)
  x = np.abs(index_to_world(index.astype(float))[:, 0])
  assert x.min() > 0.2 and x.max() > 0.43  # the hole is 0.45 wide
  glass = mesh._replace(corner_colors=mesh.corner_colors * np.float32([1, 1, 1, 0.2]))
  np.testing.assert_array_equal(voxelize(glass)[0], index)


@pytest.mark.parametrize('seed', range(3))
def test_every_voxel_has_a_color_of_the_surface(seed):
  """Also at the rim, where a voxel may hold too little of the surface to be sampled."""
  image = opaque(np.zeros((64, 64, 3)))
  image[:, :32, 0] = 255
  mesh = quad(image, half=0.3)
  rotation = Rotation.random(random_state=seed).as_matrix()
  mesh = mesh._replace(vertices=mesh.vertices @ rotation.T)
  index, color, _ = voxelize(mesh)
  x = (index_to_world(index.astype(float)) @ rotation)[:, 0]
  # Voxels at the colours' border, and at the image's two ends, which blend as it repeats.
  clear = (np.abs(x) > 0.02) & (np.abs(x) < 0.28)
  expected = np.where(x[:, None] < 0, [[255, 0, 0]], [[0, 0, 0]])
  assert (color[clear] == expected[clear]).all()
  assert (color[:, 1:] == 0).all()


def test_parts_outside_the_cube_are_cut_off():
  box = trimesh.creation.box((3, 0.4, 0.4))
  grid = occupied(box)
  assert grid[0].any() and grid[-1].any()
  assert not grid[10, 30:34, 30:34].any()


def test_chunks_do_not_change_the_result(monkeypatch):
  knot = trimesh.creation.torus(0.3, 0.1)
  knot.visual.vertex_colors = np.column_stack([knot.vertices + 0.5, np.ones(len(knot.vertices))])
  mesh = textured(knot)
  index, color, _ = voxelize(mesh)
  monkeypatch.setattr('datagen.geometry.voxelize.CHUNK', 1000)
  other_index, other_color, _ = voxelize(mesh)
  np.testing.assert_array_equal(index, other_index)
  assert np.abs(color.astype(int) - other_color).max() <= 3


def test_errors():
  mesh = textured(trimesh.creation.box((0.5, 0.5, 0.5)))
  with pytest.raises(ValueError, match='256'):
    voxelize(mesh, 256)
  with pytest.raises(UserError, match='no visible surface'):
    voxelize(mesh._replace(vertices=mesh.vertices + 5))
