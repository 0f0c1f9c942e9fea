"""Coordinates on the miniature person at known places."""

import makehuman
import numpy as np
import pytest

from datagen.sources.people import charts, data, rig


@pytest.fixture(scope='module')
def person(tmp_path_factory):
  body = data.read_body(makehuman.write_wheel(tmp_path_factory.mktemp('wheel')))
  return body, charts.chart(body, body.vertices, rig.joints(body, body.vertices))


def _of(person, group, bone):
  """Vertices of a group that a bone moves."""
  body, _ = person
  used = np.unique(body.groups[group])
  return used[body.weights[used, body.bones.index(bone)] > 0.5]


def test_height_is_that_of_the_body(person):
  body, chart = person
  used = np.unique(body.groups['body'])
  assert chart.height == pytest.approx(np.ptp(body.vertices[used, 1]))
  assert chart.floor == pytest.approx(body.vertices[used, 1].min())


@pytest.mark.parametrize('s', ['l', 'r'])
def test_places_along_the_arm_and_the_leg(person, s):
  body, chart = person
  elbow = np.linalg.norm(body.vertices - chart.at[f'lowerarm_{s}'], axis=1)
  lower = _of(person, 'body', f'lowerarm_{s}')
  near = lower[elbow[lower] < 0.3]
  np.testing.assert_allclose(chart.arm[near], 1, atol=0.15)
  hand = np.unique(body.groups[f'joint-hand_{s}'])
  np.testing.assert_allclose(chart.arm[_of(person, 'body', f'hand_{s}')].max(), 2.45, atol=0.2)
  knee = np.abs(body.vertices[:, 1] - chart.at[f'calf_{s}'][1]) < 1e-9
  np.testing.assert_allclose(chart.leg[knee], 1)
  assert not chart.is_arm[hand].any()  # a joint's cube is no part of it
  assert chart.is_arm[lower].all() and not chart.is_leg[lower].any()
  assert chart.is_leg[_of(person, 'body', f'calf_{s}')].all()


@pytest.mark.parametrize(
  ('part', 'bone'),
  [('trunk', 'spine_03'), ('leg_l', 'calf_l'), ('leg_r', 'calf_r'), ('arm_l', 'lowerarm_l')],
)
def test_around_is_0_in_front_and_grows_to_the_persons_left(person, part, bone):
  body, chart = person
  used = _of(person, 'helper-tights', bone)
  center = 0.5 * (body.vertices[used].min(0) + body.vertices[used].max(0))
  offset = body.vertices[used] - center
  u = chart.laid[part][used, 0]
  assert np.abs(u).max() <= 0.5
  # Leaning limbs: look at the rim that is farthest in front.
  front = offset[:, 2] > 0.8 * offset[:, 2].max()
  assert np.abs(u[front]).max() < 0.2
  left = front & (offset[:, 0] - offset[front, 0].mean() > 0.05)
  right = front & (offset[:, 0] - offset[front, 0].mean() < -0.05)
  if part != 'arm_l':  # an arm's length runs to the left as well
    assert u[left].mean() > 0.02 and u[right].mean() < -0.02


def test_lengths_grow_upwards_and_towards_the_shoulder(person):
  body, chart = person
  for part in ('trunk', 'leg_l', 'leg_r'):
    up = (body.vertices[:, 1] - chart.floor) / chart.height
    np.testing.assert_allclose(chart.laid[part][:, 1], up)
  shoulder, hand = (chart.at[b] for b in ('upperarm_l', 'hand_l'))
  used = _of(person, 'body', 'lowerarm_l')
  reach = chart.arm[used] - 1
  forearm = np.linalg.norm(hand - chart.at['lowerarm_l'])
  upper = np.linalg.norm(chart.at['lowerarm_l'] - shoulder)
  expected = (shoulder[1] - chart.floor - upper - reach * forearm) / chart.height
  inner = reach > 0
  np.testing.assert_allclose(chart.laid['arm_l'][used, 1][inner], expected[inner], atol=1e-9)
