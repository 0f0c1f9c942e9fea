"""Supports of a seat or a table top: legs, stretchers, sleds, rockers, columns, star bases."""

import numpy as np

from datagen.sources.shapes import solids
from datagen.sources.shapes.parts import Part, mirror, move, paint, turn


def under_seat(rng, width, depth, height, frame, board) -> list[Part]:
  """Legs of a framed chair, from the floor to `height`, in one of seven styles."""
  style = rng.choice(
    ['four', 'sled', 'rockers', 'crossed', 'planks', 'column', 'hairpin'],
    p=[0.62, 0.08, 0.07, 0.06, 0.06, 0.06, 0.05],
  )
  inset = rng.uniform(0.0, 0.05)
  x, z = 0.5 * width - 0.02 - inset, 0.5 * depth - 0.02 - inset
  r = rng.uniform(0.014, 0.03)
  if style == 'four':
    parts = four(rng, x, z, height, r, frame, splay=rng.choice([0.0, rng.uniform(0.03, 0.1)]))
    return parts + apron(rng, x, z, height, frame if rng.uniform() < 0.7 else board)
  if style == 'sled':
    path = [[x, height, z], [x, r, z + 0.02], [x, r, -z - 0.02], [x, height, -z]]
    side = paint(solids.tube(solids.smooth(path, rounds=3), r), frame)
    return [side, mirror(side)]
  if style == 'rockers':
    parts = four(rng, x, z, height, r, frame, splay=0.04, floor=0.06)
    a = np.linspace(-1, 1, 13)[:, None]
    curve = np.concatenate([a * 0 + x + 0.02, 0.02 + 0.1 * a**2, a * (z + 0.22) - 0.05], 1)
    side = paint(solids.tube(curve, [0.018, 0.024] * np.ones((13, 1)), sides=4), frame)
    return [*parts, side, mirror(side)]
  if style == 'crossed':
    ends = [([x, height, -z], [x, 0, z]), ([x, height, z], [x, 0, -z])]
    side = [paint(solids.bar(a, b, r * 1.1, sides=4), frame) for a, b in ends]
    rung = paint(solids.bar([-x, 0.5 * height, 0], [x, 0.5 * height, 0], r), frame)
    return side + [mirror(p) for p in side] + [rung]
  if style == 'planks':
    t = rng.uniform(0.025, 0.045)
    side = paint(solids.box((t, height, 1.9 * z), (x, height / 2, 0)), board)
    rung = paint(solids.box((2 * x, rng.uniform(0.06, 0.15), t), (0, 0.6 * height, 0)), frame)
    return [side, mirror(side), rung]
  if style == 'column':
    return column(rng, 0.46 * min(width, depth) + 0.02, height, frame)
  parts = []  # hairpins: two rods that meet at the floor
  for sx, sz in ((1, 1), (1, -1)):
    foot = [sx * (x + 0.02), 0.01, sz * (z + 0.02)]
    for dx, dz in ((0.09, 0.0), (0.0, 0.09)):
      rod = solids.bar([sx * (x - dx), height, sz * (z - dz)], foot, 0.013, sides=6)
      parts += [paint(rod, frame)]
  return parts + [mirror(p) for p in parts]


def leg_profile(rng, height, r) -> np.ndarray:
  """A turned leg's profile [N, 2]: a slow taper with a few beads."""
  y = np.linspace(0, 1, 15)
  beads = 1 + 0.35 * np.sin(2 * np.pi * (y * rng.integers(2, 5) + rng.uniform()))
  taper = rng.uniform(0.6, 0.9) + 0.5 * y
  return np.stack([r * taper * beads, y * height], 1)


