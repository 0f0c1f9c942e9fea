"""Colours and images of cloth: stripes, checks, dots, prints and the like.

An image covers one turn about the trunk or a limb (u, the front in its middle) and the person's
height (v, from the floor up). Its finest details are about two of 64 voxels of the height.
"""

from typing import NamedTuple

import matplotlib.colors
import numpy as np
import PIL.Image
import PIL.ImageDraw

SIZE = 256  # pixels of a picture's sides
KINDS = {  # how often each is taken, in comparison
  'plain': 3.0,
  'hoops': 3.0,
  'pinstripes': 2.0,
  'checks': 2.0,
  'plaid': 1.5,
  'dots': 1.5,
  'gradient': 1.5,
  'halves': 1.0,
  'band': 1.5,
  'diagonal': 1.0,
  'patches': 1.0,
  'diamonds': 1.0,
}
NEUTRAL = np.array(
  [
    [0.08, 0.08, 0.1],
    [0.95, 0.95, 0.93],
    [0.5, 0.5, 0.53],
    [0.85, 0.8, 0.68],
    [0.2, 0.28, 0.45],
    [0.36, 0.26, 0.18],
  ]
)
PRINTS = ('disc', 'star', 'heart', 'number', 'square', 'ring', 'arrow')
# The bars of the digits 0 to 9 on a display of seven, and the box (x0, y0, x1, y1) of each bar.
SEGMENTS = ('abcdef', 'bc', 'abged', 'abgcd', 'fgbc', 'afgcd', 'afgecd', 'abc', 'abcdefg', 'abcdfg')
BARS = {
  'a': (-0.7, 0.65, 0.7, 1),
  'b': (0.25, 0, 0.7, 1),
  'c': (0.25, -1, 0.7, 0),
  'd': (-0.7, -1, 0.7, -0.65),
  'e': (-0.7, -1, -0.25, 0),
  'f': (-0.7, 0, -0.25, 1),
  'g': (-0.7, -0.18, 0.7, 0.18),
}


class Pattern(NamedTuple):
  """The look of a cloth."""

  kind: str  # a key of KINDS
  colors: np.ndarray  # [3, 3] sRGB in [0, 1]
  period: float  # of what repeats upwards, in heights of the person
  turns: int  # of what repeats around the trunk: how often
  phase: float
  seed: int
  low: float = 0.0  # v where the garment begins and ends; bands and gradients lie between
  high: float = 1.0


def color(rng: np.random.Generator) -> np.ndarray:
  """A random colour [3] of a cloth: mostly strong, sometimes black, white, grey or denim."""
  if rng.random() < 0.22:
    return NEUTRAL[rng.integers(len(NEUTRAL))]
  return matplotlib.colors.hsv_to_rgb([rng.random(), rng.uniform(0.6, 1), rng.uniform(0.45, 0.98)])


def unlike(rng: np.random.Generator, *others: np.ndarray, distance: float = 0.45) -> np.ndarray:
  """A colour [3] far from others; if none of some candidates is far enough, the farthest."""
  drawn = [color(rng) for _ in range(12)]
  apart = [min((np.linalg.norm(c - o) for o in others), default=1.0) for c in drawn]
  far = [c for c, d in zip(drawn, apart, strict=True) if d > distance]
  return far[0] if far else drawn[int(np.argmax(apart))]


def sample(rng: np.random.Generator, main: np.ndarray, *, kind: str | None = None) -> Pattern:
  """A random pattern with a main colour, of a `kind` if given."""
  if kind is None:
    share = np.array(list(KINDS.values()))
    kind = list(KINDS)[rng.choice(len(KINDS), p=share / share.sum())]
  second = unlike(rng, main)
  colors = np.stack([main, second, unlike(rng, main, second)])
  period, turns = rng.uniform(0.11, 0.2), int(rng.integers(2, 5))
  return Pattern(kind, colors, period, turns, rng.random(), int(rng.integers(2**31)))


def draw(pattern: Pattern, *, part: str) -> np.ndarray:
  """The image [SIZE, SIZE, 4] uint8 of a cloth, for 'trunk', 'arm' or 'leg'.

  Limbs are thinner, so patterns repeat less often around them.
  """
  center = (np.arange(SIZE) + 0.5) / SIZE
  u, v = np.meshgrid(center, 1 - center)
  t = np.clip((v - pattern.low) / max(pattern.high - pattern.low, 0.05), 0, 1)
  if pattern.kind == 'gradient':
    rgb = pattern.colors[0] + (pattern.colors[1] - pattern.colors[0]) * t[..., None]
  else:
    rgb = pattern.colors[_color_index(pattern, part, u, v, t)]
  image = np.full((SIZE, SIZE, 4), 255, np.uint8)
  image[..., :3] = np.round(rgb * 255)
  return image


