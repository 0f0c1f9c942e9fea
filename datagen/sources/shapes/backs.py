"""Chair backs: panels, slats, spindles, ladders, hoops, splats, crosses, rails.

A back is drawn on a bent surface: `Shape.at(s, t)` with s from -1 (x < 0) to 1 across and t from 0
at the seat to 1 at the top.
"""

from typing import NamedTuple

import numpy as np

from datagen.sources.shapes import solids
from datagen.sources.shapes.parts import Part, paint


class Shape(NamedTuple):
  """The surface a back follows, in metres."""

  width: float  # at the seat
  height: float
  seat: float  # y where it starts
  rear: float  # z where it starts
  tilt: float  # how far it leans back, per height
  bend: float  # lean that grows with the square of the height
  wrap: float  # how far the sides come forward
  flare: float  # how much wider the top is

  def at(self, s, t) -> np.ndarray:
    """Points [..., 3]; s and t broadcast."""
    s, t = np.broadcast_arrays(np.asarray(s, float), np.asarray(t, float))
    x = 0.5 * s * self.width * (1 + self.flare * t)
    z = self.rear - self.height * (self.tilt * t + self.bend * t**2) + self.wrap * s**2
    return np.stack([x, self.seat + t * self.height, z], -1)


STYLES = ('panel', 'pad', 'slats', 'spindles', 'ladder', 'hoop', 'splat', 'cross', 'rail', 'framed')


def build(rng, shape: Shape, frame, cloth, board) -> list[Part]:
  """A back in one of `STYLES`, its frame reaching a little below the seat's top."""
  style = rng.choice(STYLES, p=[0.14, 0.13, 0.14, 0.12, 0.13, 0.08, 0.08, 0.05, 0.06, 0.07])
  r = rng.uniform(0.014, 0.026)
  if style in ('panel', 'pad'):
    return plate(
      rng,
      shape,
      frame,
      cloth if style == 'pad' or rng.uniform() < 0.4 else board,
      thick=rng.uniform(0.05, 0.1) if style == 'pad' else rng.uniform(0.02, 0.035),
    )
  if style == 'hoop':
    return hoop(rng, shape, r, frame, board)
  sides = int(rng.choice([4, 8]))
  parts = [paint(rod(shape, s, s, -0.08, 1.0, r, sides), frame) for s in (-1, 1)]
  high = rng.uniform(0.08, 0.24)  # of the top rail, in t
  crown = rng.choice([0.0, rng.uniform(0.03, 0.12)])
  band = board if rng.uniform() < 0.4 else frame
  if style == 'ladder':
    count = int(rng.integers(2, 6))
    step = 0.85 / count
    fill = step * rng.uniform(0.35, 0.75)
    tops = 1 - step * np.arange(count)
    return parts + [paint(strip(shape, t - fill, t, crown), band) for t in tops]
  cover = cloth if rng.uniform() < 0.25 else band
  parts.append(paint(strip(shape, 1 - high, 1.0, crown, reach=1.05), cover))
  if style == 'rail':
    return parts
  low = rng.uniform(0.0, 0.3)
  if low > 0.08:
    parts.append(paint(strip(shape, low - 0.06, low, 0.0), band))
  top = 1 - high
  if style == 'slats':
    count = int(rng.integers(2, 7))
    at = np.linspace(-1, 1, count + 2)[1:-1]
    half = rng.uniform(0.25, 0.4) * 2 / (count + 1)
    parts += [paint(patch(shape, s - half, s + half, low - 0.02, top + 0.02), band) for s in at]
  elif style == 'spindles':
    at = np.linspace(-1, 1, int(rng.integers(4, 8)) + 2)[1:-1]
    narrow = rng.uniform(0.6, 1.0)
    parts += [
      paint(rod(shape, s * narrow, s, low - 0.02, top + 0.02, 0.6 * r + 0.003, 6), frame)
      for s in at
    ]
  elif style == 'splat':
    half = rng.uniform(0.2, 0.42)
    wave = rng.uniform(0.0, 0.4)
    parts.append(paint(patch(shape, -half, half, low - 0.02, top + 0.02, wave), cover))
  elif style == 'cross':
    for s in (-1, 1):
      parts.append(paint(rod(shape, s, -s, low, top, r, 4), frame))
  else:  # an inset panel
    edge = rng.uniform(0.7, 0.92)
    parts.append(paint(patch(shape, -edge, edge, low, top + 0.02, thick=0.04), cloth))
  return parts


