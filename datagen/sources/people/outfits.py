"""Outfits: which garments are worn, how long and how wide they are, and what cloth they are of.

Garments are given from the outermost to the innermost. Each is a field over the vertices, in dm,
positive where it is; what lies further in ends a little below the hem of what lies further out, so
that no voxel holds both.
"""

from typing import NamedTuple

import numpy as np

from datagen.sources.people import patterns
from datagen.sources.people.charts import PARTS, Chart
from datagen.sources.people.data import BodyData
from datagen.sources.people.layers import Layer, Paint
from datagen.sources.people.patterns import Pattern

OVERLAP = 0.25  # dm, of a garment with what lies further out
TOPS = {
  'T-shirt': 4.0, 'shirt': 2.0, 'jumper': 2.0, 'vest': 1.5, 'jacket': 2.0, 'dress': 1.5, 'overall': 0.8
}  # fmt: skip
BOTTOMS = {'trousers': 4.0, 'shorts': 2.0, 'leggings': 1.5, 'skirt': 1.5}
SHOES = {'shoes': 5.0, 'boots': 2.0, 'barefoot': 1.0}


class Outfit(NamedTuple):
  """What is worn; lengths of sleeves and legs as in charts: 1 at elbow and knee."""

  top: str
  bottom: str
  shoes: str
  sleeve: float
  leg: float
  skirt: float  # where a skirt ends, as legs' length
  tucked: bool
  loose: float  # 0 tight, 1 wide
  neck: str  # 'round', 'vee' or 'high'
  top_cloth: Pattern
  bottom_cloth: Pattern
  under: np.ndarray  # [3] of the shirt in an open jacket, and of socks
  shoe: np.ndarray  # [3]
  belt: np.ndarray | None  # [3]
  gloves: np.ndarray | None  # [3]
  printed: np.ndarray | None  # [3] the ink of a print on the chest
  seed: int


def wants_skirt(outfit: Outfit) -> bool:
  """Whether it needs a pose in which a skirt hangs."""
  return outfit.top == 'dress' or outfit.bottom == 'skirt'


def sample(rng: np.random.Generator, *, woman: bool, skin: np.ndarray) -> Outfit:
  """Chance's outfit for a skin, whose colour cloth keeps away from."""
  top = _pick(rng, TOPS if woman else {k: v for k, v in TOPS.items() if k != 'dress'})
  bottom = _pick(rng, BOTTOMS if woman else {k: v for k, v in BOTTOMS.items() if k != 'skirt'})
  main = patterns.unlike(rng, skin, distance=0.35)
  low = patterns.unlike(rng, skin, main, distance=0.35)
  top_cloth = patterns.sample(rng, main)
  plain = rng.random() < 0.65 and bottom != 'skirt'
  bottom_cloth = patterns.sample(rng, low, kind='plain' if plain else None)
  sleeves = {
    'T-shirt': (0.35, 0.85),
    'shirt': (0.9, 1.98),
    'jumper': (1.7, 1.98),
    'vest': (-1, -1),
    'jacket': (1.6, 1.98),
    'dress': (-0.9, 1.9),
    'overall': (1.3, 1.98),
  }
  legs = {'trousers': (1.6, 1.95), 'shorts': (0.4, 0.95), 'leggings': (1.5, 1.9), 'skirt': (0, 0)}
  sleeve = rng.uniform(*sleeves[top])
  belted = rng.random() < 0.3 and top not in ('dress', 'overall')
  return Outfit(
    top=top,
    bottom='trousers' if top == 'overall' else bottom,
    shoes=_pick(rng, SHOES),
    sleeve=sleeve if sleeve > 0.2 else -1.0,
    leg=rng.uniform(*legs['trousers' if top == 'overall' else bottom]),
    skirt=rng.uniform(0.55, 1.6),
    tucked=belted or rng.random() < 0.3,
    loose=rng.random() ** 1.5,
    neck=str(rng.choice(['round', 'vee', 'high'], p=[0.55, 0.25, 0.2])),
    top_cloth=top_cloth,
    bottom_cloth=top_cloth if top == 'overall' else bottom_cloth,
    under=patterns.unlike(rng, skin, main, low, distance=0.35),
    shoe=patterns.unlike(rng, skin, low, distance=0.35),
    belt=patterns.unlike(rng, main, low) if belted else None,
    gloves=patterns.unlike(rng, skin, main) if rng.random() < 0.07 else None,
    printed=(
      patterns.unlike(rng, main, distance=0.6)
      if top_cloth.kind in ('plain', 'gradient', 'halves') and rng.random() < 0.7
      else None
    ),
    seed=int(rng.integers(2**31)),
  )  # fmt: skip