def _color_index(pattern, part, u, v, t):
  """The index of the pattern's colour at (u, v); t runs from the garment's hem to its top."""
  turns = max(1, round(pattern.turns * {'trunk': 1.0, 'arm': 0.4, 'leg': 0.6}[part]))
  row = v / pattern.period + pattern.phase
  column = u * turns + 0.25  # something is in the middle of the chest, and no edge
  odd_row, odd_column = np.floor(2 * row) % 2 == 1, np.floor(2 * column) % 2 == 1
  match pattern.kind:
    case 'hoops':
      index = odd_row
    case 'pinstripes':
      index = odd_column
    case 'checks':
      index = odd_row ^ odd_column
    case 'plaid':
      index = odd_row.astype(int) + odd_column
    case 'dots':
      shifted = column + 0.5 * (np.floor(row) % 2)
      index = (shifted % 1 - 0.5) ** 2 + (row % 1 - 0.5) ** 2 < 0.33**2
    case 'diamonds':
      index = np.abs(column % 1 - 0.5) + np.abs(0.6 * row % 1 - 0.5) < 0.36
    case 'diagonal':
      index = np.floor(2 * (column + row)) % 2
    case 'halves':
      index = (u > 0.5) & (part != 'arm')
    case 'band':
      index = (t > 0.45) & (t < 0.7) & (part != 'arm')
    case 'patches':
      index = _patches(pattern, u, v, turns)
    case _:
      index = np.zeros_like(u)
  return index.astype(int)


def _patches(pattern, u, v, turns):
  """Patches of three colours, seamless around: the signs of two sums of waves."""
  rng = np.random.default_rng(pattern.seed)
  waves = np.zeros((2, *u.shape))
  for wave in waves:
    for _ in range(6):
      k, f = rng.integers(0, turns + 1), rng.uniform(2, 8)
      wave += np.sin(2 * np.pi * (k * u + f * v + rng.random()))
  return np.where(waves[0] > 0.8, 1, np.where(waves[1] > 0.8, 2, 0))


def add_print(
  rng: np.random.Generator,
  image: np.ndarray,
  ink: np.ndarray,
  *,
  at: float,
  size: float,
  wide: float,
) -> None:
  """Adds a print to the chest of a trunk's image.

  Args:
    rng: random generator.
    image: [SIZE, SIZE, 4], changed in place.
    ink: [3] its colour.
    at: v of its middle.
    size: its height, in heights of the person.
    wide: number of turns that are as long as the person's height.
  """
  kind = PRINTS[rng.integers(len(PRINTS))]
  canvas = PIL.Image.fromarray(image)
  pen = PIL.ImageDraw.Draw(canvas)
  half = np.array([0.5 * size * wide * SIZE, 0.5 * size * SIZE])
  middle = np.array([0.5 * SIZE, (1 - at) * SIZE])
  fill = (*np.rint(255 * ink).astype(int).tolist(), 255)

  def shape(points):
    pen.polygon([tuple(middle + half * (np.array(p) * [1, -1])) for p in points], fill=fill)

  box = [*(middle - half), *(middle + half)]
  if kind == 'disc':
    pen.ellipse(box, fill=fill)
  elif kind == 'ring':
    pen.ellipse(box, outline=fill, width=int(0.22 * half.min()) + 2)
  elif kind == 'square':
    pen.rectangle(box, fill=fill)
  elif kind == 'star':
    angle = np.pi / 2 + np.arange(10) * np.pi / 5
    radius = np.where(np.arange(10) % 2, 0.5, 1.15)
    shape(np.stack([radius * np.cos(angle), radius * np.sin(angle)], 1))
  elif kind == 'heart':
    t = np.linspace(0, 2 * np.pi, 60)
    y = 13 * np.cos(t) - 5 * np.cos(2 * t) - 2 * np.cos(3 * t) - np.cos(4 * t)
    shape(np.stack([np.sin(t) ** 3, y / 16], 1))
  elif kind == 'arrow':
    shape([(0, 1), (1, 0), (0.4, 0), (0.4, -1), (-0.4, -1), (-0.4, 0), (-1, 0)])
  else:
    for segment in SEGMENTS[rng.integers(10)]:
      x0, y0, x1, y1 = BARS[segment]
      shape([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])
  image[:] = np.array(canvas)
