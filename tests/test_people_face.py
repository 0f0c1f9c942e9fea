"""Faces, hair and headwear on the miniature person, at known places."""

import makehuman
import numpy as np
import pytest

from datagen.sources.people import charts, data, face, hair, rig

SKIN, HAIR, IRIS, LIPS = (np.array(c) for c in ([0.9, 0.7, 0.6], [0.3, 0.2, 0.1], [0, 0, 1.0],
                                                [1.0, 0, 0]))  # fmt: skip
FACE = face.Face(SKIN, HAIR, IRIS, LIPS, None, 0.0, None)


@pytest.fixture(scope='module')
def person(tmp_path_factory):
  body = data.read_body(makehuman.write_wheel(tmp_path_factory.mktemp('wheel')))
  return body, charts.chart(body, body.vertices, rig.joints(body, body.vertices))


def _at(picture, at, point):
  """The picture's colour [3] where a point (x, y) of the head's front is."""
  u, v = (np.asarray(point) - at.window[0]) / at.window[1]
  return picture[int((1 - v) * face.SIZE), int(u * face.SIZE), :3] / 255


def test_features_are_where_the_head_has_them(person):
  at = face.marks(*person)
  np.testing.assert_allclose(at.eyes, [[0.31, 7.3], [-0.31, 7.3]], atol=1e-6)
  picture = face.draw(FACE, at)
  for eye in at.eyes:
    np.testing.assert_allclose(_at(picture, at, eye), face.PUPIL, atol=0.01)
    np.testing.assert_allclose(_at(picture, at, eye + [0.08, 0]), IRIS, atol=0.01)
    np.testing.assert_allclose(_at(picture, at, eye + [0.17, 0]), face.EYE_WHITE, atol=0.01)
    np.testing.assert_allclose(_at(picture, at, [eye[0], at.brow[1] + 0.01]), HAIR, atol=0.01)
  half = 0.04
  np.testing.assert_allclose(_at(picture, at, at.mouth + [0, half]), LIPS, atol=0.01)
  np.testing.assert_allclose(picture[0, 0, :3] / 255, SKIN, atol=0.01)
  np.testing.assert_allclose(_at(picture, at, [0, 8.1]), SKIN, atol=0.01)  # the forehead
  assert (picture[..., 3] == 255).all()


def test_beards_and_glasses_are_painted_where_they_belong(person):
  at = face.marks(*person)
  plain = face.draw(FACE, at)
  bearded = face.draw(FACE._replace(beard=HAIR), at)
  np.testing.assert_allclose(_at(bearded, at, at.mouth - [0, 0.3]), HAIR, atol=0.01)
  changed = (bearded != plain).any(-1).nonzero()[0]
  assert 1 - changed.min() / face.SIZE < (7.3 - at.window[0][1]) / at.window[1][1]
  glasses = face.draw(FACE._replace(glasses=np.zeros(3)), at)
  np.testing.assert_allclose(_at(glasses, at, [0, 7.3]), 0, atol=0.01)
  np.testing.assert_allclose(_at(glasses, at, at.eyes[0]), face.PUPIL, atol=0.01)


def test_coordinates_cover_the_picture(person):
  body, chart = person
  uv = face.uv(chart, face.marks(*person).window)
  used = np.unique(body.groups['body'])
  head = uv[used[chart.head_weight[used] > 0.5]]
  assert head.min() > 0 and head.max() < 1 and np.ptp(head, axis=0).min() > 0.9


def _hair(person, style, headwear='none'):
  cloth, trim = np.array([1.0, 0, 1]), np.array([1.0, 1, 0])
  head = hair.Head(style, headwear, HAIR, cloth, trim)
  return hair.layers(np.random.default_rng(0), *person, head)


def test_bald_heads_have_no_hair(person):
  found, props, covered = _hair(person, 'bald')
  assert not found and not props and covered.max() < 0


@pytest.mark.parametrize('style', [s for s in hair.STYLES if s != 'bald'])
def test_hair_covers_the_crown_and_the_back_and_not_the_face(person, style):
  body, chart = person
  found, props, covered = _hair(person, style)
  used = np.unique(body.groups['body'])
  used = used[chart.head_weight[used] > 0.5]
  x, y, z = chart.vertices[used].T
  assert (covered[used][y > 8.2] > 0).all()
  assert (covered[used][(z < 0) & (y > 7.2) & (np.abs(x) < 0.5)] > 0).all()
  assert (covered[used][(z > 0.9) & (y < 7.6)] < 0).all()
  others = np.setdiff1d(np.unique(body.groups['body']), used)
  assert (covered[others] < 0).all()
  np.testing.assert_array_equal(found[0].paint.color, HAIR)
  assert len(props) == {'bun': 1, 'ponytail': 2}.get(style, 0)
  assert len(found) == (2 if style in ('long', 'bob') else 1)


@pytest.mark.parametrize('headwear', [h for h in hair.HEADWEAR if h != 'none'])
def test_no_hair_shows_through_headwear(person, headwear):
  found, props, covered = _hair(person, 'full', headwear)
  hat = found[-1]
  np.testing.assert_array_equal(hat.paint.color, [1, 0, 1])
  for layer in found[:-1]:
    assert np.minimum(layer.field, hat.field).max() <= 0.05
  np.testing.assert_array_equal(covered >= hat.field, True)
  assert len(props) == {'cap': 1, 'beanie': 1, 'hat': 2, 'headscarf': 0}[headwear]
  assert {p.bone for p in props} <= {'head'}


def test_heads_vary():
  rng = np.random.default_rng(0)
  white, trim = np.ones(3), np.zeros(3)
  drawn = [
    hair.sample(rng, woman=w, old=o, cloth=white, trim=trim)
    for _ in range(100)
    for w in (False, True)
    for o in (False, True)
  ]
  assert {h.style for h in drawn} == set(hair.STYLES)
  assert {h.headwear for h in drawn} == set(hair.HEADWEAR)
  assert all(0 <= h.hair.min() and h.hair.max() <= 1 for h in drawn)
  assert not any(h.headwear != 'none' and h.style in ('bun', 'afro') for h in drawn)
