"""Heads: a face to +z, hair, hats, beards. The joint is where the head sits on the neck."""

import numpy as np

from datagen.sources.shapes import materials as mt
from datagen.sources.shapes import solids
from datagen.sources.shapes.parts import Part, ahead, mirror, move, paint, scale, texels

WHITE = np.array([0.88, 0.88, 0.86])  # of eyes


def head(rng, skin, colors: mt.Scheme, *, size: float) -> list[Part]:
  """A whole head, `size` times an adult's."""
  w, h, d = rng.uniform([0.074, 0.115, 0.092], [0.09, 0.13, 0.105])
  center = np.array([0, h + 0.005, 0.01])
  parts = [move(p, center) for p in [*face(rng, w, h, d, skin), *hair(rng, w, h, d, colors)]]
  return [scale(p, size) for p in parts]


def face(rng, w, h, d, skin) -> list[Part]:
  """The skull with eyes, brows, nose, mouth and ears, centred."""
  bare, dark = mt.plain(skin), mt.plain([0.12, 0.1, 0.1])
  skull = solids.ellipsoid((w, h, d), sides=20)
  front, behind = ahead(skull)
  parts = [paint(front, features(rng, skull, w, h, skin), axis=2), paint(behind, bare)]
  x, y = 0.42 * w, 0.1 * h
  ear = paint(solids.ellipsoid((0.016, 0.03, 0.022), (w, 0, -0.005), sides=8), bare)
  parts += [ear, mirror(ear)]
  nose = solids.ellipsoid((0.014, 0.026, 0.02), (0, -0.12 * h, 0.97 * d), sides=8)
  parts.append(paint(nose, mt.plain(mt.shade(skin, 0.93))))
  if rng.uniform() < 0.15:  # glasses
    lens = paint(solids.box((0.045, 0.034, 0.01), (x, y, 0.9 * d + 0.02)), dark)
    bridge = paint(solids.box((2.3 * w, 0.008, 0.01), (0, y + 0.01, 0.9 * d + 0.01)), dark)
    parts += [lens, mirror(lens), bridge]
  return parts


def features(rng, skull, w, h, skin) -> mt.Material:
  """Eyes, brows, mouth and cheeks, painted on a skull of half width w and half height h."""
  x, y = texels(skull, 2, 1, 128)
  dark, lips = mt.close([skin, [0.14, 0.11, 0.1], [0.66, 0.2, 0.22]], 0.5)[1:]
  iris = mt.hsv(rng.choice([0.08, 0.3, 0.58]), 0.6, rng.uniform(0.15, 0.5))
  rgb = np.broadcast_to(np.asarray(skin, float), (*x.shape, 3)).copy()
  across = np.abs(x) - 0.42 * w
  rgb[np.hypot(across, y + 0.25 * h) < 0.2 * h] = mt.close([skin, [0.8, 0.4, 0.38]], 0.1)[1]
  rgb[np.hypot(across / 0.024, (y - 0.1 * h) / 0.017) < 1] = mt.close([skin, WHITE], 0.45)[1]
  rgb[np.hypot(across, y - 0.1 * h) < 0.012] = iris
  rgb[(np.abs(across) < 0.024) & (np.abs(y - 0.37 * h) < 0.008)] = dark
  wide, smile = rng.uniform(0.024, 0.034), rng.uniform(0.0, 0.25)
  curve = y + 0.5 * h - smile * h * (x / wide) ** 2 * 0.3
  rgb[(np.abs(x) < wide) & (np.abs(curve) < 0.011)] = lips
  return mt.drawn(rgb)


