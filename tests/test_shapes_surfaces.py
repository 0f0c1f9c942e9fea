"""Pictures of surfaces: the colours they claim, features wide enough, grain along the part."""

import numpy as np
import pytest

from datagen.sources.shapes import (
  car,
  finishes,
  guitar,
  livery,
  materials,
  outlines,
  parts,
  solids,
  surfaces,
)

WOOD = np.array([0.6, 0.4, 0.2])
THREE = ([0.2, 0.3, 0.7], [0.8, 0.7, 0.2], [0.7, 0.1, 0.1])


def _rgb(material):
  return material.picture[..., :3] / 255


def _distances(rgb, color):
  return np.linalg.norm(rgb - color, axis=-1)


def test_close_colours_keep_their_direction():
  first, near, far = materials.close([[0.5, 0.5, 0.5], [0.6, 0.5, 0.5], [0.5, 0.9, 0.5]], 0.2)
  np.testing.assert_allclose(first, [0.5, 0.5, 0.5])
  np.testing.assert_allclose(near, [0.6, 0.5, 0.5])
  np.testing.assert_allclose(far, [0.5, 0.7, 0.5])


@pytest.mark.parametrize('kind', ['stripes', 'checks', 'dots', 'blotches', 'chevrons'])
def test_patterns_have_no_colour_but_the_ones_given(kind):
  for seed in range(5):
    rgb = _rgb(getattr(materials, kind)(np.random.default_rng(seed), THREE, period=0.3))
    near = np.min([_distances(rgb, c) for c in [*THREE, np.mean(THREE[:2], axis=0)]], axis=0)
    assert near.max() < 0.005
    assert _distances(rgb, rgb[0, 0]).max() > 0.1  # and more than one


