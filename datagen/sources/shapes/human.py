"""People: a dressed body hung on a posed skeleton. At rest the face looks to +z.

Parts are drawn around their joint at rest, painted there, so that cloth patterns follow the limb,
and then carried by the bone's frame (`poses`). Lengths are metres; the pelvis is the origin.
"""

from typing import NamedTuple

import numpy as np

from datagen.sources.shapes import heads, poses, solids
from datagen.sources.shapes import materials as mt
from datagen.sources.shapes.parts import Part, ahead, mirror, paint, texels


class Clothes(NamedTuple):
  """What is worn where."""

  skin: mt.Material
  shirt: mt.Material
  sleeve: mt.Material
  cuff: mt.Material  # forearm
  trousers: mt.Material
  leg: mt.Material  # shin
  shoe: mt.Material
  skirt: mt.Material | None
  coat: bool


# What is on the front of a shirt, and how often.
FRONTS = {
  'plain': 0.42,
  'print': 0.26,
  'tie': 0.06,
  'buttons': 0.08,
  'waistcoat': 0.08,
  'band': 0.1,
}

# Poses in which a skirt still hangs down around both legs.
_UPRIGHT = (
  'stand',
  'wide',
  'walk',
  'cross',
  'cheer',
  'cactus',
  'wave',
  'hips',
  'point',
  'reach',
  'bow',
  'carry',
  'side',
  'dance',
)


def build(rng: np.random.Generator) -> list[Part]:
  """One person."""
  name, pose = poses.sample(rng)
  colors = mt.scheme(rng)
  size = rng.uniform(0.88, 1.08)
  stout = rng.uniform(0.82, 1.35)
  child = rng.uniform() < 0.15
  leg, arm = rng.normal(1.0, 0.05, 2).clip(0.9, 1.1) * (0.82 if child else 1.0)
  shoulder = rng.uniform(0.155, 0.205) * (0.5 + 0.5 * stout)
  lengths = {
    'trunk': 0.49 * size,
    'neck': 0.075,
    'upper_arm': 0.285 * size * arm,
    'forearm': 0.25 * size * arm,
    'thigh': 0.43 * size * leg,
    'shin': 0.42 * size * leg,
    'hip': 0.09 * (0.5 + 0.5 * stout),
    'shoulder': shoulder,
  }
  skin = skin_tone(rng)
  clothes = dress(rng, colors, skin, skirted=name in _UPRIGHT)
  at_rest = {
    'pelvis': pelvis(rng, lengths, stout, clothes),
    'chest': chest(rng, lengths, stout, clothes, colors),
    'head': heads.head(rng, skin, colors, size=rng.uniform(1.0, 1.15) * (1.12 if child else 1.0)),
    'upper_arm': [
      paint(segment(lengths['upper_arm'], 0.06 * stout, 0.048 * stout), clothes.sleeve)
    ],
    'forearm': [paint(segment(lengths['forearm'], 0.047 * stout, 0.035), clothes.cuff)],
    'hand': hand(clothes),
    'thigh': [paint(segment(lengths['thigh'], 0.095 * stout, 0.066 * stout), clothes.trousers)],
    'shin': [paint(segment(lengths['shin'], 0.067 * stout, 0.046), clothes.leg)],
    'foot': foot(rng, clothes),
  }
  parts = []
  for bone, frame in poses.frames(pose, lengths).items():
    group = at_rest[bone.removesuffix('_l').removesuffix('_r')]
    if bone.endswith('_r'):
      group = [mirror(p) for p in group]
    parts += [p._replace(vertices=p.vertices @ frame.rotation.T + frame.joint) for p in group]
  return parts


def skin_tone(rng) -> np.ndarray:
  """From dark brown to pale, a little red or yellow."""
  t = rng.uniform()
  tone = (1 - t) * np.array([0.36, 0.22, 0.15]) + t * np.array([0.88, 0.7, 0.58])
  return np.clip(tone + rng.normal(0, 0.015, 3), 0.1, 0.9)


