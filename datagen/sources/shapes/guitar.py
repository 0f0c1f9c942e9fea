"""Guitars: acoustic, electric, bass, ukulele. They stand upright, strings to +z, head at the top.

Lengths are metres; the body's lower end is y = 0. A body is a loft of cross-sections up the y axis
whose half width follows the outline's bouts and waist; horns and wings are separate flat bars.
"""

from typing import NamedTuple

import numpy as np
from scipy.interpolate import PchipInterpolator

from datagen.sources.shapes import finishes, solids
from datagen.sources.shapes import materials as mt
from datagen.sources.shapes.parts import Part, facing, mirror, move, paint, turn


class Form(NamedTuple):
  """A body's proportions; half widths are fractions of the lower bout's."""

  length: float
  width: float  # over the lower bout
  depth: float
  waist: float
  upper: float
  round: float  # how square the ends are: 2 round, 5 square
  neck: float  # from body to nut
  skew: float  # how far the bouts lean apart


def build(rng: np.random.Generator) -> list[Part]:
  """One guitar."""
  colors = mt.scheme(rng)
  kind = rng.choice(
    ['acoustic', 'electric', 'winged', 'bass', 'ukulele'], p=[0.34, 0.36, 0.1, 0.12, 0.08]
  )
  acoustic = kind in ('acoustic', 'ukulele')
  form = shape(rng, kind)
  look = finishes.choose(rng, colors, acoustic=acoustic)
  if kind == 'winged':
    parts = winged(rng, form, look)
  else:
    parts = body(rng, form, look, acoustic=acoustic)
    if not acoustic:
      parts += horns(rng, form, look)
  front = 0.5 * form.depth
  if acoustic:
    parts += sound_hole(rng, form, front, look, colors)
  else:
    parts += electrics(rng, form, front, look, colors)
  strings = int(rng.choice([6, 6, 12])) if kind not in ('bass', 'ukulele') else 4
  necks = [0.0]
  if kind == 'electric' and rng.uniform() < 0.06:
    necks = [-0.075, 0.075]
  for x in necks:
    parts += [move(p, [x, 0, 0]) for p in neck(rng, form, front, look, strings, colors)]
  if rng.uniform() < 0.2:
    parts.append(strap(rng, form, colors))
  return parts


def shape(rng, kind) -> Form:
  """Proportions of a kind."""
  if kind == 'acoustic':
    form = Form(
      0.5,
      0.4,
      0.11,
      rng.uniform(0.55, 0.88),
      rng.uniform(0.62, 0.92),
      rng.uniform(2.2, 3.6),
      0.36,
      0.0,
    )
  elif kind == 'ukulele':
    form = Form(
      0.36,
      0.27,
      0.09,
      rng.uniform(0.6, 0.98),
      rng.uniform(0.7, 0.9),
      rng.uniform(2.0, 3.0),
      0.22,
      0.0,
    )
  else:
    long = 0.52 if kind == 'bass' else 0.36
    form = Form(
      0.42,
      0.33,
      0.05,
      rng.uniform(0.6, 0.85),
      rng.uniform(0.7, 0.95),
      rng.uniform(2.2, 4.5),
      long,
      rng.choice([0.0, rng.uniform(-0.05, 0.05)]),
    )
  stretch = rng.uniform(0.82, 1.2, 4)
  return form._replace(
    length=form.length * stretch[0],
    width=form.width * stretch[1],
    depth=form.depth * stretch[2],
    neck=form.neck * stretch[3],
  )


def half_width(form: Form, t):
  """The outline's half width at t from 0 (lower end) to 1 (where the neck starts)."""
  bouts = PchipInterpolator(
    [0.0, 0.28, 0.6, 0.84, 1.0], [0.96, 1.0, form.waist, form.upper, 0.95 * form.upper]
  )
  ends = np.maximum(1 - np.abs(2 * t - 1) ** form.round, 0) ** (1 / form.round)
  return 0.5 * form.width * bouts(t) * ends