def hair(rng, w, h, d, colors: mt.Scheme) -> list[Part]:
  """Hair in one of several cuts and colours, maybe a beard, maybe a hat on top."""
  natural = [
    [0.13, 0.1, 0.09],
    [0.3, 0.18, 0.1],
    [0.52, 0.3, 0.14],
    [0.8, 0.65, 0.34],
    [0.55, 0.55, 0.55],
    [0.55, 0.2, 0.08],
  ]
  tone = np.array(natural[rng.integers(6)]) if rng.uniform() < 0.85 else colors.accent
  strand = mt.plain(tone)
  parts = []
  cut = rng.choice(
    ['bald', 'short', 'bob', 'long', 'afro', 'bun', 'tail', 'spikes', 'parted'],
    p=[0.08, 0.22, 0.12, 0.14, 0.09, 0.08, 0.11, 0.06, 0.1],
  )
  if cut == 'afro':
    r = rng.uniform(1.25, 1.7)
    parts.append(
      paint(solids.ellipsoid((w * r, h * r * 0.85, d * r * 0.85), (0, 0.3 * h, -0.3 * d)), strand)
    )
  elif cut != 'bald':
    grow = rng.uniform(1.06, 1.18)
    parts.append(paint(cap(w * grow, h * grow, d * grow, rng.uniform(0.25, 0.5)), strand))
  if cut in ('bob', 'long'):
    drop = h * (rng.uniform(0.7, 1.1) if cut == 'bob' else rng.uniform(1.6, 3.0))
    a = np.linspace(-1, 1, 11) * rng.uniform(1.7, 2.1)
    t = np.linspace(0, 1, 6)[:, None]
    swell = 1.08 + rng.uniform(0, 0.35) * t
    wall = np.broadcast_arrays(
      w * np.sin(a) * swell, 0.3 * h - t * (drop + 0.3 * h), -d * np.cos(a) * swell
    )
    parts.append(paint(solids.sheet(np.stack(wall, -1), 0.04), strand))
  elif cut == 'bun':
    parts.append(
      paint(solids.ellipsoid([0.055] * 3, (0, rng.uniform(0.2, 1.1) * h, -0.95 * d)), strand)
    )
  elif cut == 'tail':
    path = [[0, 0.4 * h, -d], [0, 0.3 * h, -d - 0.09], [0, -h, -d - 0.07], [0, -1.9 * h, -d - 0.05]]
    parts.append(paint(solids.tube(solids.smooth(path), 0.034), strand))
  elif cut == 'spikes':
    for z in np.linspace(-0.7, 0.6, 4):
      y = h * np.sqrt(1 - z**2)
      root, tip = [0, 0.9 * y, z * d], [0, y + 0.09, z * d * 1.2 - 0.02]
      parts.append(paint(solids.bar(root, tip, (0.035, 0.008), sides=6), strand))
  if rng.uniform() < 0.14:
    beard = solids.ellipsoid((0.85 * w, 0.55 * h, 0.6 * d), (0, -0.62 * h, 0.38 * d), sides=12)
    parts.append(paint(beard, strand))
  if rng.uniform() < 0.3:
    parts += hat(rng, w, h, d, colors)
  return parts


def cap(w, h, d, brow) -> solids.Solid:
  """Half an ellipsoid over the crown, higher over the forehead than at the nape."""
  t = np.linspace(0, 1, 7)[:, None]
  a = 2 * np.pi * np.arange(16) / 16
  edge = np.arcsin(brow) * np.maximum(np.sin(a), 0) - 0.45 * np.maximum(-np.sin(a), 0)
  up = edge + t * (np.pi / 2 - 0.02 - edge)
  rings = np.broadcast_arrays(
    w * np.cos(up) * np.cos(a), h * np.sin(up), d * np.cos(up) * np.sin(a)
  )
  return solids.loft(np.stack(rings, -1))


def hat(rng, w, h, d, colors: mt.Scheme) -> list[Part]:
  """A cap with a peak, a brimmed hat, a top hat, a beanie or a helmet."""
  kind = int(rng.integers(5))
  cloth = mt.plain([colors.main, colors.second, colors.accent][rng.integers(3)])
  band = mt.plain(colors.second)
  crown = paint(cap(w * 1.25, h * 1.22, d * 1.25, 0.3), cloth)
  if kind == 0:
    peak = solids.slab(solids.ellipse(1.9 * w, 1.3 * d), 0.3 * h, 0.3 * h + 0.014)
    return [crown, paint(move(peak, [0, 0, 0.95 * d]), band)]
  if kind in (1, 2):
    r = rng.uniform(1.6, 2.3)
    brim = solids.slab(solids.ellipse(2 * r * w, 2 * r * d), 0.36 * h, 0.36 * h + 0.016)
    top = h * (rng.uniform(1.2, 1.5) if kind == 1 else rng.uniform(1.8, 2.3))
    tower = solids.slab(solids.ellipse(2.3 * w, 2.3 * d), 0.36 * h, top, bevel=0.02)
    ring = solids.slab(solids.ellipse(2.36 * w, 2.36 * d), 0.42 * h, 0.7 * h)
    return [paint(brim, cloth), paint(tower, cloth), paint(ring, band)]
  if kind == 3:
    return [crown, paint(solids.ellipsoid([0.032] * 3, (0, 1.3 * h, 0)), band)]
  shell = paint(cap(w * 1.4, h * 1.3, d * 1.4, 0.28), cloth)
  return [shell, paint(solids.box((0.04, 0.04, 2.3 * d), (0, 1.22 * h, 0)), band)]
