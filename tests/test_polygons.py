"""Polygons that are not convex keep their shape when they are cut into triangles."""

import numpy as np
import pytest

from datagen.reading import read_mesh
from datagen.reading.files import folder_files
from datagen.reading.polygons import MAX_CORNERS, cut, cut_mixed, triangulate

L = [(0, 0), (3, 0), (3, 1), (1, 1), (1, 3), (0, 3)]
ARROW = [(0, 0), (2, -1), (0, 3), (-2, -1)]
# A square with a square hole, which two edges in one place join to the outline.
RING = [(0, 0), (4, 0), (4, 4), (0, 4), (0, 0), (1, 1), (1, 3), (3, 3), (3, 1), (1, 1)]


def area(points):
  x, y = np.asarray(points, float).T
  return 0.5 * (x @ np.roll(y, -1) - y @ np.roll(x, -1))


def signed_areas(points, triangles):
  return np.array([area(np.asarray(points, float)[list(t)]) for t in triangles])


@pytest.mark.parametrize(('points', 'expected'), [(L, 5), (ARROW, 6), (RING, 12)])
@pytest.mark.parametrize('first', range(10))
def test_known_polygons(points, expected, first):
  """Positive areas whose sum is the polygon's: nothing is covered twice or outside."""
  points = np.roll(points, first, axis=0)
  triangles = triangulate(points.astype(float))
  areas = signed_areas(points, triangles)
  assert len(triangles) == len(points) - 2
  assert (areas > -1e-9).all()
  np.testing.assert_allclose(areas.sum(), expected)


def test_random_polygons():
  rng = np.random.default_rng(0)
  for _ in range(100):
    n = rng.integers(4, 30)
    angle = np.sort(rng.uniform(0, 2 * np.pi, n))
    angle = (angle + np.arange(n) * 2 * np.pi / n) / 2  # no gap of half a turn
    points = rng.uniform(0.1, 1, (n, 1)) * np.stack([np.cos(angle), np.sin(angle)], 1)
    areas = signed_areas(points, triangulate(points))
    assert (areas > -1e-12).all()
    np.testing.assert_allclose(areas.sum(), area(points))


def test_a_polygon_that_crosses_itself_is_cut_somehow():
  star = [(np.cos(a), np.sin(a)) for a in 4 * np.pi / 5 * np.arange(5)]
  for points in (star, [(0, 0), (1, 1), (1, 0), (0, 1)], [(0, 0)] * 6):
    triangles = triangulate(np.array(points, float))
    assert len(triangles) == len(points) - 2
    assert all(len(set(t)) == 3 for t in triangles)


def tilted(polygon):
  """[N, 3] of a polygon tilted in space."""
  tilt = np.array([[0.6, 0.0, 0.8], [0.48, 0.8, -0.36]])
  return np.asarray(polygon) @ tilt + [5, 6, 7]


def area_of(points, triangles):
  a, b, c = (points[triangles[:, k]] for k in range(3))
  return np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2


def fan(n):
  return [[0, k, k + 1] for k in range(1, n - 1)]


@pytest.mark.parametrize(('points', 'expected'), [(L, 5), (ARROW, 6), (RING, 12)])
@pytest.mark.parametrize('mirrored', [False, True])
def test_polygons_in_space_keep_their_area(points, expected, mirrored):
  for first in range(len(points)):
    polygon = tilted(np.roll(points, first, axis=0) * [-1 if mirrored else 1, 1])
    of, corner = cut(polygon[None])
    assert (of == 0).all()
    np.testing.assert_allclose(area_of(polygon, corner), expected)


def test_only_those_that_need_it_are_cut_otherwise():
  square = [(0, 0), (1, 0), (1, 1), (0, 1)]
  bent = np.roll(ARROW, 1, axis=0)  # its first corner does not see the one opposite
  of, corner = cut(np.stack([tilted(square), tilted(bent), tilted(ARROW)]))
  assert of.tolist() == [0, 0, 1, 1, 2, 2]
  assert corner.tolist() == [*fan(4), [1, 2, 3], [1, 3, 0], *fan(4)]


@pytest.mark.parametrize(
  'points',
  [
    tilted([(1, 0), (2, 1), (2, 2), (0, 2), (0, 1)]),
    np.array([[0, 0, 0], [np.nan, 0, 0], [1, 1, 0], [0, 1, 0]]),
    np.zeros((6, 3)),
  ],
)
def test_what_needs_no_cut_or_allows_none_is_a_fan(points):
  assert cut(points[None])[1].tolist() == fan(len(points))


def test_huge_polygons_are_fans():
  radius = np.resize([1, 0.2], MAX_CORNERS + 2)
  angle = np.linspace(0, 2 * np.pi, len(radius), endpoint=False)
  star = radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], 1)
  assert cut(tilted(star)[None])[1].tolist() == fan(len(star))


def test_polygons_of_several_kinds_keep_their_order():
  vertices = np.concatenate([tilted(L), tilted(np.add(L, 10))])
  polygons = [
    (np.array([3, 7]), np.array([[0, 1, 2], [6, 7, 8]])),
    (np.array([2, 5]), np.stack([np.arange(6), np.arange(6) + 6])),
  ]
  place, corner = cut_mixed(vertices, polygons)
  assert place.tolist() == [2] * 4 + [3] + [5] * 4 + [7]
  assert corner[4].tolist() == corner[9].tolist() == [0, 1, 2]
  np.testing.assert_allclose(area_of(vertices, corner[:4]), 5)


PLY = """ply
format ascii 1.0
element vertex 10
property double x
property double y
property double z
element face 1
property list uchar int vertex_indices
end_header
"""


@pytest.mark.parametrize('kind', ['obj', 'ply', 'off'])
def test_meshes_are_read_this_way(tmp_path, kind):
  points = ['{} {} {}'.format(*p) for p in tilted(RING)]
  rows = '\n'.join(points)
  content = {
    'obj': '\n'.join([f'v {p}' for p in points] + ['f -10 -9 -8 -7 -6 -5 -4 -3 -2 -1']),
    'ply': f'{PLY}{rows}\n10 0 1 2 3 4 5 6 7 8 9\n',
    'off': f'OFF\n10 1 0\n{rows}\n10 0 1 2 3 4 5 6 7 8 9\n',
  }[kind]
  (tmp_path / f'a.{kind}').write_text(content)
  mesh = read_mesh(folder_files(str(tmp_path)), f'a.{kind}')
  np.testing.assert_allclose(area_of(mesh.vertices, mesh.faces), 12)