def body(rng, form: Form, look, *, acoustic) -> list[Part]:
  """The body: its front, and the rest."""
  t = 0.5 + 0.5 * np.sin(np.linspace(-0.5, 0.5, 25) * np.pi)
  t = t.clip(0.004, 0.996)
  ring = solids.ellipse(1, 1, power=9, sides=20)
  left = right = half_width(form, t)
  if rng.uniform() < 0.35:  # a cutaway
    right = right * (1 - rng.uniform(0.35, 0.6) * np.clip((t - 0.74) / 0.2, 0, 1) ** 0.7)
  lean = form.skew * np.sin(2 * np.pi * t)
  x = ring[:, 0] * (left + right)[:, None] + (0.5 * (right - left) + lean)[:, None]
  z = np.broadcast_to(ring[:, 1] * form.depth, x.shape)
  y = np.broadcast_to(t[:, None] * form.length, x.shape)
  solid = solids.loft(np.stack([x, y, z], -1))
  parts = [paint(facing(solid, (2,)), look.front), paint(facing(solid, (0, 1)), look.side)]
  if acoustic or rng.uniform() < 0.3:  # binding around the front
    edge = solid.vertices * [1.012, 1.0, 0.12] + [0, 0, 0.44 * form.depth]
    parts.append(paint(facing(solid._replace(vertices=edge), (0, 1)), mt.plain(look.trim)))
  return parts


def horns(rng, form: Form, look) -> list[Part]:
  """Two horns, one, or none, beside the neck."""
  parts = []
  x, y = half_width(form, 0.8) * 0.72, 0.74 * form.length
  for sign in (-1, 1):
    if rng.uniform() < 0.25:
      continue
    reach = rng.uniform(0.08, 0.2) * (1.25 if sign < 0 else 0.9)
    tip = rng.uniform(0.012, 0.03)
    bend = rng.uniform(-0.03, 0.05)
    path = solids.smooth(
      [[x, y, 0], [x + bend, y + 0.5 * reach, 0], [x - 0.2 * bend, y + reach, 0]]
    )
    wide = np.linspace(0.062, tip, len(path))
    size = np.stack([wide, 0 * wide + 0.48 * form.depth], 1)
    horn = paint(solids.tube(path, size / np.sqrt(2), sides=4, up=(0, 0, 1)), look.side)
    parts.append(mirror(horn) if sign < 0 else horn)
  return parts


def winged(rng, form: Form, look) -> list[Part]:
  """Pointed bodies: a V, a star, an offset bolt."""
  kind = int(rng.integers(3))
  y, long = 0.62 * form.length, form.length
  if kind == 0:
    spread = rng.uniform(0.12, 0.2)
    tips = [(-spread, -0.05), (spread, -0.05)]
  elif kind == 1:
    tips = [(-0.2, 0.0), (0.19, 0.04), (-0.17, 1.05 * long), (0.14, 1.0 * long)]
  else:
    tips = [(-0.22, 0.1), (0.2, -0.04), (0.15, 1.02 * long), (-0.12, 0.9 * long)]
  r = rng.uniform(0.06, 0.085)
  parts = []
  for x, tip in tips:
    x = x * rng.uniform(0.9, 1.15)
    path = np.array([[0, y, 0], [0.5 * x, 0.5 * (y + tip), 0], [x, tip, 0]])
    size = np.stack([[1.2 * r, r, rng.uniform(0.2, 0.9) * r], [0.5 * form.depth] * 3], 1) / np.sqrt(
      2
    )
    wing = solids.tube(path, size, sides=4, up=(0, 0, 1))
    parts.append(paint(wing, look.front if rng.uniform() < 0.85 else look.side))
  core = solids.slab(solids.ellipse(0.2, 0.34, power=3), -0.5 * form.depth, 0.5 * form.depth)
  core = move(turn(core, 0, -90), [0, 0.58 * form.length, 0])
  return [*parts, paint(core, look.front)]


def disc(radius, z, thick, center_y):
  """A disc that faces +z."""
  return solids.bar([0, center_y, z - thick], [0, center_y, z + thick], radius, sides=24)


def plate(outline, z, thick):
  """A plate that faces +z, its outline [M, 2] in (x, y)."""
  o = np.asarray(outline, float)
  return solids.loft([np.insert(o, 2, z - thick, axis=1), np.insert(o, 2, z + thick, axis=1)])


