"""Turns, bones and skinning, against known positions."""

import makehuman
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from datagen.sources.people import data, rig


@pytest.fixture(scope='module')
def body(tmp_path_factory):
  return data.read_body(makehuman.write_wheel(tmp_path_factory.mktemp('wheel')))


def test_rotation_agrees_with_scipy():
  rng = np.random.default_rng(0)
  for axis, degrees in zip(rng.normal(size=(20, 3)), rng.uniform(-360, 360, 20), strict=True):
    unit = axis / np.linalg.norm(axis)
    expected = Rotation.from_rotvec(np.deg2rad(degrees) * unit).as_matrix()
    np.testing.assert_allclose(rig.rotation(axis, degrees), expected, atol=1e-12)


def test_swing_takes_one_direction_to_the_other_by_the_least_turn():
  rng = np.random.default_rng(1)
  pairs = [*rng.normal(size=(20, 2, 3)), np.array([[0, 1, 0], [0, 2, 0]])]
  pairs += [np.array([v, -np.array(v)]) for v in ([1, 0, 0], [0, 0, 1], [1.0, 1, 1])]
  for a, b in pairs:
    a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
    turn = rig.swing(a, b)
    np.testing.assert_allclose(turn @ a, b, atol=1e-9)
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(turn) == pytest.approx(1)
    angle = np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))
    assert angle == pytest.approx(np.arccos(np.clip(a @ b, -1, 1)), abs=1e-6)


def test_a_body_that_is_not_turned_stays(body):
  at = rig.joints(body, body.vertices)
  same = rig.skin(body.vertices, body.weights, rig.bone_transforms(body, at, {}))
  np.testing.assert_allclose(same, body.vertices, atol=1e-12)


def test_what_hangs_on_a_bone_turns_with_it_and_nothing_else(body):
  at = rig.joints(body, body.vertices)
  turns = {'upperarm_l': rig.rotation([0, 0, 1], 90), 'lowerarm_l': rig.rotation([0, 0, 1], -90)}
  transforms = rig.bone_transforms(body, at, turns)
  posed = rig.skin(body.vertices, body.weights, transforms)
  fixed = [b for b in body.bones if not b.endswith('arm_l') and b[-1] != 'l']
  still = body.weights[:, [body.bones.index(b) for b in fixed]].sum(1) == 1
  np.testing.assert_allclose(posed[still], body.vertices[still], atol=1e-12)
  # About (1.6, 4.9): the elbow's offset (2, -2) turns to (2, 2); the forearm is straight again.
  hand = transforms[body.bones.index('hand_l')] @ [*at['hand_l'], 1]
  np.testing.assert_allclose(hand[:3], [1.6 + 2 + 1.6, 4.9 + 2 - 1.6, 0.1], atol=1e-9)


def test_weights_blend():
  turned = np.eye(4)
  turned[0, 3] = 2.0
  out = rig.skin(np.array([[1.0, 1, 1]]), np.array([[0.25, 0.75]]), np.stack([np.eye(4), turned]))
  np.testing.assert_allclose(out, [[2.5, 1, 1]])
