"""Outfits drawn by chance, and the surfaces they become on the miniature person."""

import makehuman
import numpy as np
import pytest

from datagen.sources.people import charts, data, garments, outfits, patterns, rig

SKIN = np.array([0.9, 0.72, 0.6])
COLORS = np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1]])
PLAIN = patterns.Pattern('plain', COLORS, 0.12, 3, 0.0, 1)
OUTFIT = outfits.Outfit(
  top='T-shirt',
  bottom='trousers',
  shoes='shoes',
  sleeve=0.5,
  leg=1.8,
  skirt=1.0,
  socks=None,
  tucked=False,
  loose=0.0,
  neck='round',
  top_cloth=PLAIN,
  bottom_cloth=PLAIN._replace(colors=COLORS[[1, 0, 2]]),
  under=COLORS[2],
  shoe=np.array([0.2, 0.2, 0.2]),
  belt=None,
  gloves=None,
  printed=None,
)


@pytest.fixture(scope='module')
def person(tmp_path_factory):
  body = data.read_body(makehuman.write_wheel(tmp_path_factory.mktemp('wheel')))
  return body, charts.chart(body, body.vertices, rig.joints(body, body.vertices))


def _covered(person, outfit, group, bone):
  """Heights of the vertices that a bone moves, and which of them are covered."""
  body, chart = person
  _, covered = garments.dress(body, chart, outfit)
  used = np.unique(body.groups[group])
  used = used[body.weights[used, body.bones.index(bone)] > 0.5]
  return chart, used, covered[used] > 0


def _draw(seed, woman):
  return outfits.sample(np.random.default_rng(seed), woman=woman, skin=SKIN)


def test_outfits_hold_together():
  drawn = [_draw(s, woman) for s in range(120) for woman in (False, True)]
  for outfit in drawn:
    assert outfit.top in outfits.TOPS and outfit.bottom in outfits.BOTTOMS
    assert outfit.sleeve == -1 or outfits.SHORTEST_SLEEVE < outfit.sleeve < 2
    assert outfit.top != 'overall' or outfit.bottom == 'trousers'
    assert outfit.socks is None or outfit.shoes == 'shoes'
    assert outfit.belt is None or outfit.tucked
    for color in (outfit.top_cloth.colors[0], outfit.bottom_cloth.colors[0], outfit.shoe):
      assert np.linalg.norm(color - SKIN) > 0.25
    if outfit.printed is not None:
      assert np.linalg.norm(outfit.printed - outfit.top_cloth.colors[0]) > 0.3
  assert not any(outfits.wants_skirt(_draw(s, False)) for s in range(60))
  assert {o.top for o in drawn} == set(outfits.TOPS)
  assert {o.bottom for o in drawn} == set(outfits.BOTTOMS)
  assert len({o.top_cloth.kind for o in drawn}) == len(patterns.KINDS)


def test_sleeves_and_legs_end_where_they_should(person):
  chart, arm, covered = _covered(person, OUTFIT, 'body', 'upperarm_l')
  np.testing.assert_array_equal(covered, chart.arm[arm] < 0.5)
  chart, leg, covered = _covered(person, OUTFIT, 'body', 'calf_r')
  np.testing.assert_array_equal(covered, (chart.leg[leg] < 1.8) | (chart.leg[leg] > 1.93))


def test_the_trunk_is_covered_up_to_the_neck_and_hands_and_head_are_not(person):
  for top in outfits.TOPS:
    outfit = OUTFIT._replace(top=top, sleeve=-1.0 if top == 'vest' else 1.5)
    chart, trunk, covered = _covered(person, outfit, 'body', 'spine_01')
    assert covered[chart.vertices[trunk, 1] > 0.1].all(), top
    for bone in ('head', 'hand_l'):
      assert not _covered(person, outfit, 'body', bone)[2].any(), top


def test_vests_leave_arms_bare_and_gloves_cover_hands(person):
  vest = OUTFIT._replace(top='vest', sleeve=-1.0)
  assert not _covered(person, vest, 'body', 'lowerarm_r')[2].any()
  gloved = vest._replace(gloves=COLORS[2])
  assert _covered(person, gloved, 'body', 'hand_r')[2].all()


def test_barefoot_feet_are_bare_and_boots_go_up_the_legs(person):
  assert not _covered(person, OUTFIT._replace(shoes='barefoot'), 'body', 'foot_l')[2].any()
  boots = OUTFIT._replace(shoes='boots', bottom='shorts', leg=0.6)
  chart, leg, covered = _covered(person, boots, 'body', 'calf_l')
  np.testing.assert_array_equal(covered, chart.leg[leg] > 1.45)


def test_socks_fill_the_gap_between_trousers_and_shoes(person):
  assert _covered(person, OUTFIT._replace(socks=1.75), 'body', 'calf_l')[2].all()
  assert not _covered(person, OUTFIT, 'body', 'calf_l')[2].all()


def test_a_skirt_hides_the_legs_down_to_its_hem_and_nothing_of_the_hands(person):
  outfit = OUTFIT._replace(bottom='skirt', skirt=1.2)
  chart, leg, covered = _covered(person, outfit, 'body', 'calf_l')
  np.testing.assert_array_equal(covered, (chart.leg[leg] < 1.2) | (chart.leg[leg] > 1.93))
  assert not _covered(person, outfit, 'body', 'hand_l')[2].any()
  found, _ = garments.dress(*person, outfit)
  skirts = [layer for layer in found if layer.faces is person[0].groups['helper-skirt']]
  assert len(skirts) == 1


@pytest.mark.parametrize('seed', range(25))
def test_no_two_garments_lie_over_each_other_but_for_their_hems(seed, person):
  body, chart = person
  outfit = _draw(seed, seed % 2 == 0)
  found, covered = garments.dress(body, chart, outfit)
  unit = chart.height / 16.7
  tights = np.unique(body.groups['helper-tights'])
  outermost = np.full(len(chart.vertices), -np.inf)
  colors = [id(layer.paint.picture) if layer.paint.uv is not None else id(layer.paint.color)
            for layer in found]  # fmt: skip
  seen = set()
  for layer, color in zip(found, colors, strict=True):
    if layer.faces is body.groups['helper-skirt']:
      continue
    assert layer.field.shape == layer.lift.shape == (len(chart.vertices),)
    assert layer.lift.min() > 0 and layer.lift.max() < 1.2 * unit
    if color not in seen and not layer.seams:
      deep = np.minimum(layer.field, outermost)[tights]
      assert deep.max() <= garments.OVERLAP * unit + 1e-9
      outermost = np.maximum(outermost, layer.field)
    seen.add(color)
  assert covered[tights].max() > 0


def test_jackets_open_in_front_and_show_the_shirt(person):
  body, chart = person
  found, _ = garments.dress(body, chart, OUTFIT._replace(top='jacket', sleeve=1.8))
  jacket, shirt = found[:2]
  np.testing.assert_array_equal(shirt.paint.color, OUTFIT.under)
  x, y, z = chart.vertices.T
  tights = np.zeros(len(x), bool)
  tights[np.unique(body.groups['helper-tights'])] = True
  chest = tights & (y > 1) & (y < 3.5) & ~chart.is_arm
  middle = chest & (np.abs(x) < 0.2) & (z > 0.5)
  assert middle.any()
  assert (jacket.field[middle] < 0).all() and (shirt.field[middle] > 0).all()
  back = chest & (z < -0.5)
  assert (jacket.field[back] > 0).all()
