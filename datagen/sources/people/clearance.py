"""Clearance between the limbs of a skeleton, as capsules, to find poses in which they intersect."""

import itertools
from collections.abc import Mapping

import numpy as np

from datagen.sources.people.data import BodyData
from datagen.sources.people.rig import bone_transforms

_ARM_PAIRS = itertools.product(('forearm_l', 'forearm_r'), ('trunk', 'thigh', 'shin'), 'lr')
# Capsules that may meet when a skeleton is bent.
_PAIRS = (
  *((arm, f'{part}_{s}') for arm, part, s in _ARM_PAIRS),
  *((f'{part}_{s}', 'head') for s in 'lr' for part in ('forearm', 'upper', 'shin', 'thigh')),
  ('forearm_l', 'forearm_r'),
  ('forearm_l', 'upper_r'),
  ('forearm_r', 'upper_l'),
  ('shin_l', 'shin_r'),
  ('shin_l', 'thigh_r'),
  ('shin_r', 'thigh_l'),
  ('shin_l', 'trunk_l'),
  ('shin_r', 'trunk_r'),
)


def clearance(
  data: BodyData,
  at: Mapping[str, np.ndarray],
  turns: Mapping[str, np.ndarray],
  *,
  girth: float,
) -> float:
  """The minimum distance between limbs, trunk and head as capsules, dm; negative if they intersect.

  Args:
    data: the rig.
    at: where each bone begins (`rig.joints`).
    turns: bone -> [3, 3] rotation.
    girth: half the trunk's depth.
  """
  transforms = dict(zip(data.bones, bone_transforms(data, at, turns), strict=True))

  def point(bone, start=None):
    m = transforms[bone]
    return m[:3, :3] @ (at[bone] if start is None else start) + m[:3, 3]

  size = np.linalg.norm(at['neck_01'] - at['pelvis']) / 5.0
  capsules = {}
  for s in 'lr':
    hip, knee = (point(f'{b}_{s}') for b in ('thigh', 'calf'))
    shoulder, elbow, hand = (point(f'{b}_{s}') for b in ('upperarm', 'lowerarm', 'hand'))
    tip = hand + 0.6 * (hand - elbow)
    capsules[f'forearm_{s}'] = (elbow, tip, 0.3 * size)
    capsules[f'thigh_{s}'] = (0.7 * hip + 0.3 * knee, knee, 0.6 * size)
    capsules[f'shin_{s}'] = (knee, point(f'ball_{s}'), 0.4 * size)
    capsules[f'upper_{s}'] = (shoulder, elbow, 0.35 * size)
    inner = 0.75 * shoulder + 0.25 * point('neck_01')
    capsules[f'trunk_{s}'] = (0.3 * inner + 0.7 * hip, inner, girth)
  skull = point('head', at['head'] + [0, 0.6 * size, 0.5 * size])
  capsules['head'] = (point('head'), skull, 0.85 * size)
  room = np.inf
  for first, second in _PAIRS:
    (p, q, r), (u, v, w) = capsules[first], capsules[second]
    room = min(room, segment_distance(p, q, u, v) - r - w)
  return float(room)


def segment_distance(p, q, u, v) -> float:
  """The distance between the segments pq and uv (Ericson, Real-Time Collision Detection, 5.1.9)."""
  d, e, r = q - p, v - u, p - u
  a, b, c, f, g = d @ d, d @ e, d @ r, e @ r, e @ e
  over = a * g - b * b
  s = np.clip((b * f - c * g) / over, 0, 1) if over > 1e-12 else 0.0
  t = (b * s + f) / g if g > 0 else -1.0  # of a point, either end will do
  if not 0 <= t <= 1:
    t = float(np.clip(t, 0, 1))
    s = np.clip((b * t - c) / a, 0, 1) if a > 0 else 0.0
  return float(np.linalg.norm(r + s * d - t * e))
