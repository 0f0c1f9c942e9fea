"""Coordinates of each vertex on the person: along and around trunk, arms and legs, at rest.

They define where clothes end and how cloth is laid. Every part has its own coordinates for all
vertices, so that two panels of cloth that meet at a seam share no coordinates there.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from datagen.sources.people.data import BodyData

_FINGERS = ('thumb', 'index', 'middle', 'ring', 'pinky')
_BONES = {
  'arm': ('upperarm', 'lowerarm', 'hand', *_FINGERS),
  'forearm': ('lowerarm', 'hand', *_FINGERS),
  'leg': ('thigh', 'calf', 'foot', 'ball'),
  'head': ('head',),
}


class Chart(NamedTuple):
  """Coordinates of the V vertices, helpers included."""

  vertices: np.ndarray  # [V, 3] at rest
  at: Mapping[str, np.ndarray]  # where bones begin, [3] each
  floor: float  # the lowest y of the body
  height: float  # of the body
  arm_weight: np.ndarray  # [V] share of the arms' bones
  head_weight: np.ndarray  # [V]
  is_arm: np.ndarray  # [V] bool
  is_leg: np.ndarray  # [V] bool
  arm: np.ndarray  # [V] 0 at the shoulder, 1 at the elbow, 2 at the wrist
  leg: np.ndarray  # [V] 0 at the hip, 1 at the knee, 2 at the ankle
  # trunk, arm_l, arm_r, leg_l, leg_r -> [V, 2]: u is the share of a turn about it in [-1/2, 1/2], 0
  # in front and growing to the person's left; v is a length in heights of the person, 0 at the
  # floor: upwards on trunk and legs, towards the shoulder on arms.
  laid: Mapping[str, np.ndarray]


def chart(data: BodyData, vertices: np.ndarray, at: Mapping[str, np.ndarray]) -> Chart:
  """Measures a body.

  Args:
    data: groups and weights.
    vertices: [V, 3] the body at rest.
    at: where each bone begins (`rig.joints`).
  """
  x, y, z = vertices.T
  used = y[np.unique(data.groups['body'])]
  floor, height = float(used.min()), float(np.ptp(used))
  weight = {
    part: data.weights[:, [b.startswith(names) for b in data.bones]].sum(1)
    for part, names in _BONES.items()
  }
  hip, knee, ankle = (0.5 * (at[f'{b}_l'] + at[f'{b}_r'])[1] for b in ('thigh', 'calf', 'foot'))
  leg = np.where(y > knee, (hip - y) / (hip - knee), 1 + (knee - y) / (knee - ankle))
  up = (y - floor) / height
  middle = 0.5 * (at['pelvis'][2] + at['spine_03'][2])
  laid = {'trunk': np.stack([np.arctan2(x, z - middle) / (2 * np.pi), up], 1)}
  arm = {}
  for s in 'lr':
    arm[s], around, reach = _along_arm(vertices, at, s, weight['forearm'] > 0.5)
    down = (at[f'upperarm_{s}'][1] - floor - reach) / height
    laid[f'arm_{s}'] = np.stack([around, down], 1)
    line = np.stack([at[f'{b}_{s}'] for b in ('foot', 'calf', 'thigh')])
    center_x, center_z = (np.interp(y, line[:, 1], line[:, k]) for k in (0, 2))
    around = np.arctan2(x - center_x, z - center_z) / (2 * np.pi)
    laid[f'leg_{s}'] = np.stack([around, up], 1)
  return Chart(
    vertices=vertices,
    at=at,
    floor=floor,
    height=height,
    arm_weight=weight['arm'],
    head_weight=weight['head'],
    is_arm=weight['arm'] > 0.5,
    is_leg=weight['leg'] > 0.5,
    arm=np.where(x >= 0, arm['l'], arm['r']),
    leg=leg,
    laid=laid,
  )


def _along_arm(vertices, at, s, is_forearm):
  """[V] each: position along an arm, share of a turn about it, distance from the shoulder in dm."""
  shoulder, elbow, hand = (at[f'{b}_{s}'] for b in ('upperarm', 'lowerarm', 'hand'))
  upper, upper_around = _about(vertices, shoulder, elbow)
  lower, lower_around = _about(vertices, elbow, hand)
  place = np.where(is_forearm, 1 + lower, upper)
  lengths = np.linalg.norm(elbow - shoulder), np.linalg.norm(hand - elbow)
  reach = np.where(place < 1, place * lengths[0], lengths[0] + (place - 1) * lengths[1])
  return place, np.where(is_forearm, lower_around, upper_around), reach


def _about(vertices, start, end):
  """Position along a bone as a share of it, and the share of a turn about it, 0 facing +z."""
  length = np.linalg.norm(end - start)
  axis = (end - start) / length
  front = np.array([0.0, 0.0, 1.0]) - axis[2] * axis
  front /= np.linalg.norm(front)
  offset = vertices - start
  # Seen from the front, an arm that hangs has the person's left on the right, whichever arm it is.
  left = np.cross(front, axis)
  return offset @ axis / length, np.arctan2(offset @ left, offset @ front) / (2 * np.pi)
