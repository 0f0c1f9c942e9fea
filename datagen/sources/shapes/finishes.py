"""The look of a guitar: images of its front and fingerboard, drawn in metres.

Sound holes, rosettes, scratch plates, pickups and bridges are painted on the front, not modelled in
front of it: a voxel that held both would have the colour of neither.
"""

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from datagen.sources.shapes import materials as mt
from datagen.sources.shapes.parts import texels

SIZE = 192  # texels along a picture's edge
DARK = np.array([0.13, 0.11, 0.1])
IVORY, STEEL = np.array([0.86, 0.83, 0.75]), np.array([0.68, 0.66, 0.6])
_GUARDS = ([0.85, 0.84, 0.8], [0.14, 0.13, 0.13], [0.4, 0.16, 0.1])
_PICKUPS = (DARK, IVORY, STEEL)


class Look(NamedTuple):
  """A guitar's colours."""

  kind: str  # 'wood', 'burst', 'lacquer' or 'decorated'
  base: np.ndarray  # [3]
  edge: np.ndarray  # of a burst
  second: np.ndarray
  accent: np.ndarray
  side: np.ndarray  # and back
  trim: np.ndarray  # binding, rosette
  guard: np.ndarray  # scratch plate
  neck: np.ndarray
  board: np.ndarray


def choose(rng, colors: mt.Scheme, *, acoustic: bool) -> Look:
  """Bare wood, a burst, lacquer or a pattern: wood more on acoustics, patterns on electrics."""
  top = mt.hsv(rng.uniform(0.03, 0.13), rng.uniform(0.4, 0.75), rng.uniform(0.45, 0.85))
  odds = [0.55, 0.2, 0.15, 0.1] if acoustic else [0.2, 0.28, 0.3, 0.22]
  kind = str(rng.choice(['wood', 'burst', 'lacquer', 'decorated'], p=odds))
  base = {'wood': top, 'burst': top if rng.uniform() < 0.6 else colors.accent}.get(
    kind, colors.main
  )
  edge = mt.shade(colors.main if rng.uniform() < 0.5 else colors.wood, 0.45)
  side = {'wood': mt.shade(top, rng.uniform(0.65, 1.0)), 'burst': edge}.get(kind, base)
  second, accent = mt.close([base, colors.second, colors.accent], 0.4)[1:]
  trim = [IVORY, DARK, accent][rng.integers(3)]
  guard = [*_GUARDS, second][rng.integers(4)]
  board = mt.shade(colors.wood, rng.choice([0.4, 0.55, 1.0]))
  neck = mt.close([board, mt.shade(colors.wood, rng.uniform(0.8, 1.2))], 0.25)[1]
  return Look(kind, base, edge, second, accent, side, trim, np.array(guard), neck, board)


def front(rng, solid, outline, look: Look, *, acoustic: bool, hollow: bool) -> mt.Material:
  """The picture of a body's front.

  Args:
    rng: the generator.
    solid: the body.
    outline: [M, 2] of the body.
    look: its colours.
    acoustic: a sound hole and a bridge, or else pickups and what belongs to them.
    hollow: two f-shaped holes.
  """
  x, y = texels(solid, 2, 1, SIZE)
  inward = cKDTree(outline).query(np.stack([x, y], -1))[0]  # metres from the rim
  width, length = np.ptp(outline, axis=0)
  rgb = _ground(rng, x, y, inward, width, length, look)
  if acoustic or rng.uniform() < 0.4:
    rgb[inward < 0.018] = mt.close([look.base, look.trim], 0.25)[1]
  if hollow:
    bend = 0.012 * np.sin((y - 0.45 * length) / length * 14)
    slot = np.abs(np.abs(x) - 0.3 * width - bend) < 0.012
    rgb[slot & (np.abs(y - 0.45 * length) < 0.15 * length)] = DARK
  draw = _acoustic if acoustic else _electric
  draw(rng, rgb, x, y, inward, width, length, look)
  return mt.drawn(rgb)


