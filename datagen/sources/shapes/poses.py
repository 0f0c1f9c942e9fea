"""A skeleton of rotating joints: poses in degrees, and where each bone ends up.

The body stands upright facing +z, so its left side is at +x. Limbs hang along -y at rest. For a
limb, `forward` swings it towards +z, `out` away from the body, `twist` turns it about itself, and
`bend` is the elbow's (forearm forward) or the knee's (shin backward). Angles of the right side are
the mirror image of the left's.
"""

from typing import NamedTuple

import numpy as np

from datagen.sources.shapes.parts import rotation


class Limb(NamedTuple):
  """Degrees."""

  forward: float = 0.0
  out: float = 0.0
  twist: float = 0.0
  bend: float = 0.0


class Pose(NamedTuple):
  """Left and right limbs, and the trunk's (lean forward, twist, lean to the left)."""

  arms: tuple[Limb, Limb] = (Limb(0, 8, 0, 12), Limb(0, 8, 0, 12))
  legs: tuple[Limb, Limb] = (Limb(0, 4), Limb(0, 4))
  trunk: tuple[float, float, float] = (0.0, 0.0, 0.0)
  root: float = 0.0  # the whole body's pitch forward


class Bone(NamedTuple):
  """A bone's frame: parts drawn at rest around its joint go to rotation @ x + joint."""

  rotation: np.ndarray  # [3, 3]
  joint: np.ndarray  # [3]


_DOWN = Limb(0, 8, 0, 12)
_HIP = Limb(-10, 48, -80, 95)
POSES = {
  'stand': Pose(),
  'wide': Pose(legs=(Limb(0, 16), Limb(0, 16)), arms=(Limb(0, 28), Limb(0, 28))),
  'walk': Pose((Limb(-28, 6, 0, 15), Limb(30, 6, 0, 25)), (Limb(28, 2, 0, 8), Limb(-22, 2, 0, 18))),
  'run': Pose(
    (Limb(-45, 8, 0, 85), Limb(45, 8, 0, 90)), (Limb(60, 2, 0, 70), Limb(-32, 2, 0, 45)), (14, 0, 0)
  ),
  'cross': Pose((Limb(0, 88), Limb(0, 88))),
  'cheer': Pose((Limb(0, 150, 0, 10), Limb(0, 150, 0, 10)), (Limb(0, 12), Limb(0, 12))),
  'cactus': Pose((Limb(0, 85, 85, 85), Limb(0, 85, 85, 85))),
  'wave': Pose((Limb(0, 110, 80, 70), _DOWN)),
  'hips': Pose((_HIP, _HIP), (Limb(0, 9), Limb(0, 9))),
  'point': Pose((Limb(85, 5), _HIP), trunk=(0, -12, 0)),
  'reach': Pose((Limb(85, 8), Limb(85, 8))),
  'sit': Pose((Limb(35, 6, 0, 35), Limb(35, 6, 0, 35)), (Limb(86, 7, 0, 85), Limb(86, 7, 0, 85))),
  'kick': Pose((Limb(-25, 45), Limb(30, 40)), (Limb(75, 4, 0, 8), Limb(-5, 4, 0, 12)), (-14, 0, 0)),
  'step': Pose((Limb(-20, 8, 0, 40), Limb(40, 8, 0, 60)), (Limb(70, 3, 0, 75), Limb(0, 3))),
  'squat': Pose((Limb(80, 8, 0, 8), Limb(80, 8, 0, 8)), (Limb(95, 18, 0, 110),) * 2, (28, 0, 0)),
  'lunge': Pose((_HIP, _HIP), (Limb(75, 3, 0, 78), Limb(-35, 3, 0, 30))),
  'handstand': Pose(
    (Limb(172, 8), Limb(172, 8)), (Limb(8, 12, 0, 15), Limb(-8, 12, 0, 15)), root=180
  ),
  'star': Pose((Limb(0, 120), Limb(0, 120)), (Limb(0, 32), Limb(0, 32))),
  'tree': Pose((Limb(0, 165, 0, 20), Limb(0, 165, 0, 20)), (Limb(40, 60, 0, 115), Limb(0, 2))),
  'bow': Pose((Limb(20, 25), Limb(20, 25)), trunk=(55, 0, 0)),
  'box': Pose(
    (Limb(70, 5, 0, 60), Limb(35, 12, -20, 115)), (Limb(22, 8, 0, 20), Limb(-22, 8, 0, 20))
  ),
  'dance': Pose(
    (Limb(0, 140, 30, 40), Limb(30, 50, -60, 60)), (Limb(20, 20, 20, 35), Limb(0, 3)), (0, 15, 14)
  ),
  'carry': Pose((Limb(40, 6, -15, 55), Limb(40, 6, -15, 55)), trunk=(-5, 0, 0)),
  'side': Pose((Limb(0, 165), Limb(0, 30)), (Limb(0, 18), Limb(0, 18)), (0, 0, -28)),
}