def dress(rng, colors: mt.Scheme, skin, *, skirted: bool) -> Clothes:
  """Shirt, trousers, shorts, skirt, dress, overall or coat, and shoes."""
  bare = mt.plain(skin)
  top = mt.fabric(rng, (colors.main, colors.second, colors.accent), period=rng.uniform(0.16, 0.3))
  if rng.uniform() < 0.2:  # hoops, as sports shirts have
    tones = mt.close([colors.main, colors.second, colors.accent], mt.PATTERN)
    top = mt.stripes(rng, tones, period=0.2, angle=1)
  denim = mt.hsv(rng.uniform(0.56, 0.66), rng.uniform(0.3, 0.6), rng.uniform(0.28, 0.6))
  low = [colors.second, colors.accent, denim, mt.neutral(rng), mt.shade(colors.main, 0.5)]
  low = low[rng.integers(5)]
  bottom = (
    mt.plain(low) if rng.uniform() < 0.75 else mt.fabric(rng, (low, colors.main, skin), period=0.22)
  )
  kind = rng.choice(
    ['shirt', 'shorts', 'skirt', 'dress', 'overall', 'coat'], p=[0.4, 0.2, 0.1, 0.1, 0.1, 0.1]
  )
  if kind in ('skirt', 'dress') and not skirted:
    kind = 'shorts'
  length = rng.uniform()  # of sleeves
  sleeve = bare if length < 0.12 and kind != 'coat' else top
  cuff = bare if length < 0.55 and kind != 'coat' else top
  leg = bottom
  if kind in ('shorts', 'skirt', 'dress'):
    leg = bare if rng.uniform() < 0.6 else mt.plain(colors.accent)
  if kind == 'overall':
    bottom = leg = top
  thigh = bare if kind in ('skirt', 'dress') else bottom
  skirt = {'skirt': bottom, 'dress': top, 'coat': top}.get(kind) if skirted else None
  shoe = mt.plain(
    [mt.neutral(rng) * 0.5, colors.accent, mt.shade(colors.wood, 0.6)][rng.integers(3)]
  )
  return Clothes(bare, top, sleeve, cuff, thigh, leg, shoe, skirt, kind == 'coat')


def segment(length, top, bottom) -> solids.Solid:
  """A limb down from its joint, with round ends that fill the joints."""
  t = np.array([-0.12, -0.08, 0.0, 0.3, 0.7, 1.0, 1.06, 1.1])
  r = np.interp(t, [0, 0.3, 1], [top, top * 1.02, bottom])
  r = r * np.array([0.35, 0.75, 1, 1, 1, 1, 0.75, 0.35])
  return solids.lathe(np.stack([r, -length * t], 1), sides=12)


def pelvis(rng, lengths, stout, clothes: Clothes) -> list[Part]:
  """Hips, belt, and a skirt or coat tails."""
  w, d = (lengths['hip'] + 0.085 * stout), 0.105 * stout
  y = np.array([-0.14, -0.1, -0.02, 0.06, 0.12])
  width = np.array([0.5, 0.92, 1.0, 0.96, 0.85])[:, None] * [w, d]
  path = np.stack([0 * y, y, 0 * y], 1)
  cloth = clothes.trousers if clothes.skirt is None else clothes.skirt
  parts = [paint(solids.tube(path, width, sides=16, up=(0, 0, 1)), cloth)]
  if rng.uniform() < 0.4:
    ring = solids.tube(
      [[0, 0.08, 0], [0, 0.12, 0]], [[w * 0.93, d * 0.96]] * 2, sides=16, up=(0, 0, 1)
    )
    parts.append(paint(ring, mt.plain(mt.neutral(rng) * 0.55)))
  if clothes.skirt is not None:
    drop = rng.uniform(0.25, 0.75) * (lengths['thigh'] + lengths['shin'])
    flare = rng.uniform(1.05, 1.9)
    t = np.linspace(0, 1, 6)[:, None]
    path = np.concatenate([0 * t, 0.06 - t * (drop + 0.06), 0 * t], 1)
    size = np.array([w, d]) * 1.03 * (1 + (flare - 1) * t)
    parts.append(paint(solids.tube(path, size, sides=18, up=(0, 0, 1)), clothes.skirt))
  return parts


