"""Chairs that are not a seat on a wooden frame: swivel, cantilever, upholstered, shell."""

import numpy as np

from datagen.sources.shapes import backs, legs, solids, surfaces
from datagen.sources.shapes import materials as mt
from datagen.sources.shapes.parts import Part, mirror, move, paint


def _cloth(rng, colors):
  return mt.fabric(rng, (colors.main, colors.second, colors.accent), period=rng.uniform(0.22, 0.42))


def swivel(rng) -> list[Part]:
  """An office chair: star base on casters, gas column, cushion, back and maybe arms."""
  colors = mt.scheme(rng)
  frame = mt.plain(colors.metal)
  dark = mt.plain(mt.neutral(rng) * 0.5)
  cloth = _cloth(rng, colors)
  height, width, depth = rng.uniform(0.42, 0.56), rng.uniform(0.44, 0.56), rng.uniform(0.42, 0.52)
  radius = rng.uniform(0.26, 0.34)
  parts = legs.star(rng, radius, int(rng.choice([4, 5, 5])), frame, casters=dark)
  pole = [(0.035, 0.07), (0.035, 0.6 * height), (0.022, 0.6 * height), (0.022, height - 0.06)]
  parts.append(paint(solids.lathe(pole, sides=10), frame))
  thick = rng.uniform(0.06, 0.12)
  outline = solids.ellipse(width, depth, power=rng.uniform(2.2, 6.0), sides=28)
  seat = solids.pillow(outline, height - 0.5 * thick, height + 0.5 * thick, power=3)
  parts += [paint(seat, cloth), paint(solids.box((0.2, 0.04, 0.25), (0, height - 0.07, 0)), dark)]
  shape = backs.Shape(
    width=width * rng.uniform(0.75, 1.0),
    height=rng.uniform(0.4, 0.8),
    seat=height + 0.02,
    rear=-0.5 * depth + 0.01,
    tilt=rng.uniform(0.02, 0.2),
    bend=rng.uniform(-0.1, 0.1),
    wrap=rng.uniform(0.0, 0.1),
    flare=rng.uniform(-0.15, 0.1),
  )
  cover = cloth if rng.uniform() < 0.7 else mt.plain(colors.accent)
  parts += backs.plate(rng, shape, frame, cover, thick=rng.uniform(0.03, 0.1))
  spine = [[0, height - 0.05, -0.1], [0, height - 0.05, -0.5 * depth - 0.05], shape.at(0, 0.5)]
  path = solids.smooth(spine)
  parts.append(paint(solids.tube(path, [[0.035, 0.016]] * len(path), sides=4), dark))
  if rng.uniform() < 0.3:  # a head rest
    rest = solids.sheet(
      shape.at(np.linspace(-0.7, 0.7, 5), np.linspace(1.04, 1.28, 4)[:, None]), 0.05
    )
    parts += [paint(rest, cloth), paint(backs.rod(shape, 0, 0, 0.9, 1.15, 0.02, 4), dark)]
  if rng.uniform() < 0.65:
    x, up = 0.5 * width + 0.04, height + rng.uniform(0.16, 0.25)
    pad = solids.slab(solids.ellipse(0.07, 0.27, power=4), up - 0.02, up + 0.02)
    path = [[0.1, height - 0.06, 0], [x, height - 0.06, 0], [x, up, rng.uniform(-0.05, 0.05)]]
    post = solids.tube(solids.smooth(path), 0.018)
    side = [paint(move(pad, [x, 0, 0.01]), dark), paint(post, frame)]
    parts += side + [mirror(p) for p in side]
  return parts