def four(rng, x, z, height, r, frame, *, splay=0.0, floor=0.0) -> list[Part]:
  """Four legs under (±x, ±z), square, round, tapered, turned or curved, with their stretchers."""
  style = int(rng.integers(5))
  profile = leg_profile(rng, height - floor, r)
  sides = int(rng.choice([4, 10]))
  parts = []
  for sz in (1, -1):
    top = np.array([x, height, sz * z])
    foot = np.array([x + splay, floor, sz * (z + splay)])
    if style == 0:
      leg = solids.bar(foot, top, r, sides=4, up=(0, 0, 1))
    elif style == 1:
      leg = solids.bar(foot, top, r, sides=10)
    elif style == 2:
      leg = solids.bar(foot, top, (0.6 * r, 1.4 * r), sides=sides, up=(0, 0, 1))
    elif style == 3:
      leg = move(solids.lathe(profile, sides=10), [x + splay / 2, floor, sz * (z + splay / 2)])
    else:  # cabriole: out at the knee, in at the ankle, out again at the foot
      out = np.array([1, 0, sz]) * 0.7
      knots = [top, top + [0, -0.15 * height, 0] + out * 0.035]
      knots += [foot + [0, 0.2 * height, 0] - out * 0.02, foot + out * 0.02]
      path = solids.smooth(knots, rounds=2)
      leg = solids.tube(path, np.linspace(1.5, 0.8, len(path)) * r)
    parts.append(paint(leg, frame))
  parts += [mirror(p) for p in parts]
  if rng.uniform() < 0.5:
    parts += stretchers(rng, x + splay / 2, z + splay / 2, height, 0.75 * r, frame)
  return parts


def stretchers(rng, x, z, height, r, frame) -> list[Part]:
  """Bars between legs: an H, a box, or sides only."""
  y = height * rng.uniform(0.2, 0.55)
  kind = int(rng.integers(3))
  side = paint(solids.bar([x, y, z], [x, y, -z], r), frame)
  parts = [side, mirror(side)]
  if kind == 0:
    parts.append(paint(solids.bar([-x, y, 0], [x, y, 0], r), frame))
  elif kind == 1:
    low = y + rng.uniform(-0.04, 0.04)
    parts += [paint(solids.bar([-x, low, s * z], [x, low, s * z], r), frame) for s in (1, -1)]
  return parts


def apron(rng, x, z, height, material) -> list[Part]:
  """Boards between the legs just under the seat; sometimes none."""
  if rng.uniform() < 0.5:
    return []
  h = rng.uniform(0.03, 0.08)
  y = height - h / 2
  front = [paint(solids.box((2 * x, h, 0.02), (0, y, s * z)), material) for s in (1, -1)]
  sides = [paint(solids.box((0.02, h, 2 * z), (s * x, y, 0)), material) for s in (1, -1)]
  return front + sides


def column(rng, radius, height, frame) -> list[Part]:
  """A column on a disc, a trumpet foot or crossed feet."""
  r = rng.uniform(0.022, 0.05)
  kind = int(rng.integers(3))
  if kind == 0:
    profile = [(radius, 0), (radius, 0.02), (r, 0.04), (r, height)]
    return [paint(solids.lathe(profile, sides=20), frame)]
  if kind == 1:
    y = np.linspace(0, 1, 12)
    flare = np.exp(-y * rng.uniform(5, 9)) * (radius - r) + 0.6 * r * y**4
    profile = np.stack([r + flare, y * height], 1)
    return [paint(solids.lathe([(radius, -0.001), *profile], sides=20), frame)]
  pole = paint(solids.bar([0, 0.02, 0], [0, height, 0], r, sides=12), frame)
  return [pole, *star(rng, radius, 4, frame, casters=None)]


def star(rng, radius, arms: int, frame, *, casters) -> list[Part]:
  """A star of feet around the origin; `casters` is the wheels' material, or None."""
  lift = 0.06 if casters is not None else 0.025
  r0, r1 = rng.uniform(0.022, 0.034), rng.uniform(0.014, 0.022)
  parts = []
  for k in range(arms):
    foot = solids.bar([0, lift + 0.035, 0], [0, lift, radius], (r0, r1), sides=4)
    group = [paint(foot, frame)]
    if casters is not None:
      wheel = solids.bar([-0.022, 0.03, radius], [0.022, 0.03, radius], 0.03, sides=10)
      group.append(paint(wheel, casters))
    parts += [turn(p, 1, 360 * (k + 0.5) / arms) for p in group]
  return parts
