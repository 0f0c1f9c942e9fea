"""Tables: dining, side, desk, counter, trestle and pedestal tables. The floor is y = 0.

The long side runs along x; drawers open towards +z.
"""

import numpy as np

from datagen.sources.shapes import legs, solids, surfaces
from datagen.sources.shapes import materials as mt
from datagen.sources.shapes.parts import Part, mirror, move, paint


def build(rng: np.random.Generator) -> list[Part]:
  """One table: a top, what carries it, and maybe a shelf, drawers or a cloth."""
  colors = mt.scheme(rng)
  kind = rng.choice(
    ['legs', 'pedestal', 'trestle', 'desk', 'slabs'], p=[0.46, 0.2, 0.1, 0.13, 0.11]
  )
  height = rng.choice(
    [rng.uniform(0.32, 0.5), rng.uniform(0.62, 0.8), rng.uniform(0.85, 1.1)], p=[0.25, 0.6, 0.15]
  )
  depth = rng.uniform(0.45, 0.95)
  width = depth * rng.choice([1.0, rng.uniform(1.1, 2.3)], p=[0.25, 0.75])
  if kind == 'pedestal':
    width = min(width, 1.5 * depth)
  frame = (
    mt.wood(rng, colors.wood)
    if rng.uniform() < 0.5
    else mt.plain([colors.main, colors.metal, colors.second][rng.integers(3)])
  )
  board = top_material(rng, colors)
  thick = rng.uniform(0.025, 0.08)
  round_top = rng.uniform() < (0.6 if kind == 'pedestal' else 0.2) and kind != 'desk'
  outline = top_outline(rng, width, depth, round_top)
  parts = [paint(top_slab(rng, outline, height, thick), board)]
  if rng.uniform() < 0.25:  # a rim of another colour
    rim = solids.slab(outline * 1.015, height - thick - 0.012, height - 0.25 * thick)
    parts.append(paint(rim, mt.plain(colors.accent)))
  if rng.uniform() < 0.28:
    parts += cloth(rng, outline, width, depth, height, colors)
  x, z = 0.5 * width * 0.92 - 0.03, 0.5 * depth * 0.9 - 0.03
  # Legs stay under a top whose corners are cut: as far out as its diagonal reaches.
  reach = np.hypot(*outline.T)[np.abs(outline @ [z, -x]).argsort()[:4]].min()
  x, z = np.array([x, z]) * min(1.0, 0.88 * reach / np.hypot(x, z))
  under = height - thick
  if kind == 'legs':
    return parts + legged(rng, x, z, under, frame, board, colors)
  if kind == 'pedestal':
    return parts + pedestal(rng, width, depth, under, frame)
  if kind == 'trestle':
    return parts + trestle(rng, x, z, under, frame)
  if kind == 'desk':
    return parts + desk(rng, x, z, under, frame, colors)
  return parts + slabs(rng, x, z, under, frame, colors)


def top_material(rng, colors) -> mt.Material:
  """Wood, boards, tiles, stone, a border, or a plain colour."""
  kind = rng.uniform()
  if kind < 0.2:
    return mt.wood(rng, colors.wood, period=rng.uniform(0.4, 0.7))
  if kind < 0.48:
    return surfaces.boards(rng, colors.wood, int(rng.integers(3, 7)))
  if kind < 0.62:
    return surfaces.tiles(rng, (colors.main, colors.second, colors.accent), int(rng.integers(3, 6)))
  if kind < 0.76:
    return surfaces.stone(rng, colors.second if rng.uniform() < 0.5 else mt.neutral(rng))
  if kind < 0.84:
    tones = (colors.main, colors.second, colors.accent)
    return surfaces.bordered(tones, width=rng.uniform(0.08, 0.16), round_=rng.uniform() < 0.5)
  return mt.plain([colors.main, colors.second, colors.accent][rng.integers(3)])


def top_outline(rng, width, depth, round_top) -> np.ndarray:
  """A rectangle, rounded rectangle, boat, octagon, circle or oval [M, 2]."""
  if round_top:
    return solids.ellipse(width, depth, sides=int(rng.choice([6, 8, 32, 32, 32])))
  kind = rng.uniform()
  if kind < 0.5:
    return solids.rectangle(width, depth)
  if kind < 0.6:
    return solids.rectangle(width, depth, taper=rng.uniform(0.1, 0.2))
  return solids.ellipse(width, depth, power=rng.uniform(2.8, 8), sides=32)