def sample(rng) -> tuple[str, Pose]:
  """A pose's name and its angles, a few degrees off and sometimes mirrored."""
  name = str(rng.choice(list(POSES)))
  pose = POSES[name]

  def loose(limb, spread):
    values = np.array(limb) + rng.normal(0, 1, 4) * spread
    return Limb(values[0], values[1], values[2], max(values[3], 0.0))

  arms = [loose(limb, [9, 7, 8, 9]) for limb in pose.arms]
  legs = [loose(limb, [6, 3, 5, 6]) for limb in pose.legs]
  trunk = np.array(pose.trunk) + rng.normal(0, 4, 3)
  if rng.uniform() < 0.5:
    arms, legs, trunk = arms[::-1], legs[::-1], trunk * [1, -1, -1]
  return name, Pose(tuple(arms), tuple(legs), tuple(trunk), pose.root)


def frames(pose: Pose, lengths: dict[str, float]) -> dict[str, Bone]:
  """Forward kinematics.

  Args:
    pose: the angles.
    lengths: metres of trunk, neck, upper_arm, forearm, thigh, shin, and the half widths hip and
      shoulder.

  Returns:
    The bones pelvis, chest, head, and, with the suffixes _l and _r, upper_arm, forearm, hand,
    thigh, shin, foot. The pelvis is at the origin.
  """
  root = rotation(0, pose.root)
  lean, twist, side = pose.trunk
  chest = root @ rotation(0, lean) @ rotation(1, twist) @ rotation(2, -side)
  up = np.array([0.0, 1.0, 0.0])
  bones = {'pelvis': Bone(root, np.zeros(3)), 'chest': Bone(chest, root @ up * 0.04)}
  shoulders = bones['chest'].joint + chest @ up * lengths['trunk']
  neck = chest @ rotation(0, -0.4 * lean)
  bones['head'] = Bone(neck, shoulders + neck @ up * lengths['neck'])
  for k, (name, sign) in enumerate((('_l', 1.0), ('_r', -1.0))):
    arm = shoulders + chest @ np.array([sign * lengths['shoulder'], -0.045, 0])
    chain = ('upper_arm', 'forearm', 'hand')
    bones |= _limb(chain, name, pose.arms[k], sign, arm, chest, lengths, -1.0)
    hip = root @ np.array([sign * lengths['hip'], -0.03, 0])
    chain = ('thigh', 'shin', 'foot')
    bones |= _limb(chain, name, pose.legs[k], sign, hip, root, lengths, 1.0)
  return bones


def _limb(chain, suffix, limb: Limb, sign, joint, parent, lengths, hinge) -> dict[str, Bone]:
  """Three bones from a joint down; `hinge` is the sense of the middle joint about x."""
  out, twist = sign * limb.out, sign * limb.twist
  first = parent @ rotation(2, out) @ rotation(0, -limb.forward) @ rotation(1, twist)
  second = first @ rotation(0, hinge * limb.bend)
  middle = joint - first[:, 1] * lengths[chain[0]]
  end = middle - second[:, 1] * lengths[chain[1]]
  frames = (Bone(first, joint), Bone(second, middle), Bone(second, end))
  return {name + suffix: bone for name, bone in zip(chain, frames, strict=True)}
