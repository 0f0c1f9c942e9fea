"""What a car wears: paint schemes for its sides, top and roof, rims, and things on the roof."""

from typing import NamedTuple

import numpy as np

from datagen.sources.shapes import materials as mt
from datagen.sources.shapes import solids
from datagen.sources.shapes.parts import Part, facing, mirror, paint


class Look(NamedTuple):
  """A car's paint."""

  base: np.ndarray  # [3]
  roof: np.ndarray  # [3]
  sides: mt.Material
  top: mt.Material
  sign: mt.Material | None  # on the roof


def _grid():
  t = (np.arange(128) + 0.5) / 128
  return np.meshgrid(t, t[::-1])


def choose(rng, colors: mt.Scheme) -> Look:
  """Plain, two-tone, banded, chequered, panelled, numbered, flamed or camouflaged."""
  base, second, accent = colors.main, colors.second, colors.accent
  if rng.uniform() < 0.12:
    base = np.array([0.9, 0.9, 0.88]) * rng.uniform(0.82, 0.98)
  u, v = _grid()
  kind = rng.choice(
    ['plain', 'two-tone', 'band', 'chequer', 'panel', 'number', 'flames', 'camouflage', 'fade'],
    p=[0.26, 0.15, 0.15, 0.08, 0.1, 0.1, 0.06, 0.04, 0.06],
  )
  sides, top, roof = mt.plain(base), mt.plain(base), base
  if rng.uniform() < 0.3:
    roof = second
  level = rng.uniform(0.3, 0.62)
  if kind == 'two-tone':
    sides = mt.pictured((v < level).astype(int), [base, second])
  elif kind == 'band':
    mask = (np.abs(v - level) < rng.uniform(0.06, 0.14)).astype(int)
    mask[np.abs(v - level - 0.22) < rng.choice([0.0, 0.03])] = 2
    sides = mt.pictured(mask, [base, second, accent])
  elif kind == 'chequer':
    cells = (np.floor(u * 28) + np.floor(v * 11)) % 2
    mask = np.where(np.abs(v - 0.5) < 0.19, 1 + cells, 0).astype(int)
    sides = mt.pictured(mask, [base, [0.12, 0.12, 0.12], [0.85, 0.85, 0.8]])
  elif kind == 'panel':
    mask = np.abs(u - 0.5 + rng.uniform(-0.08, 0.08)) < rng.uniform(0.12, 0.25)
    sides = mt.pictured(mask.astype(int), [base, second])
  elif kind == 'number':
    sides = _roundel(rng, base, second, accent)
  elif kind == 'flames':
    wave = 0.5 + 0.25 * np.abs(np.sin(u * np.pi * rng.integers(3, 6)))
    mask = (v < wave * (0.4 + 1.1 * np.abs(u - 0.5))).astype(int)
    sides = mt.pictured(mask, [base, accent])
  elif kind == 'camouflage':
    sides = top = mt.blotches(rng, (base, second, mt.shade(base, 0.6)), period=1.5)
  elif kind == 'fade':
    sides = mt.pictured(np.clip(v * 1.6 - 0.3, 0, 1), [second, base])
  if rng.uniform() < 0.35:
    x = np.abs(u - 0.5 + rng.choice([0.0, 0.2]))
    near = rng.choice([0.0, 0.05])
    mask = (x > near) & (x < near + rng.uniform(0.06, 0.12))
    top = mt.pictured(mask.astype(int), [base, second if rng.uniform() < 0.6 else accent])
  sign = mt.emblem(rng, roof, accent) if rng.uniform() < 0.2 else None
  return Look(base, roof, sides, top, sign)


def _roundel(rng, base, second, accent) -> mt.Material:
  """A disc with a number on each side, round although the side is long and low."""
  badge = mt.emblem(rng, second, accent).picture
  u, v = _grid()
  x, y = (u - 0.5) * 4.2, v - 0.5
  inside = np.hypot(x, y) < 0.42
  row = np.clip((0.5 - y / 0.9) * 128, 0, 127).astype(int)
  column = np.clip((0.5 + x / 0.9) * 128, 0, 127).astype(int)
  picture = mt.pictured(np.zeros(u.shape, int), [base]).picture
  picture[inside] = badge[row, column][inside]
  return mt.Material(np.ones(3), picture)


def wear(hull, look: Look) -> list[Part]:
  """The lower body in its paint."""
  return [
    paint(facing(hull, (0,)), look.sides),
    paint(facing(hull, (1,)), look.top),
    paint(facing(hull, (2,)), mt.plain(look.base)),
  ]


