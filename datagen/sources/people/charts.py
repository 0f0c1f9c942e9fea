"""Where on the person each vertex is: coordinates along and around trunk, arms and legs, at rest.

They say where clothes end and how cloth is laid: `arm` runs from 0 at the shoulder over 1 at the
elbow to 2 at the wrist, `leg` from 0 at the hip over 1 at the knee to 2 at the ankle, `around` is
the share of a turn about trunk or limb, 0 in front, and `along` is a length in heights of the
person: upwards on trunk and legs, towards the shoulder on arms, and continuous between them.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from datagen.sources.people.data import BodyData

PARTS = ('trunk', 'arm', 'leg')
_FINGERS = ('thumb', 'index', 'middle', 'ring', 'pinky')


class Chart(NamedTuple):
  """Coordinates of the V vertices, helpers included."""

  vertices: np.ndarray  # [V, 3] at rest
  at: Mapping[str, np.ndarray]  # where bones begin, [3] each
  floor: float  # the lowest y of the body
  height: float  # of the body
  arm: np.ndarray  # [V]; meaningful where `limb` is 1
  leg: np.ndarray  # [V]
  limb: np.ndarray  # [V] index into PARTS: which of them a vertex belongs to most
  arm_weight: np.ndarray  # [V] share of the arms' bones
  head_weight: np.ndarray  # [V]
  around: np.ndarray  # [V] in [-1/2, 1/2], growing to the person's left
  along: np.ndarray  # [V] in heights, 0 at the floor


def chart(data: BodyData, vertices: np.ndarray, at: Mapping[str, np.ndarray]) -> Chart:
  """Measures a body.

  Args:
    data: groups and weights.
    vertices: [V, 3] the body at rest.
    at: where each bone begins (`rig.joints`).
  """
  x, y, z = vertices.T
  used = y[np.unique(data.groups['body'])]
  low, high = float(used.min()), float(used.max())
  share = {
    kind: sum(
      (data.weights[:, k] for k, b in enumerate(data.bones) if b.startswith(prefixes)),
      np.zeros(len(vertices)),
    )
    for kind, prefixes in {
      'arm': ('upperarm', 'lowerarm', 'hand', *_FINGERS),
      'forearm': ('lowerarm', 'hand', *_FINGERS),
      'leg': ('thigh', 'calf', 'foot', 'ball'),
      'head': ('head',),
    }.items()
  }
  limb = np.where(share['arm'] > 0.5, 1, np.where(share['leg'] > 0.5, 2, 0))

  hip, knee, ankle = (0.5 * (at[f'{b}_l'] + at[f'{b}_r'])[1] for b in ('thigh', 'calf', 'foot'))
  leg = np.where(y > knee, (hip - y) / (hip - knee), 1 + (knee - y) / (knee - ankle))

  arm, around, along = np.zeros_like(x), np.zeros_like(x), (y - low) / (high - low)
  middle = 0.5 * (at['pelvis'][2] + at['spine_03'][2])
  around = np.arctan2(x, z - middle)
  for s, left in (('l', x >= 0), ('r', x < 0)):
    shoulder, elbow, hand = (at[f'{b}_{s}'] for b in ('upperarm', 'lowerarm', 'hand'))
    upper, angle = _about(vertices, shoulder, elbow)
    lower, lower_angle = _about(vertices, elbow, hand)
    own = np.where(share['forearm'] > 0.5, 1 + lower, upper)
    arm = np.where(left, own, arm)
    angle = np.where(share['forearm'] > 0.5, lower_angle, angle)
    first, second = np.linalg.norm(elbow - shoulder), np.linalg.norm(hand - elbow)
    reach = np.where(own < 1, own * first, first + (own - 1) * second)
    mine = left & (limb == 1)
    around = np.where(mine, angle, around)
    along = np.where(mine, (shoulder[1] - low - reach) / (high - low), along)
    hip, knee, ankle = (at[f'{b}_{s}'] for b in ('thigh', 'calf', 'foot'))
    path = np.stack([ankle, knee, hip])
    center = np.stack([np.interp(y, path[:, 1], path[:, k]) for k in (0, 2)])
    mine = left & (limb == 2)
    around = np.where(mine, np.arctan2(x - center[0], z - center[1]), around)
  return Chart(
    vertices=vertices,
    at=at,
    floor=low,
    height=high - low,
    arm=arm,
    leg=leg,
    limb=limb,
    arm_weight=share['arm'],
    head_weight=share['head'],
    around=around / (2 * np.pi),
    along=along,
  )


def _about(vertices, start, end):
  """Along a bone as a share of it, and the angle about it, 0 where it looks to +z."""
  axis = (end - start) / np.linalg.norm(end - start)
  front = np.array([0.0, 0.0, 1.0]) - axis[2] * axis
  front /= np.linalg.norm(front)
  offset = vertices - start
  angle = np.arctan2(offset @ np.cross(axis, front), offset @ front)
  return offset @ axis / np.linalg.norm(end - start), angle
