"""Poses: which way every limb points, drawn from named families.

A limb's direction is (raise, turn) in degrees, in the frame of the chest (arms) or pelvis (legs): 0
raise hangs down, 90 is level, 180 is up; turn 0 is out to its own side, 90 forward, 180 across the
body, -90 backward. Limbs are swung the shortest way from where they rest, which twists no joint, so
skinning does not wring them. The skeleton is checked: limbs that run into each other, the trunk or
the head are drawn again.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from datagen.sources.people.data import BodyData
from datagen.sources.people.rig import bone_transforms, rotation, swing

TRIES = 24

# (raise, turn) of the upper part, (raise, turn) of the lower one, each as (low, high).
ARMS = {
  'hang': ((14, 26), (-15, 20), (12, 26), (10, 70)),
  'slant': ((38, 60), (-10, 25), (38, 60), (0, 35)),
  'out': ((80, 98), (-12, 12), (80, 98), (-10, 15)),
  'cactus': ((78, 100), (-5, 20), (158, 176), (0, 60)),
  'vee': ((122, 148), (0, 25), (125, 155), (0, 30)),
  'up': ((150, 168), (10, 50), (160, 176), (0, 60)),
  'wave': ((60, 95), (0, 25), (140, 172), (0, 40)),
  'forward': ((75, 100), (72, 90), (75, 100), (80, 95)),
  'hips': ((42, 54), (-25, -8), (50, 60), (142, 160)),
  'carry': ((10, 28), (20, 60), (70, 100), (75, 95)),
  'guard': ((25, 45), (50, 85), (120, 150), (80, 100)),
  'swing': ((25, 55), (75, 95), (70, 120), (80, 95)),
  'back': ((28, 55), (-100, -75), (25, 55), (-100, -70)),
  'fold': ((30, 42), (45, 70), (80, 98), (140, 158)),
  'phone': ((35, 55), (35, 65), (138, 152), (100, 130)),
  'head': ((100, 122), (5, 30), (112, 135), (165, 195)),
}
LEGS = {
  'stand': ((2, 7), (0, 0), (0, 5), (0, 0)),
  'wide': ((14, 27), (0, 8), (12, 26), (0, 8)),
  'step': ((16, 34), (82, 92), (4, 22), (85, 95)),
  'trail': ((12, 26), (-100, -85), (26, 50), (-95, -85)),
  'stride': ((60, 88), (80, 92), (5, 30), (-95, -85)),
  'drive': ((14, 32), (-95, -85), (65, 100), (-95, -85)),
  'lunge': ((62, 84), (74, 88), (0, 10), (-90, -90)),
  'press': ((34, 50), (-95, -82), (45, 62), (-95, -85)),
  'side': ((45, 58), (8, 25), (2, 12), (0, 30)),
  'stretch': ((38, 52), (-5, 8), (38, 52), (-5, 8)),
  'sit': ((82, 94), (72, 88), (0, 14), (70, 95)),
  'long': ((84, 95), (68, 88), (84, 95), (70, 90)),
  'squat': ((92, 112), (52, 72), (14, 30), (-100, -80)),
  'cross': ((76, 86), (30, 42), (78, 88), (150, 162)),
  'kneel': ((2, 10), (0, 60), (84, 94), (-94, -86)),
  'kick': ((70, 112), (78, 92), (66, 112), (80, 94)),
  'side kick': ((62, 95), (0, 15), (62, 95), (0, 12)),
  'lift': ((70, 102), (75, 90), (0, 25), (-95, -85)),
  'tree': ((52, 64), (20, 34), (44, 54), (178, 196)),
  'heel': ((2, 12), (0, 90), (70, 112), (-95, -85)),
  'behind': ((45, 80), (-95, -82), (45, 84), (-95, -85)),
  'split': ((66, 86), (0, 10), (66, 86), (0, 10)),
}
ASYMMETRIC = (
  'hang', 'slant', 'out', 'cactus', 'vee', 'up', 'wave', 'forward', 'hips', 'carry', 'guard',
  'swing', 'back', 'phone',
)  # fmt: skip
_FREE = (*((a, a) for a in ARMS if a not in ('phone', 'fold')), *([(None, None)] * 10))


class Family(NamedTuple):
  """Poses of one kind; degrees as (low, high)."""

  legs: tuple[tuple[str, str], ...]  # left and right
  arms: tuple[tuple[str | None, str | None], ...] = _FREE  # None: any of `ASYMMETRIC`
  bend: tuple[float, float] = (-6, 10)  # of the spine, forward
  pitch: tuple[float, float] = (-3, 5)  # of the whole body, forward
  roll: tuple[float, float] = (-4, 4)  # of the whole body, to its right, about z
  look: tuple[float, float] = (-12, 12)  # of the head, down
  upright: bool = False  # a skirt hangs as it should
  share: float = 1.0  # how often, in comparison


FAMILIES = {
  'stand': Family((('stand', 'stand'), ('wide', 'wide')), upright=True, share=4),
  'walk': Family(
    (('step', 'trail'),), (('back', 'swing'), ('swing', 'back'), (None, None)), upright=True, share=2
  ),
  'run': Family((('stride', 'drive'),), (('back', 'swing'), ('swing', 'swing')), pitch=(5, 20)),
  'lunge': Family((('lunge', 'press'),), share=1.5),
  'side lunge': Family((('side', 'stretch'),)),
  'sit': Family((('sit', 'sit'),), share=2),
  'sit on the floor': Family((('long', 'long'),), bend=(-10, 12)),
  'cross-legged': Family(
    (('cross', 'cross'),), (('carry', 'carry'), ('out', 'out'), ('up', 'up'), ('wave', 'slant'))
  ),
  'kneel': Family((('kneel', 'kneel'),)),
  'half kneel': Family((('sit', 'kneel'),)),
  'squat': Family(
    (('squat', 'squat'),), (('forward', 'forward'), ('out', 'out'), ('up', 'up')), pitch=(10, 25)
  ),
  'kick': Family((('kick', 'stand'),), pitch=(-20, 0), share=2),
  'side kick': Family((('side kick', 'stand'),), roll=(5, 25), share=1.5),
  'knee up': Family((('lift', 'stand'),)),
  'tree': Family((('tree', 'stand'),), (('up', 'up'), ('out', 'out'), ('hips', 'hips'))),
  'heel up': Family((('heel', 'stand'),)),
  'leap': Family((('kick', 'behind'),), (('vee', 'vee'), ('out', 'out'), ('forward', 'out'))),
  'straddle jump': Family((('split', 'split'),), (('out', 'out'), ('vee', 'vee'), ('up', 'up'))),
  'scale': Family(
    (('behind', 'stand'),), (('forward', 'forward'), ('out', 'out'), ('forward', 'back')),
    bend=(-10, 0), pitch=(15, 45), look=(-35, -10),
  ),
  'bow': Family((('stand', 'stand'),), bend=(35, 70), upright=True),
  'lean': Family((('wide', 'wide'),), roll=(12, 28), upright=True),
  'handstand': Family(
    (('stand', 'stand'), ('wide', 'wide'), ('step', 'trail'), ('split', 'split'), ('lift', 'stand')),
    (('up', 'up'),), roll=(172, 188), look=(-30, 0), share=2,
  ),
  'cartwheel': Family(
    (('split', 'split'), ('stretch', 'stretch')), (('vee', 'vee'),), roll=(100, 165), share=1.5
  ),
  'crawl': Family(
    (('sit', 'sit'), ('sit', 'squat')), (('forward', 'forward'),), pitch=(80, 92), look=(-45, -20)
  ),
  'plank': Family((('stand', 'stand'),), (('forward', 'forward'),), pitch=(60, 78), look=(-40, -10)),
  'fly': Family(
    (('stand', 'stand'), ('wide', 'wide'), ('heel', 'stand')),
    (('up', 'up'), ('vee', 'vee'), ('up', 'hang'), ('out', 'out')), pitch=(65, 95), look=(-50, -20),
  ),
  'lie': Family(
    (('stand', 'wide'), ('wide', 'wide'), ('lift', 'stand')),
    (('slant', 'slant'), ('out', 'out'), ('head', 'slant')), pitch=(-95, -80),
  ),
}  # fmt: skip


class Pose(NamedTuple):
  """How one body is bent."""

  family: str
  turns: Mapping[str, np.ndarray]  # bone -> [3, 3], for `rig.bone_transforms`


def sample_family(rng: np.random.Generator, *, upright: bool) -> str:
  """One of the families' names; of those that go with a skirt where `upright`."""
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
  """A pose of a family in which this skeleton does not run into itself, if one is found.

  Args:
    rng: what chance is drawn from.
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
  """Values at shares t of ranges."""
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
  """Thigh and shin; the foot is pointed where the leg leaves the ground."""
  s = 'l' if side > 0 else 'r'
  hip, knee, ankle = (at[f'{b}_{s}'] for b in ('thigh', 'calf', 'foot'))
  thigh = swing(knee - hip, direction(angles[0], angles[1], side))
  turns[f'thigh_{s}'] = thigh
  turns[f'calf_{s}'] = swing(ankle - knee, thigh.T @ direction(angles[2], angles[3], side))
  if angles[2] > 60 or angles[0] > 100:
    turns[f'foot_{s}'] = rotation([1, 0, 0], 30)


def _curl(turns, at, side, degrees):
  """Fingers bend about the line of the knuckles."""
  s = 'l' if side > 0 else 'r'
  knuckles = at[f'pinky_01_{s}'] - at[f'index_01_{s}']
  if degrees and np.linalg.norm(knuckles) > 0:
    bent = rotation(side * knuckles, degrees)
    for finger in ('index', 'middle', 'ring', 'pinky'):
      turns |= {f'{finger}_0{k}_{s}': bent for k in (1, 2)}


def clearance(
  data: BodyData,
  at: Mapping[str, np.ndarray],
  turns: Mapping[str, np.ndarray],
  *,
  girth: float,
) -> float:
  """The least distance between limbs as capsules, and of limbs from trunk and head; < 0 inside."""
  transforms = dict(zip(data.bones, bone_transforms(data, at, turns), strict=True))

  def point(bone, start=None):
    m = transforms[bone]
    return m[:3, :3] @ (at[bone] if start is None else start) + m[:3, 3]

  size = np.linalg.norm(at['neck_01'] - at['pelvis']) / 5.0
  capsules = {}
  for s in 'lr':
    hip, knee, ankle = (point(f'{b}_{s}') for b in ('thigh', 'calf', 'foot'))
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
  room = [np.inf]
  for a, b in _PAIRS:
    (p, q, r), (u, v, w) = capsules[a], capsules[b]
    room.append(segment_distance(p, q, u, v) - r - w)
  return float(min(room))


_PAIRS = tuple(
  [(f'forearm_{a}', f'{part}_{b}') for a in 'lr' for b in 'lr' for part in ('trunk', 'thigh', 'shin')]
  + [('forearm_l', 'forearm_r'), ('shin_l', 'shin_r'), ('shin_l', 'thigh_r'), ('shin_r', 'thigh_l')]
  + [(f'{part}_{s}', 'head') for s in 'lr' for part in ('forearm', 'upper', 'shin', 'thigh')]
  + [('shin_l', 'trunk_l'), ('shin_r', 'trunk_r'), ('forearm_l', 'upper_r'), ('forearm_r', 'upper_l')]
)  # fmt: skip


def segment_distance(p, q, u, v) -> float:
  """The distance between the segments pq and uv (Ericson, Real-Time Collision Detection, 5.1.9)."""
  d, e, r = q - p, v - u, p - u
  a, b, c, f, g = d @ d, d @ e, d @ r, e @ r, e @ e
  over = a * g - b * b
  s = np.clip((b * f - c * g) / over, 0, 1) if over > 1e-12 else 0.0
  t = (b * s + f) / g if g > 0 else 0.0
  if not 0 <= t <= 1:
    t = float(np.clip(t, 0, 1))
    s = np.clip((b * t - c) / a, 0, 1) if a > 0 else 0.0
  return float(np.linalg.norm(r + s * d - t * e))
