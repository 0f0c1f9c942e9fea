"""What a guitar wears: finishes of the body, fingerboards, resonator cones."""

from typing import NamedTuple

import numpy as np

from datagen.sources.shapes import materials as mt


class Look(NamedTuple):
  """A guitar's surfaces."""

  front: mt.Material
  side: mt.Material
  trim: np.ndarray  # [3] binding, rosette
  guard: np.ndarray  # [3] scratch plate
  neck: np.ndarray  # [3]


def _grid():
  t = (np.arange(128) + 0.5) / 128
  return np.meshgrid(t, t[::-1])


def choose(rng, colors: mt.Scheme, *, acoustic: bool) -> Look:
  """Bare wood, a burst, lacquer or a pattern: wood more on acoustics, patterns on electrics."""
  base, second, accent = colors.main, colors.second, colors.accent
  top = mt.hsv(rng.uniform(0.02, 0.13), rng.uniform(0.35, 0.8), rng.uniform(0.35, 0.88))
  kind = rng.uniform() + (0.0 if acoustic else 0.3)
  side = mt.plain(base)
  if kind < 0.34:
    front = mt.wood(rng, top, period=0.3)
    side = mt.plain(mt.shade(colors.wood if rng.uniform() < 0.7 else base, 0.8))
  elif kind < 0.62:
    edge = mt.shade(base if rng.uniform() < 0.5 else colors.wood, 0.4)
    front = burst(rng, edge, top if rng.uniform() < 0.5 else accent)
    side = mt.plain(edge)
  elif kind < 0.86:
    front = mt.plain(base)
  else:
    front = decorated(rng, base, second, accent)
  trim = np.array([[0.88, 0.84, 0.74], [0.14, 0.12, 0.12], accent][rng.integers(3)], float)
  guard = np.array(
    [[0.85, 0.84, 0.8], [0.14, 0.13, 0.13], [0.4, 0.16, 0.1], second][rng.integers(4)]
  )
  return Look(front, side, trim, guard, mt.shade(colors.wood, rng.uniform(0.7, 1.2)))


def burst(rng, edge, middle) -> mt.Material:
  """From a light middle to a dark rim, as sunbursts are."""
  u, v = _grid()
  r = np.hypot((u - 0.5) * 2, (v - 0.46) * 2)
  start = rng.uniform(0.2, 0.5)
  return mt.pictured(np.clip((r - start) / (0.95 - start), 0, 1), [middle, edge])


def decorated(rng, base, second, accent) -> mt.Material:
  """Halves, bands, rays, dots, a chequer or an emblem."""
  u, v = _grid()
  kind = int(rng.integers(6))
  if kind == 0:
    mask = (u - 0.5) * np.cos(a := rng.uniform(0, np.pi)) + (v - 0.5) * np.sin(a) > 0
    return mt.pictured(mask.astype(int), [base, second])
  if kind == 1:
    return mt.stripes(rng, (base, second, accent), period=rng.uniform(0.07, 0.16))
  if kind == 2:
    rays = np.sin(np.arctan2(v - 0.45, u - 0.5) * rng.integers(4, 9)) > 0
    return mt.pictured(rays.astype(int), [base, second])
  if kind == 3:
    return mt.dots(rng, (base, second, accent), period=rng.uniform(0.1, 0.18))
  if kind == 4:
    return mt.checks(rng, (base, second), period=rng.uniform(0.08, 0.15))
  return mt.emblem(rng, base, accent)


def cone(colors: mt.Scheme) -> mt.Material:
  """A resonator's pierced metal disc."""
  u, v = _grid()
  r, a = np.hypot(u - 0.5, v - 0.5) * 2, np.arctan2(v - 0.5, u - 0.5)
  holes = (np.sin(a * 8) > 0.2) & (r > 0.35) & (r < 0.75)
  return mt.pictured(holes.astype(int), [mt.shade(colors.metal, 1.3), mt.shade(colors.metal, 0.4)])


def fingerboard(rng, colors: mt.Scheme) -> mt.Material:
  """Dark or pale wood with frets and position marks."""
  u, v = _grid()
  wood = mt.shade(colors.wood, rng.choice([0.35, 0.5, 1.1]))
  frets = (1 - 2.0 ** (-np.arange(1, 20) / 12)) / (1 - 2.0 ** (-20 / 12))
  mask = (np.abs(v[..., None] - 1 + frets) < 0.006).any(-1).astype(int)
  marks = 0.5 * (frets[[1, 3, 5, 7, 10]] + frets[[2, 4, 6, 8, 11]])
  near = (np.abs(v[..., None] - 1 + marks) < 0.018).any(-1) & (np.abs(u - 0.5) < 0.2)
  mask[near] = 2
  return mt.pictured(mask, [wood, [0.68, 0.66, 0.6], [0.86, 0.84, 0.78]])
