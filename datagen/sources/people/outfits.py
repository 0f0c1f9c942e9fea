"""Outfits: which garments are worn, their lengths and widths, and their cloth."""

from typing import NamedTuple

import numpy as np

from datagen.sources.people import patterns
from datagen.sources.people.patterns import Pattern

# How often each is worn, in comparison.
TOPS = {
  'T-shirt': 4.0,
  'shirt': 2.0,
  'jumper': 2.0,
  'vest': 1.5,
  'jacket': 2.0,
  'dress': 1.5,
  'overall': 0.8,
}
BOTTOMS = {'trousers': 4.0, 'shorts': 2.0, 'leggings': 1.5, 'skirt': 1.5}
SHOES = {'shoes': 5.0, 'boots': 2.0, 'barefoot': 1.0}
NECKS = {'round': 0.55, 'vee': 0.25, 'high': 0.2}

# Where sleeves and legs end, as in charts: 1 at elbow and knee, 2 at wrist and ankle.
SLEEVES = {
  'T-shirt': (0.35, 0.85),
  'shirt': (0.9, 1.98),
  'jumper': (1.7, 1.98),
  'vest': (-1.0, -1.0),
  'jacket': (1.6, 1.98),
  'dress': (-0.9, 1.9),
  'overall': (1.3, 1.98),
}
LEGS = {'trousers': (1.6, 1.95), 'shorts': (0.4, 0.95), 'leggings': (1.5, 1.9), 'skirt': (0, 0)}
SHORTEST_SLEEVE = 0.2  # shorter ones are none


class Outfit(NamedTuple):
  """An outfit; lengths of sleeves, legs, skirt and socks as in charts."""

  top: str
  bottom: str
  shoes: str
  sleeve: float  # -1 where there is none
  leg: float
  skirt: float
  socks: float | None  # how high up the legs
  tucked: bool
  loose: float  # 0 tight, 1 wide
  neck: str
  top_cloth: Pattern
  bottom_cloth: Pattern
  under: np.ndarray  # [3] of the shirt in an open jacket, and of socks
  shoe: np.ndarray  # [3]
  belt: np.ndarray | None  # [3]
  gloves: np.ndarray | None  # [3]
  printed: np.ndarray | None  # [3] the ink of a print on the chest


def wants_skirt(outfit: Outfit) -> bool:
  """Whether it needs an upright pose, in which a skirt hangs."""
  return outfit.top == 'dress' or outfit.bottom == 'skirt'


def sample(rng: np.random.Generator, *, woman: bool, skin: np.ndarray) -> Outfit:
  """A random outfit for a skin; cloth avoids the skin's colour."""
  top = _pick(rng, TOPS if woman else {k: v for k, v in TOPS.items() if k != 'dress'})
  bottom = _pick(rng, BOTTOMS if woman else {k: v for k, v in BOTTOMS.items() if k != 'skirt'})
  bottom = 'trousers' if top == 'overall' else bottom
  main = patterns.unlike(rng, skin, distance=0.35)
  low = patterns.unlike(rng, skin, main, distance=0.35)
  top_cloth = patterns.sample(rng, main)
  plain = rng.random() < 0.65 and bottom != 'skirt'
  bottom_cloth = patterns.sample(rng, low, kind='plain' if plain else None)
  sleeve = rng.uniform(*SLEEVES[top])
  shoes = _pick(rng, SHOES)
  socks = rng.choice([rng.uniform(1.72, 1.88), rng.uniform(1.1, 1.4)], p=[0.7, 0.3])
  belted = rng.random() < 0.3 and top not in ('dress', 'overall')
  printed = top_cloth.kind in ('plain', 'gradient') and top != 'jacket' and rng.random() < 0.7
  return Outfit(
    top=top,
    bottom=bottom,
    shoes=shoes,
    sleeve=sleeve if sleeve > SHORTEST_SLEEVE else -1.0,
    leg=rng.uniform(*LEGS[bottom]),
    skirt=rng.uniform(0.55, 1.6),
    socks=float(socks) if shoes == 'shoes' and rng.random() < 0.6 else None,
    tucked=belted or rng.random() < 0.3,
    loose=rng.random() ** 1.5,
    neck=_pick(rng, NECKS),
    top_cloth=top_cloth,
    bottom_cloth=bottom_cloth,
    under=patterns.unlike(rng, skin, main, low, distance=0.35),
    shoe=patterns.unlike(rng, skin, low, distance=0.35),
    belt=patterns.unlike(rng, main, low) if belted else None,
    gloves=patterns.unlike(rng, skin, main) if rng.random() < 0.07 else None,
    printed=patterns.unlike(rng, *top_cloth.colors[:2], distance=0.5) if printed else None,
  )


def _pick(rng, shares):
  """A random key, weighted by its share."""
  share = np.array(list(shares.values()))
  return list(shares)[rng.choice(len(share), p=share / share.sum())]