def top_slab(rng, outline, height, thick):
  """The top with a square, cut or undercut edge."""
  kind = rng.uniform()
  if kind < 0.6:
    return solids.slab(outline, height - thick, height, bevel=rng.choice([0.0, 0.25 * thick]))
  inner = np.insert(outline * rng.uniform(0.86, 0.96), 1, height - thick, axis=1)
  levels = [inner, *(np.insert(outline, 1, y, axis=1) for y in (height - 0.4 * thick, height))]
  return solids.loft(levels)


def cloth(rng, outline, width, depth, height, colors) -> list[Part]:
  """A runner across the table, a mat in its middle, or a cloth over all of it."""
  pattern = mt.fabric(
    rng, (colors.accent, colors.second, colors.main), period=rng.uniform(0.25, 0.45)
  )
  kind = rng.uniform()
  if kind < 0.35:
    w = width * rng.uniform(0.2, 0.5)
    drop = rng.uniform(0.1, 0.25)
    z = 0.5 * depth + 0.012
    line = [(-z, height - drop), (-z, height + 0.01), (z, height + 0.01), (z, height - drop)]
    grid = [[(x, y, z) for x in (-w / 2, w / 2)] for z, y in line]
    return [paint(solids.sheet(np.array(grid), 0.024), pattern)]
  if kind < 0.5:
    outline = 0.55 * outline
    tones = (colors.accent, colors.second, colors.main)
    mat = surfaces.bordered(tones, width=rng.uniform(0.1, 0.2), round_=len(outline) > 8)
    return [paint(solids.slab(outline, height - 0.01, height + 0.014), mat)]
  drop = height - rng.uniform(0.12, 0.45) * height
  over = [np.insert(outline * s, 1, y, axis=1) for s, y in ((1.06, drop), (1.02, height + 0.012))]
  return [paint(solids.loft(over), pattern)]


def legged(rng, x, z, height, frame, board, colors) -> list[Part]:
  """Four legs with an apron, a shelf, drawers or stretchers."""
  r = rng.uniform(0.022, 0.05)
  parts = legs.four(rng, x, z, height, r, frame, splay=rng.choice([0.0, rng.uniform(0.03, 0.09)]))
  if rng.uniform() < 0.55:
    h = rng.uniform(0.05, 0.16)
    apron = frame if rng.uniform() < 0.5 else mt.plain(colors.second)
    parts.append(paint(solids.box((2 * x, h, 2 * z), (0, height - h / 2, 0)), apron))
    if h > 0.09:
      parts += drawers(rng, -x, x, height - h, height, z, int(rng.integers(1, 4)), 1, colors)
  if rng.uniform() < 0.35:
    y = height * rng.uniform(0.2, 0.5)
    shelf = solids.slab(solids.rectangle(2 * x, 2 * z), y, y + 0.03)
    parts.append(paint(shelf, board if rng.uniform() < 0.5 else mt.plain(colors.accent)))
  return parts


def drawers(rng, x0, x1, low, high, z, columns, rows, colors) -> list[Part]:
  """Drawer fronts with knobs on the plane z."""
  front = mt.plain(colors.accent if rng.uniform() < 0.5 else mt.shade(colors.wood, 1.25))
  knob = mt.plain(colors.metal)
  w, h = (x1 - x0) / columns, (high - low) / rows
  parts = []
  for i in range(columns):
    for j in range(rows):
      center = np.array([x0 + (i + 0.5) * w, low + (j + 0.5) * h, z])
      parts.append(paint(solids.box((0.86 * w, 0.78 * h, 0.03), center), front))
      parts.append(paint(solids.ellipsoid([0.022] * 3, center + [0, 0, 0.025], sides=8), knob))
  return parts


def pedestal(rng, width, depth, height, frame) -> list[Part]:
  """One column, turned, plain, or a drum; two of them under a long top."""
  radius = rng.uniform(0.28, 0.42) * depth
  kind = rng.uniform()
  if kind < 0.25:  # a drum or hourglass
    y = np.linspace(0, 1, 9)
    waist = 1 - rng.uniform(0, 0.6) * np.sin(np.pi * y)
    drum = solids.lathe(np.stack([radius * waist, y * height], 1), sides=24)
    return [paint(drum, frame)]
  if kind < 0.5:  # turned
    y = np.linspace(0.06, 1, 24)
    beads = np.abs(np.sin(y * rng.uniform(6, 12) + rng.uniform(0, 3)))
    profile = np.stack([0.035 + 0.05 * beads * rng.uniform(0.5, 1), y * height], 1)
    parts = [paint(solids.lathe(profile, sides=14), frame)]
    return parts + legs.star(rng, radius, int(rng.choice([3, 4])), frame, casters=None)
  if width > 1.3 * depth:
    column = [move(p, [0.25 * width, 0, 0]) for p in legs.column(rng, 0.8 * radius, height, frame)]
    y = rng.uniform(0.1, 0.5) * height
    beam = paint(solids.box((0.5 * width, 0.06, 0.05), (0, y, 0)), frame)
    return column + [mirror(p) for p in column] + [beam]
  return legs.column(rng, radius, height, frame)


