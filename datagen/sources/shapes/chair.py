"""Chairs: framed, swivel, cantilever, upholstered and shell chairs. The sitter faces +z.

The floor is y = 0 and lengths are metres. This file chooses the kind and builds framed chairs;
`seating` builds the other kinds, `legs` what carries a seat, `backs` what one leans on.
"""

import numpy as np

from datagen.sources.shapes import backs, legs, seating, solids, surfaces
from datagen.sources.shapes import materials as mt
from datagen.sources.shapes.parts import Part, mirror, move, paint


def build(rng: np.random.Generator) -> list[Part]:
  """One chair."""
  kind = rng.choice(
    ['framed', 'swivel', 'cantilever', 'upholstered', 'shell'], p=[0.48, 0.12, 0.1, 0.18, 0.12]
  )
  if kind == 'framed':
    return framed(rng)
  return getattr(seating, kind)(rng)


def framed(rng) -> list[Part]:
  """A seat on legs with one of many backs, with or without arms, cushion and stretchers."""
  colors = mt.scheme(rng)
  tall = rng.uniform() < 0.12  # a bar stool
  height = rng.uniform(0.58, 0.75) if tall else rng.uniform(0.36, 0.52)
  width, depth = rng.uniform(0.38, 0.6), rng.uniform(0.38, 0.54)
  thick = rng.uniform(0.03, 0.08)
  wooden = rng.uniform() < 0.6
  if wooden:
    frame = mt.wood(rng, colors.wood) if rng.uniform() < 0.7 else mt.plain(colors.wood)
  else:
    frame = mt.plain([colors.metal, colors.main, colors.accent][rng.integers(3)])
  cloth = mt.fabric(rng, (colors.main, colors.second, colors.accent), period=rng.uniform(0.2, 0.4))
  board = frame if wooden and rng.uniform() < 0.5 else mt.plain(colors.second)
  if rng.uniform() < 0.3:
    board = surfaces.boards(rng, colors.wood, int(rng.integers(3, 6)))
  outline = seat_outline(rng, width, depth)

  padded = rng.uniform() < 0.55
  seat = solids.slab(outline, height - thick, height, bevel=0.3 * thick)
  parts = [paint(seat, board if padded or rng.uniform() < 0.6 else cloth)]
  if padded:
    puff = rng.uniform(0.03, 0.09)
    cushion = solids.pillow(outline * rng.uniform(0.9, 1.0), height - 0.01, height + puff)
    parts.append(paint(cushion, cloth))

  parts += legs.under_seat(rng, width, depth, height - 0.5 * thick, frame, board)
  tilt = rng.uniform(0.0, 0.3)
  shape = backs.Shape(
    width=width * rng.uniform(0.82, 1.05),
    height=rng.uniform(0.18, 0.4) if tall else rng.uniform(0.32, 0.78),
    seat=height,
    rear=-0.5 * depth + rng.uniform(0.0, 0.03),
    tilt=tilt,
    bend=rng.uniform(-0.1, 0.15),
    wrap=rng.choice([0.0, rng.uniform(0.02, 0.1)]),
    flare=rng.uniform(-0.12, 0.15),
  )
  parts += backs.build(rng, shape, frame, cloth, board)
  if rng.uniform() < 0.35 and not tall:
    parts += arms(rng, shape, width, depth, frame, cloth)
  return parts


def seat_outline(rng, width, depth) -> np.ndarray:
  """A square, trapezoid, rounded or round outline [M, 2]."""
  taper = rng.choice([0.0, rng.uniform(0.03, 0.14)])
  kind = rng.uniform()
  if kind < 0.35:
    return solids.rectangle(width, depth, taper=taper)
  power = 2.0 if kind > 0.85 else rng.uniform(2.6, 7.0)
  return solids.ellipse(width, depth, power=power, taper=taper, sides=28)


def arms(rng, shape: backs.Shape, width, depth, frame, cloth) -> list[Part]:
  """Two arms at elbow height: boards on posts, bent tubes, or pads."""
  up = rng.uniform(0.17, 0.27)
  x = 0.5 * max(width, shape.width) + rng.uniform(0.0, 0.04)
  front = depth * rng.uniform(0.15, 0.45)
  y = shape.seat + up
  back = shape.at(1.0, min(up / shape.height, 1.0))
  back = np.array([x, y, back[2]])
  tip = np.array([x, y - rng.uniform(0.0, 0.04), front])
  foot = np.array([x - rng.uniform(0, 0.03), shape.seat - 0.03, front - rng.uniform(0, 0.1)])
  r = rng.uniform(0.014, 0.026)
  kind = int(rng.integers(3))
  if kind == 0:  # a board on a post
    lip = tip + [0, 0, rng.uniform(0.02, 0.08)]
    path = solids.smooth([back, (back + tip) / 2 + [0.01, 0.01, 0], lip])
    half = np.broadcast_to([rng.uniform(0.022, 0.045), 0.015], (len(path), 2))
    rest = solids.tube(path, half, sides=4)
    side = [paint(rest, frame), paint(solids.bar(foot, tip, r), frame)]
  elif kind == 1:  # one bent tube
    path = solids.smooth([back, tip + [0, 0, 0.05], foot + [0, 0, 0.02]], rounds=3)
    side = [paint(solids.tube(path, r), frame)]
  else:  # a thick pad on a post
    size = (rng.uniform(0.05, 0.09), rng.uniform(0.04, 0.07), abs(front - back[2]) + 0.04)
    pad = solids.slab(solids.ellipse(size[0], size[2], power=5), 0, size[1], bevel=0.012)
    pad = move(pad, [x, y - 0.5 * size[1], 0.5 * (front + back[2])])
    side = [paint(pad, cloth), paint(solids.bar(foot, [x, y, foot[2]], r, sides=4), frame)]
  return side + [mirror(p) for p in side]
