"""Poses: limbs point where their family says, sides mirror, and no limb runs into another."""

import makehuman
import numpy as np
import pytest

from datagen.sources.people import clearance, data, families, poses, rig

GIRTH = 0.9


@pytest.fixture(scope='module')
def skeleton(tmp_path_factory):
  body = data.read_body(makehuman.write_wheel(tmp_path_factory.mktemp('wheel')))
  return body, rig.joints(body, body.vertices)


def _places(skeleton, turns):
  """Bone -> where it begins in the pose."""
  body, at = skeleton
  transforms = rig.bone_transforms(body, at, turns)
  return {b: m[:3, :3] @ at[b] + m[:3, 3] for b, m in zip(body.bones, transforms, strict=True)}


def _sample(skeleton, family, seed):
  return poses.sample(np.random.default_rng(seed), *skeleton, family, girth=GIRTH)


@pytest.mark.parametrize(
  ('rise', 'turn', 'expected'),
  [
    (0, 0, [0, -1, 0]),
    (90, 0, [1, 0, 0]),
    (90, 90, [0, 0, 1]),
    (90, -90, [0, 0, -1]),
    (90, 180, [-1, 0, 0]),
    (180, 0, [0, 1, 0]),
  ],
)
def test_directions(rise, turn, expected):
  np.testing.assert_allclose(poses.direction(rise, turn, 1), expected, atol=1e-12)
  mirrored = np.array(expected) * [-1, 1, 1]
  np.testing.assert_allclose(poses.direction(rise, turn, -1), mirrored, atol=1e-12)


def test_families_name_limbs_that_there_are():
  for family in families.FAMILIES.values():
    for pair in family.legs:
      assert set(pair) <= set(families.LEGS)
    for pair in family.arms:
      assert set(pair) <= {None, *families.ARMS}
  assert set(families.ASYMMETRIC) <= set(families.ARMS)
  used = {a for f in families.FAMILIES.values() for pair in f.arms for a in pair}
  assert set(families.ARMS) <= used | set(families.ASYMMETRIC)
  assert set(families.LEGS) == {n for f in families.FAMILIES.values() for p in f.legs for n in p}


@pytest.mark.parametrize('family', families.FAMILIES)
def test_turns_are_rotations_and_limbs_keep_apart(skeleton, family):
  for seed in range(3):
    pose = _sample(skeleton, family, seed)
    assert pose.family == family
    for turn in pose.turns.values():
      np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-9)
    assert clearance.clearance(*skeleton, pose.turns, girth=GIRTH) >= 0


def test_handstands_stand_on_their_hands(skeleton):
  for seed in range(5):
    place = _places(skeleton, _sample(skeleton, 'handstand', seed).turns)
    assert max(place['hand_l'][1], place['hand_r'][1]) < place['head'][1] < place['pelvis'][1]
    assert max(place['foot_l'][1], place['foot_r'][1]) > place['pelvis'][1]


def test_who_sits_has_level_thighs_and_hanging_shins(skeleton):
  for seed in range(5):
    place = _places(skeleton, _sample(skeleton, 'sit', seed).turns)
    for s in 'lr':
      thigh = place[f'calf_{s}'] - place[f'thigh_{s}']
      shin = place[f'foot_{s}'] - place[f'calf_{s}']
      assert thigh[2] > 0.85 * np.linalg.norm(thigh)
      assert shin[1] < -0.85 * np.linalg.norm(shin)


def test_kicks_raise_one_foot_forward_on_either_side(skeleton):
  raised = set()
  for seed in range(12):
    place = _places(skeleton, _sample(skeleton, 'kick', seed).turns)
    high, low = sorted('lr', key=lambda s: -place[f'foot_{s}'][1])
    assert place[f'foot_{high}'][2] > place[f'foot_{low}'][2] + 2
    raised.add(high)
  assert raised == {'l', 'r'}


def test_skirts_are_worn_in_upright_families_only():
  rng = np.random.default_rng(0)
  drawn = {poses.sample_family(rng, upright=True) for _ in range(300)}
  assert drawn == {n for n, f in families.FAMILIES.items() if f.upright}
  assert {poses.sample_family(rng, upright=False) for _ in range(3000)} == set(families.FAMILIES)


def test_same_seed_same_pose(skeleton):
  first, again = (_sample(skeleton, 'run', 5) for _ in range(2))
  assert all(np.array_equal(first.turns[b], again.turns[b]) for b in first.turns)


@pytest.mark.parametrize(
  ('segments', 'expected'),
  [
    (([0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]), 1),  # parallel
    (([-1, 0, 0], [1, 0, 0], [0, -1, 2], [0, 1, 2]), 2),  # crossing
    (([0, 0, 0], [1, 0, 0], [4, 4, 0], [4, 9, 0]), 5),  # ends
    (([0, 0, 0], [0, 0, 0], [3, 4, 0], [3, 4, 0]), 5),  # points
    (([0, 0, 0], [2, 0, 0], [1, 3, 0], [1, 3, 0]), 3),
    (([1, 3, 0], [1, 3, 0], [0, 0, 0], [2, 0, 0]), 3),
  ],
)
def test_distance_of_segments(segments, expected):
  assert clearance.segment_distance(*np.array(segments, float)) == pytest.approx(expected)


def test_distance_of_segments_is_the_least_of_many():
  rng = np.random.default_rng(2)
  t = np.linspace(0, 1, 60)[:, None]
  for p, q, u, v in rng.normal(size=(50, 4, 3)):
    dense = np.linalg.norm((p + t * (q - p))[:, None] - (u + t * (v - u))[None], axis=-1).min()
    assert dense - 0.1 < clearance.segment_distance(p, q, u, v) <= dense + 1e-12


def test_a_hand_in_the_belly_has_no_room(skeleton):
  body, at = skeleton
  free = clearance.clearance(body, at, {}, girth=GIRTH)
  into = {'upperarm_l': rig.swing(at['lowerarm_l'] - at['upperarm_l'], [-0.3, -1, 0.0])}
  assert clearance.clearance(body, at, into, girth=GIRTH) < 0 < free