def _ground(rng, x, y, inward, width, length, look: Look) -> np.ndarray:
  """Wood in two halves, a burst, lacquer, or a pattern: [H, W, 3]."""
  grain = mt.lookup(mt.wood(rng, look.base), np.abs(x) / 0.3, y / 0.6)
  if look.kind == 'wood':
    return grain
  if look.kind == 'burst':
    deep = inward.max() * rng.uniform(0.5, 0.8)
    t = np.clip(1 - inward / deep, 0, 1)[..., None] ** 1.5
    return grain + t * (look.edge - grain)
  rgb = np.broadcast_to(look.base, (*x.shape, 3)).copy()
  if look.kind == 'lacquer':
    return rgb
  kind, u, v = int(rng.integers(6)), x / width, y / length
  if kind == 0:
    a = rng.uniform(0, np.pi)
    rgb[u * np.cos(a) + (v - 0.45) * np.sin(a) > 0] = look.second
  elif kind == 1:
    rgb[np.abs(u - rng.uniform(-0.2, 0.2)) < rng.uniform(0.08, 0.16)] = look.second
  elif kind == 2:
    rgb[np.sin(np.arctan2(v - 0.45, u) * rng.integers(4, 7)) > 0] = look.second
  elif kind == 3:
    tones = mt.close([look.base, look.second, look.accent], mt.PATTERN)
    rgb = mt.lookup(mt.blotches(rng, tones, period=1.0), x / 0.3, y / 0.3)
  elif kind == 4:
    tones = mt.close([look.base, look.second], mt.PATTERN)
    rgb[:] = mt.lookup(mt.stripes(rng, [*tones, tones[1]], period=1.0), x / 0.14, y / 0.14)
  else:
    rgb[np.abs(inward - 0.045) < 0.02] = look.accent
  return rgb


def _acoustic(rng, rgb, x, y, inward, width, length, look: Look) -> None:
  """A hole with its rosette, or a metal cone; a bridge; maybe a scratch plate. In place."""
  hole, radius = 0.66 * length, 0.145 * width * rng.uniform(0.9, 1.2)
  if rng.uniform() < 0.5:
    side = np.hypot((x - 0.24 * width) / 0.05, (y - 0.5 * length) / (0.16 * length)) < 1
    rgb[side & (inward > 0.02)] = mt.close([look.base, look.guard], 0.38)[1]
  if rng.uniform() < 0.12:
    r, a = np.hypot(x, y - 0.4 * length), np.arctan2(y - 0.4 * length, x)
    rgb[r < 0.34 * width] = [0.62, 0.62, 0.6]
    rgb[(np.sin(a * 6) > 0.2) & (r > 0.12 * width) & (r < 0.26 * width)] = [0.48, 0.48, 0.48]
    return
  r = np.hypot(x, y - hole)
  rgb[r < radius * rng.uniform(1.25, 1.5)] = mt.close([look.base, look.trim], 0.3)[1]
  rgb[r < radius] = DARK
  wide = width * rng.uniform(0.18, 0.26)
  rgb[(np.abs(x) < wide) & (np.abs(y - 0.27 * length) < 0.02)] = mt.close(
    [look.base, mt.shade(look.board, 0.7)], 0.38
  )[1]


def _electric(rng, rgb, x, y, inward, width, length, look: Look) -> None:
  """A scratch plate, pickups, a bridge and knobs, in place."""
  if rng.uniform() < 0.6:
    tilt = rng.uniform(-0.15, 0.5)
    plate = (x > tilt * (y - 0.5 * length) - rng.uniform(0.02, 0.2) * width) & (inward > 0.03)
    plate &= (y > rng.uniform(0.12, 0.3) * length) & (y < 0.9 * length)
    rgb[plate] = mt.close([look.base, look.guard], 0.38)[1]
  cover = mt.close([look.base, _PICKUPS[rng.integers(3)]], 0.42)[1]
  high = rng.uniform(0.015, 0.022)
  for at in np.linspace(0.4, 0.76, int(rng.integers(1, 4)) + 1)[1:]:
    rgb[(np.abs(x) < 0.046) & (np.abs(y - at * length) < high)] = cover
  rgb[(np.abs(x) < 0.05) & (np.abs(y - 0.3 * length) < 0.018)] = mt.close([look.base, STEEL], 0.36)[
    1
  ]
  knob = mt.close([look.base, IVORY if rng.uniform() < 0.5 else look.accent], 0.36)[1]
  for k in range(int(rng.integers(2, 5))):
    rgb[np.hypot(x - 0.3 * width, y - (0.16 + 0.13 * k) * length) < 0.019] = knob


def fingerboard(rng, solid, nut, look: Look) -> mt.Material:
  """Dark or pale wood with frets and blocks between some of them, up to the nut at y."""
  x, y = texels(solid, 2, 1, SIZE)
  scale = 1.7 * (nut - solid.vertices[:, 1].min())  # of the strings
  frets = nut - scale * (1 - 2.0 ** (-np.arange(19) / 12))
  fret = mt.close([look.board, STEEL], 0.18)[1]
  block = mt.close([look.board, IVORY], 0.32)[1]
  rgb = np.broadcast_to(look.board, (*x.shape, 3)).copy()
  rgb[(np.abs(y[..., None] - frets[1:15]) < 0.004).any(-1)] = fret
  marks = 0.5 * (frets[[2, 4, 6, 8, 11, 14]] + frets[[3, 5, 7, 9, 12, 15]])
  wide = rng.uniform(0.012, 0.02)
  rgb[(np.abs(y[..., None] - marks) < 0.013).any(-1) & (np.abs(x) < wide)] = block
  rgb[y > nut - 0.02] = block
  return mt.drawn(rgb)