def layers(data: BodyData, chart: Chart, outfit: Outfit) -> tuple[list[Layer], np.ndarray]:
  """The garments' surfaces, and a field [V] that is positive, in dm, where skin is covered."""
  unit = chart.height / 16.7  # 1 for the base mesh
  x, y, _ = chart.vertices.T
  arm, leg = chart.arm_weight > 0.5, chart.limb == 2
  tights, skirt = data.groups['helper-tights'], data.groups['helper-skirt']
  neck, hip = chart.at['neck_01'], chart.at['thigh_l'][1]
  waist = 0.3 * chart.at['spine_01'][1] + 0.7 * chart.at['spine_02'][1]
  ones = np.ones_like(x)
  hem = waist if outfit.tucked else hip - 0.1 * unit
  worn: list[tuple[np.ndarray, np.ndarray, np.ndarray, object]] = []  # faces, field, lift, cloth

  def add(faces, field, lift, cloth):
    worn.append((faces, field, lift * unit * ones, cloth))

  is_foot = leg & (chart.leg > 1.5)
  shaft = {'shoes': 1.93, 'boots': 1.45, 'barefoot': 9.0}[outfit.shoes]
  if outfit.shoes == 'boots':
    add(tights, np.where(leg, (chart.leg - shaft) * 4 * unit, -1.0), 0.24, outfit.shoe)
  skirted = wants_skirt(outfit)
  if outfit.belt is not None and not skirted:
    band = np.where(arm, -1.0, 0.3 * unit - np.abs(y - waist))
    add(tights, band, 0.2 + 0.12 * outfit.loose, outfit.belt)
  front = np.clip(np.cos(2 * np.pi * chart.around), 0, 1)
  neckline = neck[1] + (0.06 - 0.5 * front) * unit - y
  if outfit.neck == 'high':
    neckline = neckline + 0.32 * unit
  if outfit.neck == 'vee':
    neckline = neckline - np.where(
      np.abs(chart.around) < 0.25, np.clip(1.0 * unit - 1.6 * np.abs(x), 0, None), 0
    )

  def upper(low, sleeve, collar):
    shoulder = [np.linalg.norm(chart.vertices - chart.at[f'upperarm_{s}'], axis=1) for s in 'lr']
    trunk = np.minimum(y - low, collar)
    if sleeve < 0:
      trunk = np.minimum(trunk, np.minimum(*shoulder) - 0.75 * unit)
      return np.where(arm, -1.0, np.where(leg, np.minimum(trunk, y - low), trunk))
    return np.where(arm, (sleeve - chart.arm) * 2.5 * unit, trunk)

  def lower(high, length):
    trunk = np.where(arm, -1.0, high - y)
    return np.where(leg, np.minimum(trunk, (length - chart.leg) * 4 * unit), trunk)

  loose = outfit.loose
  flare = np.clip(chart.leg - 0.8, 0, 1) * leg
  if skirted:
    top = waist + (0.1 if outfit.top == 'dress' else 0.25) * unit
    cloth = outfit.top_cloth if outfit.top == 'dress' else outfit.bottom_cloth
    field = np.minimum(top - y, (outfit.skirt - chart.leg) * 4 * unit)
    add(skirt, field, 0.05 + 0.5 * loose * np.clip((top - y) / (5 * unit), 0, 1), cloth)
  sleeve_lift = 0.06 + 0.16 * loose
  collar = neckline
  if outfit.top == 'jacket':
    open_ = np.where(
      (np.abs(chart.around) < 0.25) & ~arm, np.abs(x) - (0.28 + 0.1 * loose) * unit, 9.0
    )
    jacket = np.minimum(upper(hip - 0.35 * unit, outfit.sleeve, neckline), open_)
    add(tights, jacket, 0.2 + 0.14 * loose, outfit.top_cloth)
    add(tights, upper(hem, 0.5, neckline), 0.08, outfit.under)
  elif outfit.top == 'overall':
    whole = np.where(leg, lower(99.0, outfit.leg), upper(-99.0, outfit.sleeve, collar))
    add(tights, whole, 0.08 + 0.12 * loose + 0.1 * loose * flare, outfit.top_cloth)
  else:
    low = waist - 0.3 * unit if skirted else hem
    bulk = {'T-shirt': 0.07, 'shirt': 0.09, 'jumper': 0.18, 'vest': 0.06, 'dress': 0.06}[outfit.top]
    tuck = outfit.tucked or skirted
    add(tights, upper(low, outfit.sleeve, collar), bulk + (0 if tuck else 0.05) + sleeve_lift * 0.6,
        outfit.top_cloth)  # fmt: skip
  if not skirted and outfit.top != 'overall':
    wide = {'trousers': 0.35, 'shorts': 0.25, 'leggings': 0.0}[outfit.bottom] * loose
    add(tights, lower(waist + 0.1 * unit, outfit.leg), 0.05 + 0.04 * (outfit.bottom != 'leggings')
        + wide * flare, outfit.bottom_cloth)  # fmt: skip
  if outfit.shoes == 'shoes':
    add(tights, np.where(is_foot, (chart.leg - shaft) * 4 * unit, -1.0), 0.12, outfit.shoe)
  if outfit.gloves is not None:
    field = np.where(arm, (chart.arm - 1.85) * 2.5 * unit, -1.0)
    add(data.groups['body'], field, 0.05, outfit.gloves)

  found, covered = [], np.full(len(x), -1.0)
  for faces, field, lift, cloth in worn:
    shown = np.minimum(field, OVERLAP * unit - covered)
    found += _cut(chart, outfit, faces, shown, lift, cloth, whole=faces is skirt)
    under = field
    if faces is skirt:  # its faces hang free: legs and hips between its ends are hidden
      under = np.where(arm, -1.0, np.minimum(field, top - y))
    covered = np.maximum(covered, under)
  return found, covered