def test_features_of_cloth_are_wider_than_one_and_a_half_voxels():
  """Runs of one colour along a row of a cloth; a fortieth of a chair of 0.9 m is 22 mm."""
  narrow = []
  for seed in range(60):
    cloth = materials.fabric(np.random.default_rng(seed), THREE, period=0.2)
    if cloth.picture is None:
      continue
    row = _rgb(cloth)[cloth.picture.shape[0] // 3]
    change = np.flatnonzero((np.roll(row, 1, 0) != row).any(-1))
    if len(change) > 1:
      runs = np.diff(change, append=change[0] + len(row)) * cloth.period / len(row)
      narrow.append(np.median(runs) < 0.9 / 40)
  assert len(narrow) > 15 and np.mean(narrow) < 0.15


def test_wood_varies_across_the_grain_more_than_along_it():
  for seed in range(8):
    grey = _rgb(materials.wood(np.random.default_rng(seed), WOOD)).mean(-1)
    across, along = (np.abs(np.diff(grey, axis=k)).mean() for k in (1, 0))
    assert across > 1.5 * along
    assert np.abs(grey - WOOD.mean()).max() < 0.15


@pytest.mark.parametrize('axis', [0, 1, 2])
def test_grain_runs_along_a_board(axis):
  """v, along which grain runs, changes along the longest side on all four long faces."""
  size = np.full(3, 0.1)
  size[axis] = 1.0
  part = parts.paint(solids.box(size), materials.wood(np.random.default_rng(0), WOOD))
  corners = part.vertices[part.faces]
  normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
  long = np.abs(normal).argmax(1) != axis
  v = part.uv[long][..., 1] - 0.5
  np.testing.assert_allclose(np.abs(v), np.abs(corners[long][..., axis]) / 0.5)


def test_boards_lie_side_by_side():
  """Seams are dark columns at the borders, and boards differ."""
  rgb = _rgb(surfaces.boards(np.random.default_rng(0), WOOD, 4))
  column = rgb.mean((0, 2))
  seams = [k * surfaces.SIZE // 4 for k in range(1, 4)]
  assert max(column[seams]) < np.median(column)
  middles = rgb[:, surfaces.SIZE // 8 :: surfaces.SIZE // 4].mean((0, 2))
  assert np.ptp(middles) > 0.02
  np.testing.assert_allclose(rgb.mean((0, 1)), WOOD, atol=0.09)


def test_tiles_alternate():
  ground, other, _ = materials.close(THREE, materials.PATTERN)
  rgb = _rgb(surfaces.tiles(np.random.default_rng(1), THREE, 4))
  quarter, eighth = surfaces.SIZE // 4, surfaces.SIZE // 8
  at = surfaces.SIZE - quarter + quarter // 5  # a row near the top of the lowest tiles
  assert _distances(rgb[at, quarter // 5], ground) < 0.005
  assert _distances(rgb[at, quarter + eighth], other) < 0.005


def test_stone_and_tufts_stay_near_their_colour():
  stone = _rgb(surfaces.stone(np.random.default_rng(0), np.array([0.5, 0.45, 0.4])))
  assert np.median(_distances(stone, [0.5, 0.45, 0.4])) < 0.1
  tufts = surfaces.tufted(np.array([0.5, 0.2, 0.2]), period=0.2)
  assert tufts.period == 0.2
  button = _rgb(tufts)[surfaces.SIZE // 2, surfaces.SIZE // 2]
  assert button.sum() < _rgb(tufts).mean((0, 1)).sum()


def test_bordered_has_its_band_and_its_middle():
  ground, band, mark = materials.close(THREE, 0.5)
  rgb = _rgb(surfaces.bordered(THREE, width=0.1, round_=False))
  n = surfaces.SIZE
  for at, color in (((n // 2, n // 2), mark), ((n // 2, int(0.075 * n)), band), ((5, 5), ground)):
    assert _distances(rgb[at], color) < 0.005


def test_texels_lie_where_paint_lays_them():
  box = solids.box((1, 2, 3), (0.5, 0, 1))
  for axis, sign in ((0, 1), (0, -1), (1, 1), (2, 1), (2, -1)):
    a, b = parts.texels(box, axis, sign, 64)
    right, above = ((2, 1), (0, 2), (0, 1))[axis]
    part = parts.paint(parts.facing(box, (axis,), sign), materials.drawn(np.zeros((64, 64, 3))))
    corners = part.vertices[part.faces].reshape(-1, 3)
    for corner, (u, v) in zip(corners, part.uv.reshape(-1, 2), strict=True):
      column, row = int(u * 64), int((1 - v) * 64)
      np.testing.assert_allclose(a[row, column], corner[right], atol=0.04)
      np.testing.assert_allclose(b[row, column], corner[above], atol=0.04)


def test_wheel_arches_are_dark_and_doors_are_not():
  rng = np.random.default_rng(3)
  look = livery.choose(rng, materials.scheme(rng), 1.8)
  form = car.FORMS['sedan']
  hull, _ = car.body(form, 4.0, 4.0, 'sedan')
  painted = livery.wear(rng, hull, form, look, [(1.4, 0.32, 0.37)], [0.6, 0.7])
  z, y = parts.texels(hull, 0, 1, livery.SIZE)
  arch = np.hypot(z - 1.4, y - 0.32) < 0.35
  side = _rgb(painted[1].material)
  assert _distances(side[arch], look.marks.arch).max() < 0.005
  assert _distances(side[(np.abs(z) < 0.5) & (y > 0.5)], look.marks.arch).mean() > 0.1


def test_an_acoustic_guitar_has_its_hole_in_the_front():
  rng = np.random.default_rng(0)
  outline = outlines.body('dreadnought', 0.4, 0.5, cutaway=False)
  body = solids.prism(outline, -0.05, 0.05)
  look = finishes.choose(rng, materials.scheme(rng), acoustic=True)
  x, y = parts.texels(body, 2, 1, finishes.SIZE)
  hole = np.hypot(x, y - 0.33) < 0.04
  for seed in range(20):
    front = finishes.front(
      np.random.default_rng(seed), body, outline, look, acoustic=True, hollow=False
    )
    if np.allclose(_rgb(front)[hole], finishes.DARK, atol=0.005):
      return
  raise AssertionError('no sound hole in 20 fronts')


def test_necks_narrow_towards_the_head():
  rng = np.random.default_rng(0)
  colors = materials.scheme(rng)
  look = finishes.choose(rng, colors, acoustic=False)
  form = guitar.FORMS['electric']._replace(kind='double')
  shaft = guitar.neck(rng, form, look, colors)[0].vertices
  low, high = shaft[:, 1].min(), shaft[:, 1].max()
  ends = [np.ptp(shaft[np.abs(shaft[:, 1] - y) < 1e-6][:, 0]) for y in (low, high)]
  assert ends[0] > ends[1] > 0.045