def trestle(rng, x, z, height, frame) -> list[Part]:
  """Two A-, X- or T-shaped ends joined by a beam."""
  kind = int(rng.integers(3))
  r = rng.uniform(0.022, 0.04)
  x = x * rng.uniform(0.65, 0.95)
  if kind == 0:
    ends = [([x, 0, s * z], [x, height, s * 0.2 * z]) for s in (1, -1)]
    ends.append(([x, 0.35 * height, -0.7 * z], [x, 0.35 * height, 0.7 * z]))
  elif kind == 1:
    ends = [([x, 0, s * z], [x, height, -s * z]) for s in (1, -1)]
  else:
    ends = [([x, 0, 0], [x, height, 0])]
    ends += [([x, y, -0.9 * z], [x, y, 0.9 * z]) for y in (r, height - r)]
  side = [paint(solids.bar(a, b, r, sides=4), frame) for a, b in ends]
  y = height * rng.uniform(0.3, 0.7)
  return side + [mirror(p) for p in side] + [paint(solids.bar([-x, y, 0], [x, y, 0], r), frame)]


def desk(rng, x, z, height, frame, colors) -> list[Part]:
  """A cabinet of drawers at one end or both, legs or a board at the other, a back panel."""
  body = frame if rng.uniform() < 0.5 else mt.plain(colors.main)
  w = min(rng.uniform(0.28, 0.42), 0.8 * x)
  clear = rng.choice([0.0, rng.uniform(0.04, 0.14)])
  box = solids.box((w, height - clear, 2 * z), (x - w / 2, clear + (height - clear) / 2, 0))
  cabinet = [paint(box, body)]
  if clear > 0:
    foot = [(x - dx, s * 0.8 * z) for dx in (0.04, w - 0.04) for s in (1, -1)]
    cabinet += [paint(solids.bar([a, 0, b], [a, clear, b], 0.022), frame) for a, b in foot]
  rows = int(rng.integers(1, 5))
  cabinet += drawers(rng, x - w, x, clear, height, z, 1, rows, colors)
  kind = rng.uniform()
  if kind < 0.4:
    far = [mirror(p) for p in cabinet]
  elif kind < 0.7:
    far = [paint(solids.box((0.05, height, 2 * z), (-x, height / 2, 0)), body)]
  else:
    ends = [(-x, s * 0.92 * z) for s in (1, -1)]
    far = [paint(solids.bar([a, 0, b], [a, height, b], 0.026, sides=4), frame) for a, b in ends]
  if rng.uniform() < 0.5:
    cabinet = [mirror(p) for p in cabinet]
    far = [mirror(p) for p in far]
  if rng.uniform() < 0.5:
    h = height * rng.uniform(0.3, 0.8)
    far.append(paint(solids.box((2 * x, h, 0.03), (0, height - h / 2, -0.9 * z)), body))
  return cabinet + far


def slabs(rng, x, z, height, frame, colors) -> list[Part]:
  """Boards for legs: two ends, a waterfall, a cube or a cross, maybe with shelves."""
  board = (
    frame
    if rng.uniform() < 0.5
    else mt.fabric(rng, (colors.main, colors.second, colors.accent), period=0.45)
  )
  t = rng.uniform(0.03, 0.08)
  kind = int(rng.integers(3))
  if kind == 0:  # crossed boards
    return [
      paint(solids.box((2 * x, height, t), (0, height / 2, 0)), board),
      paint(solids.box((t, height, 2 * z), (0, height / 2, 0)), board),
    ]
  lean = rng.choice([0.0, rng.uniform(-0.12, 0.12)])
  foot, top = np.array([x + lean, 0, 0]), np.array([x, height, 0])
  end = solids.tube([foot, top], [[t / 2, z]] * 2, sides=4, up=(0, 0, 1))
  parts = [paint(end, board)]
  parts.append(mirror(parts[0]))
  levels = rng.integers(1, 3) if kind == 1 else 1
  for k in range(int(levels)):
    y = height * (k + 1) / (levels + 1)
    shelf = solids.box((2 * x, 0.03, 2 * z * 0.95), (0, y, 0))
    parts.append(paint(shelf, mt.plain(colors.accent if k else colors.second)))
  if kind == 2:
    back = solids.box((2 * x, height, 0.03), (0, height / 2, -0.9 * z))
    parts.append(paint(back, mt.plain(colors.second)))
  return parts
