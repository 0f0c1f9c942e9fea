import numpy as np
import pytest
import synthetic

from cvn.dataset import Facts, Record
from datagen.quality.examine import examine, flow_stats, suspicions
from datagen.sources import procedural

GOOD = examine(
  synthetic.make_record(0, image_size=64, grid_size=32)._replace(facts=Facts(100, 0, 0.5))
)


def two_voxels():
  """A view of two pixels, red and blue; both voxels are red, and one is hidden."""
  views = np.array([[[[255, 0, 0, 255], [0, 0, 255, 255]]]], np.uint8)
  return Record(
    views,
    surface_index=np.array([[0, 0, 0], [2, 8, 4]], np.uint8),
    surface_color=np.array([[255, 0, 0], [255, 0, 0]], np.uint8),
    visible=np.array([[True, False]]),
    flow=np.array([[[0.25, 0.5], [0.75, 0.5]]]),
    facts=Facts(faces=1, missing=3, volume=-0.5),
  )


def test_numbers_of_a_model_known_by_heart():
  e = examine(two_voxels())
  assert (e.voxels, e.visible, e.missing, e.volume) == (2, 0.5, 3, -0.5)
  assert (e.visible_error, e.visible_faithful) == (0, 1)
  assert e.error == pytest.approx(np.sqrt(2) / 2)  # the hidden one fetches blue for red
  assert e.color_spread == 0
  assert e.uprightness == 9 / 5


def test_the_seen_voxel_fetches_a_wrong_colour():
  e = examine(two_voxels()._replace(visible=np.array([[False, True]])))
  assert e.visible_error == pytest.approx(np.sqrt(2))
  assert e.visible_faithful == 0


def test_nothing_visible_is_no_error():
  assert examine(two_voxels()._replace(visible=np.array([[False, False]]))).visible_error == 0


def test_flows_that_were_made_elsewhere():
  # The first voxel fetches its own red, the second blue.
  s = flow_stats(two_voxels(), 0.1)
  assert (s.visible, s.matched, s.fallback) == (0.5, 0, 0.5)
  assert (s.visible_error, s.visible_faithful) == (0, 1)
  assert s.error == pytest.approx(np.sqrt(2) / 2)
  unseen = two_voxels()._replace(visible=np.array([[False, False]]))
  s = flow_stats(unseen, 0.1)
  assert (s.visible, s.matched, s.fallback) == (0, 0.5, 0.5)
  assert flow_stats(unseen, 1.5).matched == 1


def test_a_good_model_is_not_suspected():
  assert suspicions([GOOD], ['ball']) == [[]]


@pytest.mark.parametrize(
  'change, reason',
  [
    ({'voxels': 12}, 'almost empty (12 voxels)'),
    ({'color_spread': 0.001}, 'a single colour'),
    ({'volume': -0.5}, 'inside out (signed volume -0.50 of its box)'),
    ({'missing': 2}, '2 files or materials missing'),
  ],
)
def test_suspicions(change, reason):
  assert suspicions([GOOD, GOOD._replace(**change)], ['ball'] * 2) == [[], [reason]]


def test_a_model_on_its_side_among_upright_ones():
  upright = [GOOD._replace(uprightness=u) for u in (0.9, 1.0, 1.0, 1.1, 1.2)]
  lying = GOOD._replace(uprightness=0.3)
  found = suspicions([*upright, lying], ['ball'] * 6)
  assert found[:5] == [[]] * 5
  assert found[5] == ['far from upright (0.3 times as tall as the median ball)']
  # Other categories have other shapes, and a few models make no median.
  assert suspicions([*upright, lying], ['ball'] * 5 + ['egg']) == [[]] * 6
  assert suspicions([upright[0], lying], ['ball'] * 2) == [[], []]


@pytest.mark.parametrize(
  ('category', 'uprightness', 'breadth', 'reason'),
  [
    ('human', 1.8, 0.9, None),
    ('Human', 0.4, 0.9, 'seems to lie down: 0.4 times as high as wide or deep'),
    ('car', 0.4, 0.5, None),
    ('car', 0.4, 2.1, 'seems to face another way: 2.1 times as wide as deep'),
    ('car', 2.2, 0.5, 'seems to lie'),
    ('guitar', 2.7, 0.4, 'seems to face another way'),
    ('chair', 0.3, 1.0, 'seems to lie'),
    ('spoon', 0.1, 9.0, None),
  ],
)
def test_what_stands_otherwise_than_its_category_does(category, uprightness, breadth, reason):
  """Also where all models of a set do: their median is no help."""
  six = [GOOD._replace(uprightness=uprightness, breadth=breadth)] * 6
  for found in suspicions(six, [category] * 6):
    assert len(found) == (reason is not None)
    assert reason is None or found[0].startswith(reason)


@pytest.mark.parametrize('category', procedural.CATEGORIES)
def test_what_is_made_here_stands_as_is_usual(category):
  for model in procedural.list_models(category, None, 8, 1):
    mesh = procedural.load(model)
    width, height, depth = np.ptp(mesh.vertices[np.unique(mesh.faces)], axis=0)
    e = GOOD._replace(uprightness=height / max(width, depth), breadth=width / depth)
    assert suspicions([e], [category]) == [[]]
