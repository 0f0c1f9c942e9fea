"""Cutting away what lies inside other solids."""

import importlib

import numpy as np
import pytest

from datagen.sources.shapes import cutting, materials, parts, solids


def _corners(*bodies):
  corners = np.concatenate([b.vertices[b.faces] for b in bodies])
  return corners, np.repeat(np.arange(len(bodies)), [len(b.faces) for b in bodies])


def _area(corners):
  a, b, c = np.moveaxis(corners, 1, 0)
  return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)


def test_windings_count_the_solids_around_a_point():
  corners, _ = _corners(
    solids.box((2, 2, 2)), solids.box((1, 1, 1)), solids.ellipsoid((1, 1, 1), (1, 0, 0), sides=24)
  )
  points = np.array([[0, 0, 0], [-0.4, 0.3, 0.2], [0.7, 0.6, 0], [1.5, 0, 0.1], [0, 3, 0]])
  np.testing.assert_array_equal(cutting.windings(points, corners), [2, 2, 2, 1, 0])


@pytest.mark.parametrize('axis', [0, 1, 2])
def test_windings_agree_with_an_ellipsoid_in_any_direction(axis):
  radii = np.roll([0.5, 1.0, 1.5], axis)
  corners, _ = _corners(solids.ellipsoid(radii, sides=48))
  points = np.random.default_rng(axis).uniform(-1.6, 1.6, (2000, 3))
  r = np.linalg.norm(points / radii, axis=1)
  clear = np.abs(r - 1) > 0.02  # the facets cut a little off
  np.testing.assert_array_equal(cutting.windings(points, corners)[clear], (r < 1)[clear])


def test_solids_apart_stay_as_they_are():
  corners, solid = _corners(solids.box((1, 1, 1)), solids.box((1, 1, 1), (2, 0, 0)))
  pieces = cutting.exposed(corners, solid)
  np.testing.assert_array_equal(pieces.face, np.arange(len(corners)))
  np.testing.assert_array_equal(pieces.weights, np.broadcast_to(np.eye(3), (len(corners), 3, 3)))


def test_a_solid_inside_another_goes():
  corners, solid = _corners(solids.box((1, 1, 1)), solids.box((0.5, 0.3, 0.2), (0.1, 0, 0)))
  outer = np.flatnonzero(solid == 0)
  np.testing.assert_array_equal(cutting.exposed(corners, solid).face, outer)


def test_crossing_solids_keep_what_shows_and_little_more():
  """A rod through a box: its ends stay whole, its middle goes, but for a rim of pieces."""
  rod = solids.box((3, 0.3, 0.3))
  corners, solid = _corners(solids.box((1, 1, 1)), rod)
  pieces = cutting.exposed(corners, solid)
  cut = pieces.weights @ corners[pieces.face]
  of_rod = solid[pieces.face] == 1
  area = _area(cut)
  shown, step = 2 * (4 * 0.3) + 2 * 0.3**2, 3 * cutting.STEPS[-1]
  assert shown - 1e-9 <= area[of_rod].sum() <= shown + 2 * (4 * 0.3) * step
  assert np.abs(cut[of_rod][..., 0]).min() > 0.5 - step
  hidden = 2 * 0.3**2  # of the box, where the rod leaves it
  assert 6 - hidden <= area[~of_rod].sum() < 6 - 0.3 * hidden


def test_a_small_gap_between_two_solids_is_not_taken_for_hidden():
  """A long rod between two boxes shows over a sixtieth of its length."""
  rod = solids.box((6, 0.4, 0.4))
  left, right = (solids.box((3, 1, 1), (s * 1.55, 0, 0)) for s in (-1, 1))
  corners, solid = _corners(left, right, rod)
  pieces = cutting.exposed(corners, solid)
  cut = (pieces.weights @ corners[pieces.face])[solid[pieces.face] == 2]
  gap = (np.abs(cut[..., 0]) < 0.05 + 6 * cutting.STEPS[-1]).all(1)
  assert _area(cut[gap]).sum() >= 4 * 0.4 * 0.1 - 1e-9


def test_pieces_keep_their_place_in_the_picture():
  """After cutting, texture coordinates are the same function of the place as before."""
  picture = materials.pictured(np.zeros((4, 4), int), [[0.5, 0.4, 0.3]])
  board = parts.paint(solids.box((2, 0.2, 1)), picture)
  leg = parts.paint(solids.box((0.2, 1, 0.2), (0.3, -0.5, 0.1)), materials.plain([0.2, 0.2, 0.2]))
  mesh = parts.assemble([board, leg])
  at, uv = mesh.vertices[mesh.faces], mesh.corner_uv
  level = (mesh.texture == 0) & (np.ptp(at[..., 1], axis=1) < 1e-12)
  assert level.sum() > 4  # the underside was cut
  np.testing.assert_allclose(uv[level][..., 0], 0.5 + at[level][..., 0] / 2.04, atol=1e-6)


@pytest.mark.parametrize('category', ['car', 'chair', 'guitar', 'human', 'table'])
def test_nothing_that_shows_is_lost(category):
  """Points strewn on all faces: those outside all solids lie on the pieces that are left."""
  shapes = importlib.import_module(f'datagen.sources.shapes.{category}')
  built = [parts.without_slivers(p) for p in shapes.build(np.random.default_rng(4))]
  corners = np.concatenate([p.vertices[p.faces] for p in built])
  solid = np.repeat(np.arange(len(built)), [len(p.faces) for p in built])
  rng = np.random.default_rng(0)
  face = rng.choice(len(corners), 3000, p=_area(corners) / _area(corners).sum())
  weights = rng.dirichlet(np.ones(3), len(face))
  a, b, c = np.moveaxis(corners[face], 1, 0)
  normal = np.cross(b - a, c - a)
  normal /= np.linalg.norm(normal, axis=1, keepdims=True)
  lift = 2e-4 * np.ptp(corners, axis=(0, 1)).max()
  points = np.einsum('nk,nkc->nc', weights, corners[face]) + lift * normal
  shows = cutting.windings(points, corners) <= 0
  pieces = cutting.exposed(corners, solid)
  inverse = np.linalg.inv(pieces.weights)
  first, last = (np.searchsorted(pieces.face, face, side) for side in ('left', 'right'))
  covered = [
    (w @ inverse[i:j] > -1e-9).all(-1).any() for w, i, j in zip(weights, first, last, strict=True)
  ]
  lost = shows & ~np.array(covered)
  assert 0.3 < shows.mean() < 1 and lost.sum() < 0.003 * shows.sum()
  # Nor is much left that does not show: at most a voxel's width along the cuts.
  assert (
    _area(pieces.weights @ corners[pieces.face]).sum() < 1.25 * shows.mean() * _area(corners).sum()
  )
