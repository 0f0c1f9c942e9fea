"""Polygons that are not convex keep their shape when they are cut into triangles."""

import io

import numpy as np
import pytest
import trimesh

from datagen.files import folder_files
from datagen.polygons import MAX_CORNERS, cut_concave, triangulate
from datagen.reading import read_mesh

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


def obj(polygon, face=None):
  """A file with the polygon, tilted in space, as its only face, in front of a triangle."""
  tilt = np.array([[0.6, 0.0, 0.8], [0.48, 0.8, -0.36]])
  lines = ['v {} {} {}'.format(*p) for p in np.asarray(polygon) @ tilt + [5, 6, 7]]
  return '\n'.join([*lines, face or 'f ' + ' '.join(map(str, range(1, len(polygon) + 1))), ''])


def loaded_area(content):
  scene = trimesh.load_scene(io.BytesIO(content), file_type='obj', process=False)
  return scene.area


@pytest.mark.parametrize(('points', 'expected'), [(L, 5), (ARROW, 6), (RING, 12)])
@pytest.mark.parametrize('mirrored', [False, True])
def test_files_keep_the_area(points, expected, mirrored):
  for first in range(len(points)):
    polygon = np.roll(points, first, axis=0) * [-1 if mirrored else 1, 1]
    np.testing.assert_allclose(loaded_area(cut_concave(obj(polygon).encode())), expected)


def test_meshes_are_read_this_way(tmp_path):
  (tmp_path / 'a.obj').write_text(obj(RING, 'f -10 -9 -8 -7 -6 -5 -4 -3 -2 -1'))
  mesh = read_mesh(folder_files(str(tmp_path)), 'a.obj')
  a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
  np.testing.assert_allclose(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2, 12)


def test_all_else_stays():
  """Corners keep their texture coordinates and normals, faces their material and place."""
  face = 'usemtl a\nf 4/7/1 1/8/2 2//3 3\r\nusemtl b\nf 1 2 3\nf 4 1 2 3 # no'
  cut = cut_concave(obj(ARROW, face).encode()).decode()
  start = obj(ARROW, 'X').split('X')[0]
  assert cut.startswith(start)
  assert cut[len(start) :] == face.replace('4/7/1 1/8/2 2//3 3', '1/8/2 2//3 3 4/7/1') + '\n'
  cut = cut_concave(obj(L, 'usemtl a\nf 5/1 6/2 1/3 2/4 3/5 4/6\nusemtl b').encode()).decode()
  lines = cut.split('\n')[len(L) :]
  assert (lines[0], lines[5:]) == ('usemtl a', ['usemtl b', ''])
  assert all(line.startswith('f ') for line in lines[1:5])
  corners = {corner for line in lines[1:5] for corner in line.split()[1:]}
  assert corners == {'5/1', '6/2', '1/3', '2/4', '3/5', '4/6'}


@pytest.mark.parametrize(
  'content',
  [
    b'',
    b'v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n',
    obj([(0, 0), (1, 0), (1, 1), (0, 1)]).encode(),
    obj([(1, 0), (2, 1), (2, 2), (0, 2), (0, 1)]).encode(),
    obj(ARROW).encode(),  # its first corner sees all others
    obj(L, 'f 1 2 3 4 5 99').encode(),
    obj(L, 'f 1 2 3 4 5 0').encode(),
    b'v 0 0 0\nv nan 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n',
    b'v 0 0 0\nf 1 1 1 1\n',
  ],
)
def test_what_needs_no_cut_or_allows_none_stays_as_it_is(content):
  assert cut_concave(content) == content


def test_huge_polygons_are_left_alone():
  radius = np.resize([1, 0.2], MAX_CORNERS + 2)
  angle = np.linspace(0, 2 * np.pi, len(radius), endpoint=False)
  star = radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], 1)
  content = obj(np.round(star, 6)).encode()
  assert cut_concave(content) == content


def test_coordinates_that_are_none():
  with pytest.raises(ValueError):
    cut_concave(b'v a b c\nf 1 1 1 1\n')