def cantilever(rng) -> list[Part]:
  """Two bent tubes from the floor's rear over the front up to the back, or a bent plate."""
  colors = mt.scheme(rng)
  frame = mt.plain(colors.metal)
  cloth = _cloth(rng, colors)
  height, width, depth = rng.uniform(0.38, 0.48), rng.uniform(0.44, 0.6), rng.uniform(0.42, 0.56)
  top, lean = height + rng.uniform(0.3, 0.6), rng.uniform(0.04, 0.2)
  z, r = 0.5 * depth, rng.uniform(0.014, 0.024)
  foot = -z * rng.uniform(0.6, 1.1)
  if rng.uniform() < 0.3:  # one bent plate, seen from the side a Z or an S
    low = rng.uniform(0.0, 0.18)
    line = [[foot, 0.02], [z * 0.9, 0.02], [z + 0.03 - low, height], [-z, height - 0.03]]
    line = solids.smooth([*line, [-z - lean, top]], rounds=3)
    x = np.linspace(-0.5, 0.5, 6) * width
    grid = np.stack([np.broadcast_to(x, (len(line), 6)), *(line.T[[1, 0], :, None] + 0 * x)], -1)
    return [paint(solids.sheet(grid, rng.uniform(0.03, 0.05)), cloth)]
  x = 0.5 * width
  armed = rng.uniform() < 0.35
  path = [[x, r, foot], [x, r, z], [x, height, z], [x, height, -z], [x, top, -z - lean]]
  if armed:
    path = [[x, r, foot], [x, r, z], [x, height + 0.2, z], [x, height + 0.2, -z - 0.3 * lean]]
    path.append([x, top, -z - lean])
  side = paint(solids.tube(solids.smooth(path, rounds=3), r), frame)
  parts = [side, mirror(side), paint(solids.bar([-x, r, foot], [x, r, foot], r), frame)]
  thick = rng.uniform(0.03, 0.09)
  seat = solids.pillow(
    solids.ellipse(width, depth, power=rng.uniform(4, 9)), height - 0.5 * thick, height + thick
  )
  parts.append(paint(seat, cloth))
  if armed:
    parts.append(paint(solids.box((width, 0.03, 0.03), (0, height, z - 0.02)), frame))
  rise = top - height
  shape = backs.Shape(width, rise, height, -z, lean / rise, 0.0, rng.choice([0, -0.03]), 0.0)
  low = rng.uniform(0.1, 0.55)
  span = np.linspace(low, 1.0, 6)[:, None]
  panel = solids.sheet(shape.at(np.linspace(-1, 1, 7), span), thick * 0.8)
  return [*parts, paint(panel, cloth)]


def upholstered(rng) -> list[Part]:
  """An armchair, wing chair, tub chair or small sofa: a stuffed body on short feet."""
  colors = mt.scheme(rng)
  cloth = _cloth(rng, colors)
  pad = cloth if rng.uniform() < 0.5 else mt.plain(colors.second)
  if rng.uniform() < 0.35:
    cloth = surfaces.tufted(colors.main, period=rng.uniform(0.18, 0.28))
  foot = mt.plain(colors.wood if rng.uniform() < 0.7 else colors.metal)
  if rng.uniform() < 0.25:
    return tub(rng, cloth, pad, foot)
  seats = int(rng.choice([1, 1, 1, 2]))
  inner, depth = rng.uniform(0.48, 0.6) * seats, rng.uniform(0.6, 0.8)
  clear = rng.uniform(0.03, 0.16)
  base, seat = clear + rng.uniform(0.12, 0.2), clear + rng.uniform(0.26, 0.34)
  arm_w, arm_h = rng.uniform(0.08, 0.2), seat + rng.uniform(0.08, 0.24)
  back_h, back_t = seat + rng.uniform(0.3, 0.65), rng.uniform(0.12, 0.2)
  armed = rng.uniform() < 0.85
  width = inner + (2 * arm_w if armed else 0)
  soft = rng.uniform(0.015, 0.05)
  parts = [paint(move(block(width * 0.98, depth * 0.96, clear, base, 0.02), [0, 0, 0]), cloth)]
  for k in range(seats):
    x = inner * ((k + 0.5) / seats - 0.5)
    outline = solids.ellipse(inner / seats, depth - back_t, power=8)
    cushion = solids.pillow(outline, base - 0.01, seat, power=4)
    parts.append(paint(move(cushion, [x, 0, 0.5 * back_t + 0.01]), pad))
  parts += stuffed_back(rng, inner, seats, depth, base, back_h, back_t, soft, cloth, pad)
  if armed:
    x = 0.5 * (inner + arm_w)
    long = depth * rng.uniform(0.85, 1.0)
    shift = -0.5 * (depth - long)
    side = [paint(move(block(arm_w, long, clear, arm_h, soft), [x, 0, shift]), cloth)]
    if rng.uniform() < 0.4:  # rolled
      roll = [[x, arm_h, shift - 0.5 * long], [x, arm_h, shift + 0.5 * long]]
      side.append(paint(solids.bar(*roll, 0.6 * arm_w, sides=14), cloth))
    if rng.uniform() < 0.35:  # wings
      t = np.linspace(0, 1, 6)[:, None]
      z = -0.5 * depth + np.linspace(0, 1, 5) * rng.uniform(0.25, 0.4) * (1 - 0.3 * t)
      y = arm_h - 0.05 + t * (back_h - arm_h)
      grid = np.stack(np.broadcast_arrays(x - 0.3 * arm_w, y, z), -1)
      side.append(paint(solids.sheet(grid, 0.07), cloth))
    parts += side + [mirror(p) for p in side]
  return parts + feet(rng, 0.45 * width, 0.42 * depth, clear + 0.02, foot)


