"""Families of poses: ranges for the directions of arms and legs, and for the whole body's rotation.

A limb's direction is (raise, turn) in degrees, in the frame of the chest (arms) or pelvis (legs).
Raise 0 hangs down, 90 is level, 180 is up. Turn 0 points out to its own side, 90 forward, 180
across the body, -90 backward.
"""

from typing import NamedTuple

# Raise and turn of the upper part, raise and turn of the lower one, each as (low, high).
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
  'cross': ((76, 86), (34, 46), (76, 86), (138, 150)),
  'cross behind': ((76, 86), (24, 34), (78, 88), (164, 176)),
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
  'hang',
  'slant',
  'out',
  'cactus',
  'vee',
  'up',
  'wave',
  'forward',
  'hips',
  'carry',
  'guard',
  'swing',
  'back',
  'phone',
)
_FREE = (*((a, a) for a in ARMS if a != 'phone'), *([(None, None)] * 10))


class Family(NamedTuple):
  """Similar poses; ranges in degrees as (low, high)."""

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
    (('step', 'trail'),),
    (('back', 'swing'), ('swing', 'back'), (None, None)),
    upright=True,
    share=2,
  ),
  'run': Family((('stride', 'drive'),), (('back', 'swing'), ('swing', 'swing')), pitch=(5, 20)),
  'lunge': Family((('lunge', 'press'),), share=1.5),
  'side lunge': Family((('side', 'stretch'),)),
  'sit': Family((('sit', 'sit'),), share=2),
  'sit on the floor': Family((('long', 'long'),), bend=(-10, 12)),
  'cross-legged': Family(
    (('cross', 'cross behind'),),
    (('carry', 'carry'), ('out', 'out'), ('up', 'up'), ('wave', 'slant')),
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
    (('behind', 'stand'),),
    (('forward', 'forward'), ('out', 'out'), ('forward', 'back')),
    bend=(-10, 0),
    pitch=(15, 45),
    look=(-35, -10),
  ),
  'bow': Family((('stand', 'stand'),), bend=(35, 70), upright=True),
  'lean': Family((('wide', 'wide'),), roll=(12, 28), upright=True),
  'handstand': Family(
    (
      ('stand', 'stand'),
      ('wide', 'wide'),
      ('step', 'trail'),
      ('split', 'split'),
      ('lift', 'stand'),
    ),
    (('up', 'up'),),
    roll=(172, 188),
    look=(-30, 0),
    share=2,
  ),
  'cartwheel': Family(
    (('split', 'split'), ('stretch', 'stretch')), (('vee', 'vee'),), roll=(100, 165), share=1.5
  ),
  'crawl': Family(
    (('sit', 'sit'), ('sit', 'squat')), (('forward', 'forward'),), pitch=(80, 92), look=(-45, -20)
  ),
  'plank': Family(
    (('stand', 'stand'),), (('forward', 'forward'),), pitch=(60, 78), look=(-40, -10)
  ),
  'fly': Family(
    (('stand', 'stand'), ('wide', 'wide'), ('heel', 'stand')),
    (('up', 'up'), ('vee', 'vee'), ('up', 'hang'), ('out', 'out')),
    pitch=(65, 95),
    look=(-50, -20),
  ),
  'lie': Family(
    (('stand', 'wide'), ('wide', 'wide'), ('lift', 'stand')),
    (('slant', 'slant'), ('out', 'out'), ('head', 'slant')),
    pitch=(-95, -80),
  ),
}