def sound_hole(rng, form: Form, front, look, colors) -> list[Part]:
  """A hole with a rosette, or a metal cone, or two slots; bridge and scratch plate."""
  dark = mt.plain([0.09, 0.07, 0.06])
  y, r = 0.66 * form.length, 0.14 * form.width * rng.uniform(0.85, 1.2)
  parts = []
  kind = rng.uniform()
  if kind < 0.75:
    parts.append(paint(disc(r * rng.uniform(1.15, 1.4), front, 0.003, y), mt.plain(look.trim)))
    parts.append(paint(disc(r, front, 0.005, y), dark))
  elif kind < 0.87:
    parts.append(paint(disc(2.1 * r, front, 0.006, 0.42 * form.length), finishes.cone(colors)))
  else:
    slot = plate(solids.ellipse(0.025, 0.13) + [0.27 * form.width, 0.5 * form.length], front, 0.004)
    slot = paint(slot, dark)
    parts += [slot, mirror(slot), paint(disc(0.5 * r, front, 0.004, y), dark)]
  wide = form.width * rng.uniform(0.3, 0.5)
  bridge = solids.box((wide, 0.03, 0.016), (0, 0.27 * form.length, front + 0.006))
  parts.append(paint(bridge, mt.plain(mt.shade(colors.wood, 0.4))))
  if rng.uniform() < 0.5:
    guard = solids.ellipse(0.1, 0.15, power=2.3) * rng.uniform(0.8, 1.2)
    guard = guard + [0.22 * form.width, 0.5 * form.length]
    parts.append(paint(plate(guard, front, 0.004), mt.plain(look.guard)))
  return parts


def electrics(rng, form: Form, front, look, colors) -> list[Part]:
  """Pickups, bridge, knobs, a scratch plate, a lever."""
  parts = []
  if rng.uniform() < 0.65:
    size = np.array([rng.uniform(0.55, 0.8) * form.width, rng.uniform(0.4, 0.62) * form.length])
    guard = solids.ellipse(*size, power=rng.uniform(2, 4)) + [
      0.03 * rng.normal(),
      0.56 * form.length,
    ]
    parts.append(paint(plate(guard, front, 0.005), mt.plain(look.guard)))
  metal = mt.plain(mt.shade(colors.metal, 1.1))
  black = mt.plain([0.13, 0.13, 0.14])
  cover = [black, metal, mt.plain([0.85, 0.82, 0.7])][rng.integers(3)]
  high = rng.uniform(0.018, 0.042)
  for y in np.linspace(0.42, 0.78, int(rng.integers(1, 4)) + 1)[1:]:
    parts.append(paint(solids.box((0.09, high, 0.02), (0, y * form.length, front + 0.006)), cover))
  bridge = solids.box((0.1, rng.uniform(0.02, 0.045), 0.024), (0, 0.3 * form.length, front + 0.006))
  parts.append(paint(bridge, metal))
  if rng.uniform() < 0.4:
    tail = solids.box((0.09, 0.018, 0.022), (0, 0.2 * form.length, front + 0.006))
    parts.append(paint(tail, metal))
  knob = metal if rng.uniform() < 0.5 else mt.plain(colors.accent)
  for k in range(int(rng.integers(2, 5))):
    at = [0.3 * form.width - 0.02 * (k % 2), (0.22 + 0.09 * k) * form.length, front]
    cap = solids.bar(at, np.array(at) + [0, 0, 0.022], 0.016, sides=10)
    parts.append(paint(cap, knob))
  if rng.uniform() < 0.3:
    path = [[0.04, 0.3 * form.length, front + 0.02], [0.09, 0.42 * form.length, front + 0.04]]
    parts.append(paint(solids.bar(*path, 0.007, sides=6), metal))
  return parts


