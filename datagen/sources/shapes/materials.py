"""Colours and small tiling images for the surfaces of procedural objects.

Colours are sRGB in [0, 1], in the middle of the range, so that an object stands out from the pale
background of its views and its pattern keeps its contrast.
"""

import colorsys
from typing import NamedTuple

import numpy as np

SIZE = 64  # edge of a pattern, texels

GRAIN, PATTERN = 0.3, 0.38  # the largest distance between a wood's, or a pattern's, colours

# Rows of a 3 x 5 font, most significant bit left.
_DIGITS = ('75557', '26227', '71747', '71717', '55711', '74717', '74757', '71111', '75757', '75717')


class Material(NamedTuple):
  """A colour, or an image on the surface."""

  color: np.ndarray  # [3]; multiplies the picture
  picture: np.ndarray | None = None  # [H, W, 4] uint8
  period: float | None = None  # length that one picture covers; None: the part's whole extent
  grain: bool = False  # whether v is to run along the part


class Scheme(NamedTuple):
  """The colours of one object."""

  main: np.ndarray
  second: np.ndarray
  accent: np.ndarray
  wood: np.ndarray
  metal: np.ndarray


def hsv(hue: float, saturation: float, value: float) -> np.ndarray:
  """An sRGB colour [3]; the hue wraps."""
  return np.array(colorsys.hsv_to_rgb(hue % 1.0, saturation, value))


def shade(color, factor: float) -> np.ndarray:
  """A darker (factor < 1) or lighter colour, held inside [0.06, 0.9]."""
  return np.clip(np.asarray(color) * factor, 0.06, 0.9)


def neutral(rng) -> np.ndarray:
  """A grey, slightly warm or cold."""
  return np.clip(rng.uniform(0.2, 0.78) + np.array([1, 0, -1]) * rng.normal(0, 0.03), 0.08, 0.88)


def scheme(rng) -> Scheme:
  """Colours that belong together: a hue, its neighbour or complement, an accent, wood and metal."""
  hue = rng.uniform()
  main = hsv(hue, rng.uniform(0.35, 0.9), rng.uniform(0.4, 0.85))
  if rng.uniform() < 0.15:
    main = neutral(rng)
  other = hue + rng.choice([0.08, -0.08, 0.33, 0.5, 0.6])
  second = hsv(other, rng.uniform(0.25, 0.85), rng.uniform(0.3, 0.88))
  if rng.uniform() < 0.4:
    light = np.array([0.86, 0.82, 0.72]) * rng.uniform(0.9, 1.0)
    second = light if main.mean() < 0.55 else shade(main, rng.uniform(0.3, 0.55))
  accent = hsv(rng.uniform(), rng.uniform(0.5, 0.95), rng.uniform(0.45, 0.88))
  wood = hsv(rng.uniform(0.035, 0.115), rng.uniform(0.35, 0.75), rng.uniform(0.28, 0.82))
  metal = neutral(rng) if rng.uniform() < 0.8 else hsv(rng.uniform(), 0.6, rng.uniform(0.4, 0.7))
  return Scheme(main, second, accent, wood, metal)


def plain(color) -> Material:
  """One colour all over."""
  return Material(np.asarray(color, float))


def close(colors, distance: float) -> list[np.ndarray]:
  """Moves colours towards the first one until none is farther from it than `distance`.

  At the border of two colours, voxels and pixels mix them differently. With many borders, colours
  must not differ too much, or views would not show the voxels' colours.
  """
  first = np.asarray(colors[0], float)
  steps = [np.asarray(c, float) - first for c in colors]
  return [first + s * min(1.0, distance / max(np.linalg.norm(s), 1e-9)) for s in steps]


def drawn(rgb) -> Material:
  """A picture [H, W, 3] for a whole part, colours in [0, 1]."""
  rgb = np.round(np.clip(rgb, 0, 1) * 255).astype(np.uint8)
  return Material(np.ones(3), np.insert(rgb, 3, 255, axis=-1))


def lookup(material: Material, u, v) -> np.ndarray:
  """Colours [..., 3] of a pictured material at (u, v), repeating, by the nearest texel."""
  height, width = material.picture.shape[:2]
  column, row = (np.floor(u % 1 * width)).astype(int), (np.floor(-v % 1 * height)).astype(int)
  return material.picture[row % height, column % width, :3] / 255


def pictured(mask, colors, *, period: float | None = None) -> Material:
  """A picture [H, W] of indices, or of weights between two colours, in the colours given."""
  mask = np.asarray(mask)
  colors = np.asarray(colors, float)
  if mask.dtype.kind == 'f':
    rgb = colors[0] + mask[..., None] * (colors[1] - colors[0])
  else:
    rgb = colors[mask.astype(int)]
  alpha = np.full(mask.shape + (1,), 255, np.uint8)
  rgb = np.round(np.clip(rgb, 0, 1) * 255).astype(np.uint8)
  return Material(np.ones(3), np.concatenate([rgb, alpha], -1), period)


def _uv(size: int = SIZE):
  """Texel centres (u right, v up), [size, size] each."""
  t = (np.arange(size) + 0.5) / size
  return np.meshgrid(t, t[::-1])


