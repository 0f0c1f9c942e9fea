"""Poses: the directions of all limbs, drawn from the families of `families`.

A limb is rotated the shortest way from its rest direction, so no joint twists and skinning causes
no candy-wrapper artefacts. Poses in which limbs intersect each other, the trunk or the head are
drawn again.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from datagen.sources.people.clearance import clearance
from datagen.sources.people.data import BodyData
from datagen.sources.people.families import ARMS, ASYMMETRIC, FAMILIES, LEGS
from datagen.sources.people.rig import rotation, swing

TRIES = 24


class Pose(NamedTuple):
  """The rotations of one body."""

  family: str
  turns: Mapping[str, np.ndarray]  # bone -> [3, 3], for `rig.bone_transforms`


def sample_family(rng: np.random.Generator, *, upright: bool) -> str:
  """The name of a random family; if `upright`, one that suits a skirt."""
  names = [n for n, f in FAMILIES.items() if f.upright or not upright]
  share = np.array([FAMILIES[n].share for n in names])
  return names[rng.choice(len(names), p=share / share.sum())]


def sample(
  rng: np.random.Generator,
  data: BodyData,
  at: Mapping[str, np.ndarray],
  family: str,
  *,
  girth: float,
) -> Pose:
  """A random pose of a family in which this skeleton does not intersect itself, if one is found.

  Args:
    rng: random generator.
    data: the rig.
    at: where each bone begins (`rig.joints`).
    family: a key of `FAMILIES`.
    girth: half the trunk's depth.
  """
  drawn = []
  for _ in range(TRIES):
    turns = _turns(rng, at, FAMILIES[family])
    room = clearance(data, at, turns, girth=girth)
    drawn.append((room, turns))
    if room >= 0:
      break
  return Pose(family, max(drawn, key=lambda pair: pair[0])[1])


def direction(rise: float, turn: float, side: int) -> np.ndarray:
  """The unit vector [3] of a limb on a side: 1 is the left one, at +x, and -1 the right one."""
  a, b = np.deg2rad(rise), np.deg2rad(turn)
  return np.array([side * np.sin(a) * np.cos(b), -np.cos(a), np.sin(a) * np.sin(b)])


def _turns(rng, at, family):
  """Turns of all bones."""
  turns = {}
  mirrored = rng.random() < 0.5
  arms = family.arms[rng.integers(len(family.arms))]
  legs = family.legs[rng.integers(len(family.legs))]
  arms = [a or ASYMMETRIC[rng.integers(len(ASYMMETRIC))] for a in arms]
  alike = rng.random() < 0.5  # the two sides then differ little
  drawn = rng.random((2, 8))
  if alike:
    drawn[1] = np.clip(drawn[0] + rng.normal(0, 0.1, 8), 0, 1)
  for k, side in enumerate((1, -1)):
    which = 1 - k if mirrored else k
    _swing_arm(turns, at, side, _between(ARMS[arms[which]], drawn[k, :4]))
    _swing_leg(turns, at, side, _between(LEGS[legs[which]], drawn[k, 4:]))
    _curl(turns, at, side, rng.uniform(0, 75) * (rng.random() < 0.5))
  bend, lean, twist = rng.uniform(*family.bend), rng.uniform(-10, 10), rng.uniform(-16, 16)
  third = rotation([1, 0, 0], bend / 3) @ rotation([0, 0, 1], lean / 3)
  third = third @ rotation([0, 1, 0], twist / 3)
  turns |= {f'spine_0{k}': third for k in (1, 2, 3)}
  turns['neck_01'] = rotation([0, 1, 0], rng.uniform(-20, 20))
  look = rotation([1, 0, 0], rng.uniform(*family.look))
  turns['head'] = look @ rotation([0, 1, 0], rng.uniform(-18, 18))
  roll = rng.uniform(*family.roll) * (-1 if mirrored else 1)
  whole = rotation([1, 0, 0], rng.uniform(*family.pitch)) @ rotation([0, 0, 1], roll)
  turns['pelvis'] = rotation([0, 1, 0], rng.uniform(-12, 12)) @ whole
  return turns


def _between(ranges, t):
  """Interpolates ranges at shares t."""
  return [low + (high - low) * x for (low, high), x in zip(ranges, t, strict=True)]


def _swing_arm(turns, at, side, angles):
  """Clavicle, upper and lower arm."""
  s = 'l' if side > 0 else 'r'
  shoulder, elbow, hand = (at[f'{b}_{s}'] for b in ('upperarm', 'lowerarm', 'hand'))
  lift = rotation([0, 0, 1], side * 0.25 * max(angles[0] - 60, 0))
  turns[f'clavicle_{s}'] = lift
  upper = swing(elbow - shoulder, lift.T @ direction(angles[0], angles[1], side))
  turns[f'upperarm_{s}'] = upper
  lower = (lift @ upper).T @ direction(angles[2], angles[3], side)
  turns[f'lowerarm_{s}'] = swing(hand - elbow, lower)


def _swing_leg(turns, at, side, angles):
  """Thigh and shin; the foot is pointed if the leg leaves the ground."""
  s = 'l' if side > 0 else 'r'
  hip, knee, ankle = (at[f'{b}_{s}'] for b in ('thigh', 'calf', 'foot'))
  thigh = swing(knee - hip, direction(angles[0], angles[1], side))
  turns[f'thigh_{s}'] = thigh
  turns[f'calf_{s}'] = swing(ankle - knee, thigh.T @ direction(angles[2], angles[3], side))
  if angles[2] > 60 or angles[0] > 100:
    turns[f'foot_{s}'] = rotation([1, 0, 0], 30)


def _curl(turns, at, side, degrees):
  """Bends the fingers about the line of the knuckles."""
  s = 'l' if side > 0 else 'r'
  knuckles = at[f'pinky_01_{s}'] - at[f'index_01_{s}']
  if degrees and np.linalg.norm(knuckles) > 0:
    bent = rotation(side * knuckles, degrees)
    for finger in ('index', 'middle', 'ring', 'pinky'):
      turns |= {f'{finger}_0{k}_{s}': bent for k in (1, 2)}