def neck(rng, form: Form, front, look, strings, colors) -> list[Part]:
  """Neck, fingerboard with frets and marks, head with pegs, nut and strings."""
  w0, w1 = rng.uniform(0.026, 0.034), rng.uniform(0.02, 0.025)
  y0, nut = 0.74 * form.length, form.length + form.neck
  wood = mt.wood(rng, look.neck, period=0.3)
  back = [[0, y0, front - 0.022], [0, nut, front - 0.014]]
  shaft = solids.tube(back, [[w0, 0.022], [w1, 0.017]], sides=12, up=(0, 0, 1))
  board = solids.tube(
    [[0, y0, front + 0.008], [0, nut, front + 0.008]],
    [[w0, 0.007], [w1, 0.007]],
    sides=4,
    up=(0, 0, 1),
  )
  parts = [paint(shaft, wood), paint(board, finishes.fingerboard(rng, colors), axis=2)]
  parts += head(rng, nut, front, look, strings, colors, wood)
  if rng.uniform() < 0.4:
    steel = mt.plain([0.72, 0.7, 0.62])
    for s in np.linspace(-0.8, 0.8, min(strings, 6)):
      low = [s * w0 * 1.15, 0.29 * form.length, front + 0.02]
      parts.append(paint(solids.bar(low, [s * w1, nut, front + 0.018], 0.0012, sides=4), steel))
  return parts


def head(rng, nut, front, look, strings, colors, wood) -> list[Part]:
  """The head: paddle, spear, slanted or fishtail, leaning back, with its pegs."""
  long, wide = rng.uniform(0.13, 0.2), rng.uniform(0.03, 0.045)
  kind = int(rng.integers(4))
  outlines = [
    [(-0.8, 0), (0.8, 0), (1.1, 0.2), (1.0, 1), (-1.0, 1), (-1.1, 0.2)],
    [(-0.8, 0), (0.8, 0), (1.2, 0.15), (0.7, 0.85), (0, 1.1), (-0.7, 0.85), (-1.2, 0.15)],
    [(-0.8, 0), (0.8, 0), (0.6, 0.3), (1.0, 0.95), (0.2, 1.05), (-1.2, 0.75), (-1.3, 0.2)],
    [(-0.7, 0), (0.7, 0), (0.9, 0.5), (1.3, 1), (0, 0.88), (-1.3, 1), (-0.9, 0.5)],
  ]
  outline = np.array(outlines[kind]) * [wide, long]
  if rng.uniform() < 0.5:
    outline = solids.smooth(outline, closed=True)
  veneer = wood if rng.uniform() < 0.5 else look.front
  parts = [paint(plate(outline, 0.0, 0.011), veneer)]
  peg = mt.plain(mt.shade(colors.metal, 1.1) if rng.uniform() < 0.7 else [0.85, 0.82, 0.72])
  count = max(strings, 4) // 2
  one_side = kind == 2
  for k in range(min(count * (2 if one_side else 1), 6)):
    y = long * (0.2 + 0.65 * k / max(count * (2 if one_side else 1) - 1, 1))
    for s in (-1,) if one_side else (-1, 1):
      knob = solids.ellipsoid((0.016, 0.011, 0.008), (s * (wide * 1.2 + 0.012), y, 0), sides=8)
      stem = solids.bar([s * 0.6 * wide, y, 0], [s * (1.2 * wide + 0.01), y, 0], 0.006, sides=6)
      parts += [paint(knob, peg), paint(stem, peg)]
  parts = [move(turn(p, 0, -8), [0, nut - 0.005, front - 0.004]) for p in parts]
  ivory = mt.plain([0.86, 0.83, 0.75])
  parts.append(paint(solids.box((0.05, 0.008, 0.02), (0, nut, front + 0.01)), ivory))
  return parts


def strap(rng, form: Form, colors) -> Part:
  """A strap that hangs in a bow behind the body."""
  z = -0.5 * form.depth
  path = [
    [0, 0.0, z],
    [0.5 * form.width, 0.25 * form.length, z - 0.03],
    [0.55 * form.width, 0.7 * form.length, z - 0.05],
    [0.02, form.length * 1.02, z + 0.02],
  ]
  band = solids.tube(solids.smooth(path, rounds=3), [[0.022, 0.006]], sides=4, up=(0, 0, 1))
  return paint(band, mt.fabric(rng, (colors.accent, colors.second, colors.main), period=0.08))