def stuffed_back(rng, inner, seats, depth, base, top, thick, soft, cloth, pad) -> list[Part]:
  """A leaning back with an arched or straight top and, maybe, one cushion a seat."""
  lean = rng.uniform(0.0, 0.25)
  shape = backs.Shape(inner, top - base, base, -0.5 * depth + 0.5 * thick, lean, 0, 0, 0)
  s, t = np.linspace(-1, 1, 13), np.linspace(0, 1, 7)[:, None]
  crown = rng.choice([0.0, rng.uniform(0.05, 0.2)])
  tufts = 0.12 * np.cos(s * 3 * np.pi * seats) * np.cos(t * 4 * np.pi) * rng.integers(2)
  body = solids.sheet(shape.at(s, t * (1 + crown * (1 - s**2))), thick * (1 + tufts))
  parts = [paint(body, cloth)]
  if rng.uniform() < 0.5:
    for k in range(seats):
      x = inner * ((k + 0.5) / seats - 0.5)
      outline = solids.ellipse(0.92 * inner / seats, 0.14, power=2.5)
      cushion = solids.pillow(outline, base + 0.1, base + 0.1 + 0.8 * (top - base), power=5)
      parts.append(paint(move(cushion, [x, 0, -0.5 * depth + thick + 0.04]), pad))
  return parts


def block(width, depth, low, high, bevel):
  """A stuffed box with soft edges."""
  return solids.slab(solids.ellipse(width, depth, power=9, sides=24), low, high, bevel=bevel)


def tub(rng, cloth, pad, foot) -> list[Part]:
  """A round chair whose back runs on into the arms."""
  width, depth = rng.uniform(0.6, 0.82), rng.uniform(0.58, 0.74)
  clear, seat = rng.uniform(0.05, 0.2), rng.uniform(0.36, 0.45)
  high, arm = seat + rng.uniform(0.25, 0.5), seat + rng.uniform(0.05, 0.22)
  a = np.linspace(-1, 1, 19) * np.deg2rad(rng.uniform(95, 140))
  top = arm + (high - arm) * np.cos(np.clip(a, -np.pi / 2, np.pi / 2)) ** rng.uniform(0.5, 2)
  t = np.linspace(0, 1, 6)[:, None]
  flare = 1 + rng.uniform(0.0, 0.15) * t
  wall = np.stack(
    np.broadcast_arrays(
      0.5 * width * np.sin(a) * flare, clear + t * (top - clear), -0.5 * depth * np.cos(a) * flare
    ),
    -1,
  )
  core = solids.slab(solids.ellipse(width * 0.97, depth * 0.97), clear, seat - 0.08, bevel=0.02)
  cushion = solids.pillow(solids.ellipse(width * 0.93, depth * 0.93), seat - 0.1, seat, power=4)
  parts = [paint(solids.sheet(wall, rng.uniform(0.06, 0.12)), cloth), paint(core, cloth)]
  parts.append(paint(cushion, pad))
  if clear > 0.1 and rng.uniform() < 0.5:
    return parts + legs.column(rng, 0.3, clear + 0.05, foot)
  return parts + feet(rng, 0.32 * width, 0.32 * depth, clear + 0.03, foot)