def wood(rng, color, *, period: float = 0.5) -> Material:
  """Grain along the part: wavy streaks of one tone, and maybe knots."""
  u, v = _uv(128)
  bend = rng.uniform(0.02, 0.06) * np.sin(2 * np.pi * (v + rng.uniform()))
  if rng.uniform() < 0.5:
    x, y = rng.uniform(size=2)
    near = np.hypot((u - x + 0.5) % 1 - 0.5, 0.4 * ((v - y + 0.5) % 1 - 0.5))
    bend = bend + 0.12 * np.exp(-((near / 0.1) ** 2))
  t = sum(
    a * np.sin(2 * np.pi * (k * (u + bend) + rng.uniform()))
    for k, a in ((1, 0.3), (2, 0.5), (int(rng.integers(3, 6)), 0.35))
  )
  t = np.clip(0.5 + 0.45 * t, 0, 1)
  tones = [shade(color, rng.uniform(0.66, 0.8)), shade(color, rng.uniform(1.1, 1.22))]
  return pictured(t, close(tones, GRAIN), period=period)._replace(grain=True)


def stripes(rng, colors, *, period: float, angle: int | None = None) -> Material:
  """Bands across u (angle 0), across v (1) or diagonal (2)."""
  u, v = _uv()
  kind = int(rng.integers(3)) if angle is None else angle
  t = ((u, v, u + v)[kind] + rng.uniform()) % 1.0
  mask = (t < rng.uniform(0.3, 0.5)).astype(int)
  if rng.uniform() < 0.4:
    mask[np.abs(t - 0.75) < 0.1] = 2
  return pictured(mask, colors, period=period)


def checks(rng, colors, *, period: float) -> Material:
  """A chequer, or a tartan of crossing bands."""
  u, v = _uv()
  a, b = (u < 0.5), (v < 0.5)
  if rng.uniform() < 0.5:
    return pictured(a ^ b, colors, period=period)
  mix = 0.5 * a + 0.5 * b
  return pictured(mix.astype(float), colors[:2], period=period)


def dots(rng, colors, *, period: float) -> Material:
  """Dots in a staggered grid."""
  u, v = _uv()
  radius = rng.uniform(0.14, 0.22)
  near = [
    np.hypot((u - x + 0.5) % 1 - 0.5, (v - y + 0.5) % 1 - 0.5) < radius
    for x, y in ((0.25, 0.25), (0.75, 0.75))
  ]
  mask = np.zeros(u.shape, int)
  mask[near[0]] = 1
  mask[near[1]] = 1 if rng.uniform() < 0.6 else 2
  return pictured(mask, colors, period=period)


def blotches(rng, colors, *, period: float) -> Material:
  """Irregular patches: camouflage, marble or flowers, by the frequencies drawn."""
  u, v = _uv()
  high = int(rng.integers(2, 5))
  field = sum(
    np.sin(2 * np.pi * (rng.integers(-high, high + 1) * u + rng.integers(1, high + 1) * v + p))
    for p in rng.uniform(size=6)
  )
  mask = (field > rng.uniform(-0.3, 0.8)).astype(int) + (field > rng.uniform(1.5, 2.5))
  return pictured(np.minimum(mask, 2), colors, period=period)


def chevrons(rng, colors, *, period: float) -> Material:
  """Zigzag bands, or diamonds."""
  u, v = _uv()
  bend = np.abs(u - 0.5)
  if rng.uniform() < 0.5:
    return pictured((v + bend) % 1 < 0.5, colors, period=period)
  return pictured(bend + np.abs(v - 0.5) < rng.uniform(0.3, 0.42), colors, period=period)


def fabric(rng, colors, *, period: float) -> Material:
  """A plain or patterned cloth in up to three colours."""
  kind = rng.uniform()
  if kind < 0.26:
    return plain(colors[0])
  colors = close(colors, PATTERN)
  if kind < 0.42:
    return stripes(rng, colors, period=period)
  if kind < 0.58:
    return checks(rng, colors, period=period)
  if kind < 0.72:
    return dots(rng, colors, period=period)
  if kind < 0.86:
    return blotches(rng, colors, period=period * 1.6)
  return chevrons(rng, colors, period=period)


def emblem(rng, base, mark) -> Material:
  """A picture for a whole part: a badge, ring, star, band or number on a ground."""
  u, v = _uv(128)
  x, y = 2 * u - 1, 2 * v - 1
  kind = int(rng.integers(6))
  size = rng.uniform(0.4, 0.65)
  r, a = np.hypot(x, y), np.arctan2(x, y)
  if kind == 0:
    mask = r < size
  elif kind == 1:
    mask = np.abs(r - size) < 0.14
  elif kind == 2:
    point = np.abs((a / (2 * np.pi) * 5 + 0.5) % 1 - 0.5) * 2
    mask = r < size * (1.15 - 0.65 * point)
  elif kind == 3:
    mask = np.abs(y + rng.uniform(-0.2, 0.2)) < 0.5 * size
  elif kind == 4:
    mask = np.abs(x) + np.abs(y) < size
  else:
    mask = _number(int(rng.integers(10, 100)), x / size, y / size)
  return pictured(mask.astype(int), [base, mark])


def _number(value: int, x, y) -> np.ndarray:
  """Two digits drawn inside [-1, 1]^2."""
  rows = [_DIGITS[int(d)] for d in str(value)]
  bits = np.zeros((5, 7), bool)
  for k, digit in enumerate(rows):
    for i, row in enumerate(digit):
      bits[i, 4 * k : 4 * k + 3] = [int(row) >> 2 & 1, int(row) >> 1 & 1, int(row) & 1]
  i, j = np.floor((1 - y) / 2 * 5).astype(int), np.floor((x + 1) / 2 * 7).astype(int)
  inside = (i >= 0) & (i < 5) & (j >= 0) & (j < 7)
  return inside & bits[np.clip(i, 0, 4), np.clip(j, 0, 6)]