def rod(shape: Shape, s0, s1, t0, t1, r, sides):
  """A bar that climbs the back from (s0, t0) to (s1, t1)."""
  k = np.linspace(0, 1, 6)
  return solids.tube(shape.at(s0 + (s1 - s0) * k, t0 + (t1 - t0) * k), r, sides=sides, up=(0, 0, 1))


def strip(shape: Shape, t0, t1, crown, *, reach=1.0):
  """A board across the back between two heights, its edges arched by `crown`."""
  s = np.linspace(-reach, reach, 9)
  t = np.linspace(t0, t1, 3)[:, None] + crown * (1 - (s / reach) ** 2)
  return solids.sheet(shape.at(s, t), 0.026)


def patch(shape: Shape, s0, s1, t0, t1, wave=0.0, *, thick=0.022):
  """A board up the back, its width swinging by `wave`."""
  t = np.linspace(t0, t1, 8)[:, None]
  s = np.linspace(-1, 1, 5) * (1 + wave * np.sin(t * 9)) * (s1 - s0) / 2 + (s0 + s1) / 2
  return solids.sheet(shape.at(s, t), thick)


def plate(rng, shape: Shape, frame, cover, *, thick) -> list[Part]:
  """One plate: square, arched, round-shouldered or waisted; standing on the seat or on struts."""
  gap = rng.choice([-0.06, rng.uniform(0.15, 0.4)])
  t = np.linspace(0, 1, 10)[:, None]
  power = rng.choice([2.2, 3.0, 5.0, 30.0])
  if gap > 0 and rng.uniform() < 0.6:  # free-standing: rounded below too
    half = (1 - np.abs(2 * t - 1) ** power) ** (1 / power)
  else:
    half = np.where(t > 0.5, np.maximum(1 - np.abs(2 * t - 1) ** power, 0) ** (1 / power), 1.0)
  half = np.maximum(half, 0.12) * (1 + rng.choice([0, 0.12]) * np.cos(7 * t))
  s = np.linspace(-1, 1, 9) * half
  crown = rng.choice([0.0, rng.uniform(0.02, 0.14)])
  height = gap + t * (1 - gap) + crown * t * (1 - np.linspace(-1, 1, 9) ** 2)
  bulge = 0.35 + 0.65 * np.sqrt(np.maximum(1 - np.linspace(-1, 1, 9) ** 4, 0)) * np.ones_like(t)
  solid = solids.sheet(shape.at(s, height), thick * (bulge if thick > 0.04 else 1.0))
  parts = [paint(solid, cover)]
  if gap > 0:
    spread = rng.uniform(0.3, 0.8)
    behind = np.array([0, 0, -0.3 * thick])
    for side in (-spread, spread):
      strut = rod(shape, side, side, -0.08, gap + 0.3 * (1 - gap), 0.016, 4)
      parts.append(paint(strut._replace(vertices=strut.vertices + behind), frame))
  return parts


def hoop(rng, shape: Shape, r, frame, board) -> list[Part]:
  """A bow from side to side over spindles or a round panel."""
  a = np.linspace(0, np.pi, 17)
  power = rng.uniform(0.5, 1.0)
  bow = shape.at(-np.cos(a), -0.06 + 1.06 * np.sin(a) ** power)
  parts = [paint(solids.tube(bow, r), frame)]
  if rng.uniform() < 0.3:
    t = np.linspace(0.05, 0.95, 8)[:, None]
    s = np.linspace(-1, 1, 7) * np.sqrt(np.maximum(1 - t ** (2 / power), 0.01)) * 0.95
    return parts + [paint(solids.sheet(shape.at(s, t), 0.025), board)]
  for s in np.linspace(-1, 1, int(rng.integers(5, 9)) + 2)[1:-1]:
    top = np.sqrt(1 - s**2) ** power
    parts.append(paint(rod(shape, 0.85 * s, s, -0.04, top, 0.011 + 0.2 * r, 6), frame))
  return parts