def feet(rng, x, z, height, material) -> list[Part]:
  """Four short feet."""
  r, out = rng.uniform(0.018, 0.035), rng.uniform(0.0, 0.03)
  sides = int(rng.choice([4, 10]))
  pair = [
    paint(
      solids.bar([x + out, 0, s * (z + out)], [x, height, s * z], (0.7 * r, r), sides=sides),
      material,
    )
    for s in (1, -1)
  ]
  return pair + [mirror(p) for p in pair]


def shell(rng) -> list[Part]:
  """A moulded shell, one bent surface for seat and back, on wood, wire, sled or a column."""
  colors = mt.scheme(rng)
  skin = mt.plain(colors.main) if rng.uniform() < 0.55 else _cloth(rng, colors)
  base = mt.plain(colors.metal) if rng.uniform() < 0.5 else mt.wood(rng, colors.wood)
  height, width, depth = rng.uniform(0.38, 0.46), rng.uniform(0.44, 0.64), rng.uniform(0.42, 0.54)
  rise, lean = rng.uniform(0.28, 0.55), rng.uniform(0.08, 0.28)
  z = 0.5 * depth
  line = [[z + 0.02, height - rng.uniform(0, 0.05)], [0.5 * z, height], [-0.9 * z, height - 0.03]]
  line += [[-z - 0.3 * lean, height + 0.12], [-z - lean, height + rise]]
  line = solids.smooth(line, rounds=2)
  t = np.linspace(0, 1, len(line))[:, None]
  s = np.linspace(-1, 1, 11)
  lobe = rng.uniform(2.5, 6.0)
  half = 0.5 * width * np.maximum(1 - np.abs(2 * t - 1) ** lobe, 0.2) ** (1 / lobe)
  half = half * (1 - rng.uniform(0, 0.25) * np.exp(-(((t - 0.55) / 0.15) ** 2)))
  arm = rng.choice([0.0, 0.0, rng.uniform(0.1, 0.2)]) * np.exp(-(((t - 0.5) / 0.22) ** 2))
  cup = (rng.uniform(0.02, 0.08) + arm) * np.abs(s) ** 2.5
  # Sides rise over the seat and come forward at the back, along the line's own normal.
  along = np.gradient(line, axis=0)
  along /= np.linalg.norm(along, axis=1, keepdims=True)
  grid = np.stack(
    np.broadcast_arrays(
      half * s, line[:, 1:] - cup * along[:, :1], line[:, :1] + cup * along[:, 1:]
    ),
    -1,
  )
  parts = [paint(solids.sheet(grid, rng.uniform(0.02, 0.04)), skin)]
  if rng.uniform() < 0.35:
    cushion = solids.pillow(
      solids.ellipse(0.75 * width, 0.75 * depth), height - 0.02, height + 0.05
    )
    parts.append(paint(cushion, mt.plain(colors.second)))
  x, kind = 0.36 * width, rng.uniform()
  if kind < 0.5:
    splay = rng.uniform(0.02, 0.1)
    return parts + legs.four(
      rng, x, 0.7 * z, height - 0.02, rng.uniform(0.014, 0.02), base, splay=splay
    )
  if kind < 0.8:
    return parts + legs.column(rng, rng.uniform(0.2, 0.28), height - 0.01, base)
  path = [[x, height, 0.7 * z], [x, 0.015, 0.9 * z], [x, 0.015, -0.9 * z], [x, height, -0.7 * z]]
  side = paint(solids.tube(solids.smooth(path, rounds=3), 0.014), base)
  return [*parts, side, mirror(side)]
