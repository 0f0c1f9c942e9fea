"""Guitars: acoustic, electric, bass, ukulele. They stand upright, strings to +z, head at the top.

Lengths are metres; the body's lower end is y = 0. Strings are left out: they are a tenth of a pixel
wide, and voxels would make bars of them.
"""

from typing import NamedTuple

import numpy as np

from datagen.sources.shapes import finishes, outlines, solids
from datagen.sources.shapes import materials as mt
from datagen.sources.shapes.parts import Part, facing, mirror, move, paint, turn


class Form(NamedTuple):
  """A guitar's proportions in metres."""

  kind: str  # of outline
  length: float  # of the body
  width: float  # over the lower bout
  depth: float
  neck: float  # from body to nut
  pegs: int


FORMS = {
  'acoustic': Form('', 0.5, 0.4, 0.11, 0.36, 6),
  'ukulele': Form('', 0.36, 0.27, 0.09, 0.22, 4),
  'electric': Form('', 0.42, 0.33, 0.055, 0.36, 6),
  'bass': Form('', 0.44, 0.32, 0.055, 0.5, 4),
}


def build(rng: np.random.Generator) -> list[Part]:
  """One guitar."""
  colors = mt.scheme(rng)
  kind = str(rng.choice(list(FORMS), p=[0.36, 0.42, 0.13, 0.09]))
  acoustic = kind in ('acoustic', 'ukulele')
  form = shape(rng, kind)
  look = finishes.choose(rng, colors, acoustic=acoustic)
  outline = outlines.body(form.kind, form.width, form.length, cutaway=rng.uniform() < 0.3)
  solid = solids.prism(outline, -0.5 * form.depth, 0.5 * form.depth)
  hollow = form.kind == 'hollow'
  face = finishes.front(rng, solid, outline, look, acoustic=acoustic, hollow=hollow)
  grain = look.kind == 'wood' or (acoustic and rng.uniform() < 0.5)
  side = mt.wood(rng, look.side, period=0.3) if grain else mt.plain(look.side)
  parts = [paint(facing(solid, (2,), 1), face), paint(facing(solid, (2,), -1), side)]
  parts += [paint(facing(solid, (0, 1)), mt.plain(mt.shade(look.side, 0.9)))]
  necks = [0.0]
  if kind == 'electric' and rng.uniform() < 0.05:
    necks = [-0.075, 0.075]
  for x in necks:
    parts += [move(p, [x, 0, 0]) for p in neck(rng, form, look, colors)]
  if rng.uniform() < 0.2:
    parts.append(strap(rng, form, colors))
  return parts


def shape(rng, kind) -> Form:
  """Proportions and an outline of a kind."""
  form = FORMS[kind]
  if kind in ('acoustic', 'ukulele'):
    name = rng.choice(list(outlines.ACOUSTIC), p=[0.35, 0.3, 0.25, 0.1])
  else:
    name = rng.choice(list(outlines.ELECTRIC), p=[0.3, 0.22, 0.14, 0.14, 0.1, 0.1])
  stretch = rng.uniform(0.85, 1.18, 4)
  return form._replace(
    kind=str(name),
    length=form.length * stretch[0],
    width=form.width * stretch[1],
    depth=form.depth * stretch[2] * (1.4 if name == 'hollow' else 1.0),
    neck=form.neck * stretch[3],
  )


def neck(rng, form: Form, look, colors) -> list[Part]:
  """Neck with its fingerboard, and the head with its pegs."""
  front, low, nut = 0.5 * form.depth, 0.76 * form.length, form.length + form.neck
  wide = rng.uniform(0.029, 0.035), rng.uniform(0.025, 0.029)
  section = solids.ellipse(2, 1, power=2.6, sides=16)
  section[:, 1] = np.minimum(section[:, 1], 0.2)  # flat in front
  rings = [
    np.stack([section[:, 0] * w, np.full(16, y), front + 0.01 + (section[:, 1] - 0.2) * d], -1)
    for y, w, d in ((low, wide[0], 0.05), (form.length, wide[0], 0.05), (nut, wide[1], 0.04))
  ]
  solid = solids.loft(rings)
  board = finishes.fingerboard(rng, solid, nut, look)
  wood = mt.wood(rng, look.neck, period=0.3)
  parts = [paint(facing(solid, (2,), 1), board)]
  parts += [paint(facing(solid, (0, 1)), wood), paint(facing(solid, (2,), -1), wood)]
  return parts + head(rng, nut, front, form.pegs, look, colors, wood)


def head(rng, nut, front, pegs, look, colors, wood) -> list[Part]:
  """The head, leaning back a little, with its pegs."""
  long, wide = rng.uniform(0.14, 0.2), rng.uniform(0.036, 0.046)
  kind = str(rng.choice(list(outlines.HEADS)))
  outline = outlines.head(kind, wide, long, rounded=rng.uniform() < 0.5)
  solid = solids.prism(outline, -0.013, 0.013)
  veneer = [
    wood,
    *(mt.plain(mt.close([look.neck, c], 0.35)[1]) for c in (look.base, finishes.DARK)),
  ][rng.integers(3)]
  parts = [paint(facing(solid, (2,), 1), veneer)]
  parts += [paint(facing(solid, (0, 1)), wood), paint(facing(solid, (2,), -1), wood)]
  peg = mt.plain(mt.shade(colors.metal, 1.1) if rng.uniform() < 0.7 else finishes.IVORY)
  one_side = kind == 'in line'
  count = pegs if one_side else pegs // 2
  for k in range(count):
    y = long * (0.2 + 0.66 * k / max(count - 1, 1))
    knob = solids.ellipsoid((0.02, 0.013, 0.012), (-wide * 1.2 - 0.014, y, 0), sides=8)
    stem = solids.bar([-0.6 * wide, y, 0], [-1.2 * wide - 0.01, y, 0], 0.008, sides=6)
    group = [paint(knob, peg), paint(stem, peg)]
    parts += group if one_side else group + [mirror(p) for p in group]
  return [move(turn(p, 0, -8), [0, nut - 0.008, front - 0.004]) for p in parts]


def strap(rng, form: Form, colors) -> Part:
  """A strap that hangs in a bow behind the body."""
  z = -0.5 * form.depth
  path = [
    [0, 0.02, z],
    [0.5 * form.width, 0.25 * form.length, z - 0.03],
    [0.55 * form.width, 0.7 * form.length, z - 0.05],
    [0.02, form.length * 1.02, z + 0.02],
  ]
  band = solids.tube(solids.smooth(path, rounds=3), [[0.024, 0.009]], sides=4, up=(0, 0, 1))
  return paint(band, mt.fabric(rng, (colors.accent, colors.second, colors.main), period=0.14))
