"""Panels make the whole garment, without gap or overlap, each with coordinates of its own part."""

import makehuman
import numpy as np
import pytest

from datagen.sources.people import charts, cloth, data, layers, patterns, rig

COLORS = np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1]])
CHECKS = patterns.Pattern('checks', COLORS, 0.12, 3, 0.0, 1)


@pytest.fixture(scope='module')
def person(tmp_path_factory):
  body = data.read_body(makehuman.write_wheel(tmp_path_factory.mktemp('wheel')))
  return body, charts.chart(body, body.vertices, rig.joints(body, body.vertices))


def _garment(person, pattern, **fields):
  body, _ = person
  count = len(body.vertices)
  quads = body.groups['helper-tights']
  return cloth.Garment(quads, np.ones(count), np.zeros(count), pattern, **fields)


def _mesh(person, found):
  body, _ = person
  outward = np.zeros_like(body.vertices)
  bones = np.tile(np.eye(4), (len(body.bones), 1, 1))
  return layers.assemble(body, found, [], body.vertices, outward, bones)


def _area(mesh, of=slice(None)):
  a, b, c = np.moveaxis(mesh.vertices[mesh.faces[of]], 1, 0)
  return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()


@pytest.mark.parametrize(
  ('cut', 'panels'), [('top', 3), ('trousers', 2), ('overall', 5), ('skirt', 1)]
)
def test_panels_make_the_whole(person, cut, panels):
  whole = cloth.lay(person[1], _garment(person, COLORS[0]), waist=2.0)
  found = cloth.lay(person[1], _garment(person, CHECKS, cut=cut), waist=2.0)
  assert len(whole) == 1 and len(found) == panels
  assert _area(_mesh(person, found)) == pytest.approx(_area(_mesh(person, whole)), rel=1e-6)


def test_plain_cloth_needs_no_picture_unless_something_is_printed_on_it(person):
  plain = CHECKS._replace(kind='plain')
  (layer,) = cloth.lay(person[1], _garment(person, plain), waist=2.0)
  assert layer.paint.picture is None
  np.testing.assert_array_equal(layer.paint.color, COLORS[0])
  found = cloth.lay(person[1], _garment(person, plain, ink=COLORS[1]), waist=2.0)
  inked = [(layer.paint.picture[..., 1] == 255).any() for layer in found]
  assert inked == [True, False, False]  # on the trunk and on no sleeve


@pytest.mark.parametrize('cut', ['top', 'trousers', 'overall'])
def test_a_face_of_a_twelfth_of_a_turn_shows_a_twelfth_of_the_picture(person, cut):
  mesh = _mesh(person, cloth.lay(person[1], _garment(person, CHECKS, cut=cut), waist=2.0))
  wide = np.ptp(mesh.corner_uv[..., 0], axis=1)
  # Caps of the tubes reach the axis, and trousers go about the hips off their own axes.
  assert np.median(wide) == pytest.approx(1 / makehuman.SIDES, rel=0.1)
  assert (wide > 0.5).mean() < 0.03