def _cut(chart, outfit, faces, field, lift, cloth, *, whole):
  """A garment's layers, one for trunk, arms and legs each; a `whole` one goes around both legs."""
  if not isinstance(cloth, Pattern):
    return [Layer(faces, field, lift, Paint(cloth))]
  used = np.unique(faces)
  worn = used[field[used] >= 0]
  if not len(worn):
    return []
  trunk = worn[chart.limb[worn] != 1]
  span = chart.along[trunk if len(trunk) else worn]
  cloth = cloth._replace(low=float(span.min()), high=float(span.max()))
  printed = outfit.printed is not None and cloth.seed == outfit.top_cloth.seed
  limbs = chart.limb[faces]
  part_of = np.where((limbs == 1).sum(1) > 1, 1, np.where((limbs == 2).sum(1) > 1, 2, 0))
  if whole:
    part_of[:] = 0
  found = []
  for k, part in enumerate(PARTS):
    mine = faces[part_of == k]
    if not len(mine):
      continue
    if cloth.kind == 'plain' and not (printed and part == 'trunk'):
      found.append(Layer(mine, field, lift, Paint(cloth.colors[0])))
      continue
    picture = patterns.draw(cloth, part=part)
    if printed and part == 'trunk':
      at = chart.at['spine_03'][1] * 0.68 + chart.at['neck_01'][1] * 0.32 - chart.floor
      patterns.add_print(
        np.random.default_rng(outfit.seed), picture, outfit.printed,
        at=at / chart.height, size=0.1, wide=2.1,
      )  # fmt: skip
    uv = np.stack([chart.around + 0.5, chart.along], 1)
    found.append(Layer(mine, field, lift, Paint(cloth.colors[0], picture, uv, wraps=True)))
  return found


def _pick(rng, shares):
  """A key, by its share."""
  share = np.array(list(shares.values()))
  return list(shares)[rng.choice(len(share), p=share / share.sum())]