def cover(roof, look: Look) -> list[Part]:
  """The roof in its paint."""
  if look.sign is None:
    return [paint(roof, mt.plain(look.roof))]
  return [paint(facing(roof, (0, 2)), mt.plain(look.roof)), paint(facing(roof, (1,)), look.sign)]


def rim(rng, colors: mt.Scheme) -> mt.Material:
  """A wheel's face: tyre, rim and spokes."""
  u, v = _grid()
  x, y = 2 * u - 1, 2 * v - 1
  r, a = np.hypot(x, y), np.arctan2(y, x)
  spokes = int(rng.integers(3, 9))
  open_part = (np.cos(a * spokes) > rng.uniform(-0.5, 0.6)) & (r > 0.22) & (r < 0.55)
  mask = np.where(r > rng.uniform(0.6, 0.75), 0, np.where(open_part, 1, 2))
  shine = mt.shade(colors.metal, 1.3) if rng.uniform() < 0.75 else colors.accent
  return mt.pictured(mask, [[0.13] * 3, mt.shade(shine, 0.4), shine])


def crate(rng, colors: mt.Scheme) -> mt.Material:
  """A load's skin: lettered, striped or plain."""
  kind = int(rng.integers(3))
  if kind == 0:
    return mt.emblem(rng, colors.second, colors.accent)
  if kind == 1:
    return mt.stripes(
      rng, (colors.second, colors.accent, colors.main), period=rng.uniform(0.5, 1.5)
    )
  return mt.plain(colors.second)


def extras(rng, form, kind, look: Look, colors) -> list[Part]:
  """A taxi sign, a light bar, a rack with luggage, a spoiler, a board over the sill."""
  parts = []
  rear, front = np.array(form.roof) * form.length
  mid, top = 0.5 * (rear + front), form.height + 0.03
  pick = rng.uniform() if kind not in ('open', 'lorry') else 1.0
  w = 0.7 * form.width
  if pick < 0.08:
    parts.append(
      paint(solids.box((0.5, 0.2, 0.2), (0, top + 0.1, mid)), mt.plain([0.85, 0.7, 0.15]))
    )
  elif pick < 0.16:
    for x, tone in ((-0.25, [0.75, 0.12, 0.12]), (0.25, [0.12, 0.25, 0.75])):
      parts.append(paint(solids.box((0.5, 0.16, 0.25), (x, top + 0.08, mid)), mt.plain(tone)))
  elif pick < 0.27:
    for z in (rear + 0.2, front - 0.2):
      parts.append(paint(solids.box((w, 0.06, 0.06), (0, top + 0.05, z)), mt.plain(colors.metal)))
    if rng.uniform() < 0.6:
      long = 0.8 * (front - rear)
      trunk = solids.ellipse(w * rng.uniform(0.4, 0.9), long, power=6)
      load = solids.slab(trunk + [0, mid], top + 0.06, top + rng.uniform(0.2, 0.4), bevel=0.04)
      parts.append(paint(load, mt.plain(colors.accent)))
  if kind in ('sports', 'hatchback', 'sedan') and rng.uniform() < 0.4:
    up, z = form.boot + rng.uniform(0.1, 0.3), -0.47 * form.length
    wing = mt.plain(look.base if rng.uniform() < 0.5 else colors.accent)
    parts.append(paint(solids.box((0.8 * form.width, 0.05, 0.26), (0, up, z)), wing))
    post = paint(solids.box((0.06, 0.4, 0.14), (0.3 * form.width, up - 0.2, z)), wing)
    parts += [post, mirror(post)]
  if kind in ('offroad', 'pickup', 'van') and rng.uniform() < 0.5:
    size = (0.16, 0.06, 0.4 * form.length)
    board = paint(
      solids.box(size, (0.5 * form.width, form.clearance + 0.03, 0)), mt.plain([0.2] * 3)
    )
    parts += [board, mirror(board)]
  if kind == 'offroad' and rng.uniform() < 0.5:
    spare = [[0, form.belt - 0.1, z] for z in (-0.5 * form.length - 0.22, -0.5 * form.length)]
    wheel = solids.bar(*spare, form.wheel * 0.9, sides=16)
    parts.append(paint(facing(wheel, (0, 1)), mt.plain([0.15] * 3)))
    parts.append(paint(facing(wheel, (2,)), rim(rng, colors)))
  return parts