def chest(rng, lengths, stout, clothes: Clothes, colors) -> list[Part]:
  """The trunk with shoulders and neck, and what it carries."""
  h, w = lengths['trunk'], lengths['shoulder']
  d = rng.uniform(0.1, 0.125) * stout
  belly = rng.uniform(0.9, 1.15) * stout**0.5
  y = np.array([-0.02, 0.12, 0.35, 0.6, 0.8, 0.93, 1.0, 1.03]) * h
  half = np.array([0.84, 0.82, 0.88, 1.0, 1.06, 1.0, 0.7, 0.35])[:, None] * [w, 0]
  half[:, 1] = np.array([0.95 * belly, belly, belly, 1.05, 1.0, 0.85, 0.6, 0.5]) * d
  path = np.stack([0 * y, y, 0 * y], 1)
  trunk = solids.tube(path, half, sides=18, up=(0, 0, 1))
  kind = 'tie' if clothes.coat else str(rng.choice(list(FRONTS), p=list(FRONTS.values())))
  front, behind = ahead(trunk)
  picture = shirt_front(rng, kind, trunk, clothes, colors)
  parts = [paint(front, picture, axis=2), paint(behind, clothes.shirt)]
  neck = solids.lathe([(0.055, 0.95 * h), (0.05, h + 0.12)], sides=10)
  parts.append(paint(neck, clothes.skin))
  if rng.uniform() < 0.12:  # a rucksack
    bag = solids.pillow(solids.ellipse(1.5 * w, 0.2, power=4), 0.15 * h, 0.95 * h, power=4)
    bag = bag._replace(vertices=bag.vertices + [0, 0, -d - 0.08])
    parts.append(paint(bag, mt.plain(colors.accent)))
  return parts


def shirt_front(rng, kind, trunk, clothes: Clothes, colors) -> mt.Material:
  """The shirt as seen from the front: plain, with a print, a tie, buttons, a waistcoat, a band."""
  x, y = texels(trunk, 2, 1, 128)
  low, high = trunk.vertices[:, 1].min(), trunk.vertices[:, 1].max()
  shirt, half = clothes.shirt, trunk.vertices[:, 0].max()
  if shirt.picture is None:
    rgb = np.broadcast_to(shirt.color, (*x.shape, 3)).copy()
  else:  # where `paint` lays it
    middle = 0.5 * (low + high)
    rgb = mt.lookup(shirt, x / shirt.period + 0.5, (y - middle) / shirt.period + 0.5)
  up = (y - low) / (high - low)
  other, mark = mt.close([rgb.mean((0, 1)), colors.accent, colors.second], 0.5)[1:]
  if kind == 'print':
    badge = mt.emblem(rng, other, mark)
    size = 1.3 * half
    inside = (np.abs(x) < 0.5 * size) & (np.abs(up - 0.55) * (high - low) < 0.5 * size)
    picture = mt.lookup(badge, x / size + 0.5, (up - 0.55) * (high - low) / size + 0.5)
    rgb[inside] = picture[inside]
  elif kind == 'tie':
    rgb[(np.abs(x) < 0.025 + 0.012 * (1 - up)) & (up > 0.25)] = other
  elif kind == 'buttons':
    rgb[(np.abs(x) < 0.022) & (np.cos(up * 2 * np.pi * 4) > 0)] = mark
  elif kind == 'waistcoat':
    rgb[(np.abs(x) > 0.05 + 0.12 * half) & (up < 0.95)] = other
  elif kind == 'band':
    rgb[np.abs(up - rng.uniform(0.4, 0.7)) < rng.uniform(0.08, 0.16)] = other
  return mt.drawn(rgb)


def hand(clothes: Clothes) -> list[Part]:
  """A mitten with a thumb forward."""
  palm = solids.ellipsoid((0.026, 0.085, 0.045), (0, -0.07, 0), sides=10)
  thumb = solids.bar([0, -0.03, 0.02], [0, -0.09, 0.065], (0.018, 0.014), sides=6)
  return [paint(palm, clothes.skin), paint(thumb, clothes.skin)]


def foot(rng, clothes: Clothes) -> list[Part]:
  """A shoe, sometimes a boot, with a sole."""
  long = rng.uniform(0.23, 0.29)
  outline = solids.ellipse(0.1, long, power=2.6, taper=0.12, sides=16) + [0, 0.5 * long - 0.075]
  shoe = solids.pillow(outline, -0.085, 0.03, power=2.5, rings=6)
  sole = solids.slab(outline * 1.03, -0.09, -0.065)
  parts = [paint(shoe, clothes.shoe), paint(sole, mt.plain(mt.neutral(rng)))]
  if rng.uniform() < 0.25:
    boot = solids.lathe([(0.055, -0.06), (0.06, rng.uniform(0.1, 0.22))], sides=12)
    parts.append(paint(boot, clothes.shoe))
  return parts
