"""The look of a car: images of its sides, top, ends, windows and wheels, drawn in metres.

Lamps, plates, windows, arches and doors are painted on the body, not modelled in front of it: a
voxel that held both would have the colour of neither.
"""

from typing import NamedTuple

import numpy as np

from datagen.sources.shapes import materials as mt
from datagen.sources.shapes.parts import Part, facing, paint, texels

SIZE = 256  # texels along a picture's edge
DARK = np.array([0.13, 0.13, 0.14])
CONTRAST = 0.38  # the largest distance between a car's colours

# Marks' own colours, and how far they may be from the paint's.
_MARKS = (
  ([0.2, 0.24, 0.29], 0.4),
  ([0.88, 0.85, 0.62], 0.38),
  ([0.78, 0.08, 0.08], 0.42),
  ([0.86, 0.84, 0.66], 0.3),
  (DARK, 0.3),
  (DARK, 0.45),
)

KINDS = {
  'plain': 0.2,
  'two-tone': 0.15,
  'band': 0.14,
  'chequer': 0.06,
  'panel': 0.08,
  'number': 0.13,
  'flames': 0.06,
  'camouflage': 0.05,
  'fade': 0.05,
  'logo': 0.08,
}


class Marks(NamedTuple):
  """Colours [3] of what is small and painted on a ground, not too far from it."""

  glass: np.ndarray
  lamp: np.ndarray
  tail_lamp: np.ndarray
  plate: np.ndarray
  grille: np.ndarray
  arch: np.ndarray


class Look(NamedTuple):
  """A car's paint and the sizes of what is drawn on it; lengths in metres."""

  kind: str  # one of KINDS
  base: np.ndarray  # [3]
  second: np.ndarray
  accent: np.ndarray
  roof: np.ndarray
  skirt: np.ndarray  # bumpers and sills
  rim: np.ndarray
  level: float  # where the sides' paint changes, of their height
  stripes: tuple[float, float] | None  # along the top: from and to this far from the middle
  badge: mt.Material  # on doors and bonnet
  marks: Marks
  lamp: tuple[float, float]  # width and height
  tail_lamp: tuple[float, float]
  grille: float  # width


def choose(rng, colors: mt.Scheme, width: float) -> Look:
  """Paint for a car of a width in metres."""
  base = colors.main
  if rng.uniform() < 0.12:
    base = np.array([0.9, 0.9, 0.88]) * rng.uniform(0.82, 0.98)
  second, accent = mt.close([base, colors.second, colors.accent], CONTRAST)[1:]
  near = rng.choice([0.0, 0.07])
  stripes = (near, near + rng.uniform(0.16, 0.26)) if rng.uniform() < 0.35 else None
  return Look(
    kind=str(rng.choice(list(KINDS), p=list(KINDS.values()))),
    base=base,
    second=second,
    accent=accent,
    roof=second if rng.uniform() < 0.3 else base,
    skirt=[mt.close([base, DARK], 0.34)[1], mt.shade(base, 0.6), base][rng.integers(3)],
    marks=Marks(*(mt.close([base, color], limit)[1] for color, limit in _MARKS)),
    rim=mt.shade(colors.metal, 1.2) if rng.uniform() < 0.75 else colors.accent,
    level=rng.uniform(0.4, 0.65),
    stripes=stripes,
    badge=mt.emblem(rng, *mt.close([second, accent], CONTRAST)),
    lamp=(rng.uniform(0.17, 0.24) * width, rng.uniform(0.16, 0.26)),
    tail_lamp=(rng.uniform(0.12, 0.22) * width, rng.uniform(0.18, 0.32)),
    grille=rng.uniform(0.3, 0.6) * width,
  )


def wear(rng, hull, form, look: Look, axles, lamps) -> list[Part]:
  """The lower body in its paint.

  Args:
    rng: the generator.
    hull: the body's solid.
    form: its `car.Form`.
    look: its paint.
    axles: (z, y, radius) of each wheel's arch.
    lamps: heights of the head and the tail lamps' middles.
  """
  pattern = _pattern(rng, form, look)
  parts = [paint(facing(hull, (1,), -1), mt.plain(DARK))]
  for sign in (1, -1):
    z, y = texels(hull, 0, sign, SIZE)
    rgb = pattern(z, y, sign)
    rgb[y < form.clearance + 0.14] = look.skirt
    end = 0.5 * form.length
    for at, lamp, (_, high), tone in (
      (end, lamps[0], look.lamp, look.marks.lamp),
      (-end, lamps[1], look.tail_lamp, look.marks.tail_lamp),
    ):
      rgb[(np.abs(z - at) < 0.2) & (np.abs(y - lamp) < 0.5 * high)] = tone
    for at, height, radius in axles:
      rgb[np.hypot(z - at, y - height) < radius] = look.marks.arch
    parts.append(paint(facing(hull, (0,), sign), mt.drawn(rgb)))
    parts.append(paint(facing(hull, (2,), sign), _end(hull, form, look, lamps, sign)))
  x, z = texels(hull, 1, 1, SIZE)
  rgb = pattern(z, np.full(z.shape, form.belt), 1) if look.kind in ('camouflage', 'fade') else None
  rgb = np.broadcast_to(look.base, (*x.shape, 3)).copy() if rgb is None else rgb
  if look.kind == 'number':
    _stick(rgb, look.badge, x, z - 0.36 * form.length, 0.5)
  _striped(rgb, x, look)
  return [*parts, paint(facing(hull, (1,), 1), mt.drawn(rgb))]


def _pattern(rng, form, look: Look):
  """A function of (z, y, side) that paints a side: [..., 3]."""
  floor, height = form.clearance, form.belt - form.clearance
  shift, across = rng.uniform(-0.08, 0.08), rng.uniform(0.12, 0.25)
  wide, tongues = rng.uniform(0.14, 0.26), int(rng.integers(3, 6))
  fine = rng.uniform() < 0.5
  patches = mt.blotches(
    rng, mt.close([look.base, look.second, mt.shade(look.base, 0.6)], mt.PATTERN), period=1.0
  )

  def pattern(z, y, side):
    rgb = np.broadcast_to(look.base, (*z.shape, 3)).copy()
    v, u = (y - floor) / height, z / form.length  # 0 to 1 up; -0.5 rear to 0.5 nose
    if look.kind == 'two-tone':
      rgb[v < look.level] = look.second
    elif look.kind == 'band':
      rgb[np.abs(v - look.level) < 0.5 * wide] = look.second
      rgb[(np.abs(v - look.level + 0.5 * wide + 0.08) < 0.06) & fine] = look.accent
    elif look.kind == 'chequer':
      band = np.abs(v - 0.55) < 0.26
      odd = (np.floor(z / 0.26) + np.floor((v - 0.29) / 0.26)) % 2 == 1
      light, dark = mt.close([[0.6, 0.6, 0.58], [0.2, 0.2, 0.22]], 0.45)
      rgb[band] = np.where(odd[band][:, None], light, dark)
    elif look.kind == 'panel':
      rgb[np.abs(u + shift) < across] = look.second
    elif look.kind == 'flames':
      wave = np.abs(np.sin(v * np.pi * tongues * 0.5))
      rgb[u > 0.28 - 0.3 * wave] = look.accent
    elif look.kind == 'camouflage':
      rgb = mt.lookup(patches, z / 1.6, y / 1.6)
    elif look.kind == 'fade':
      t = np.clip(u + 0.5, 0, 1)[..., None]
      rgb = look.second + t * (look.base - look.second)
    if look.kind in ('number', 'logo'):
      _stick(rgb, look.badge, -side * z, y - floor - 0.55 * height, 0.85 * height)
    return rgb

  return pattern


def _stick(rgb, badge: mt.Material, x, y, size) -> None:
  """Pastes a round sticker of a diameter around x = y = 0, in place."""
  inside = np.hypot(x, y) < 0.5 * size
  rgb[inside] = mt.lookup(badge, x / size + 0.5, y / size + 0.5)[inside]


def _striped(rgb, x, look: Look) -> None:
  """Lays racing stripes over a picture, in place."""
  if look.stripes is not None:
    near, far = look.stripes
    rgb[(np.abs(x) > near) & (np.abs(x) < far)] = look.accent


def _end(hull, form, look: Look, lamps, sign) -> mt.Material:
  """The nose with lamps, grille and number plate (sign 1), or the tail."""
  x, y = texels(hull, 2, sign, SIZE)
  x = np.abs(x)
  rgb = np.broadcast_to(look.base, (*x.shape, 3)).copy()
  if sign > 0:
    _striped(rgb, x, look)
  rgb[y < form.clearance + 0.16] = look.skirt
  lamp = lamps[0 if sign > 0 else 1]
  wide, high = look.lamp if sign > 0 else look.tail_lamp
  tone = look.marks.lamp if sign > 0 else look.marks.tail_lamp
  edge = 0.41 * form.width
  if sign > 0:
    rgb[(x < 0.5 * look.grille) & (np.abs(y - lamp) < 0.4 * high)] = look.marks.grille
  rgb[(x > edge - wide) & (np.abs(y - lamp) < 0.5 * high)] = tone
  plate = form.clearance + (0.15 if sign > 0 else 0.24)
  rgb[(x < 0.3) & (np.abs(y - plate) < 0.085)] = look.marks.plate
  return mt.drawn(rgb)


def glaze(cabin, look: Look, level, posts, *, closed_behind: float | None) -> list[Part]:
  """The cabin's windows and roof.

  Args:
    cabin: its solid.
    look: its paint.
    level: a function of the height: (rear z, front z, half width, share of the way to the roof).
    posts: fractions, from rear to front, where the sides have posts.
    closed_behind: such a fraction, behind which the sides have no windows; None for none.
  """
  parts = []
  for sign in (1, -1):
    z, y = texels(cabin, 0, sign, SIZE)
    rear, front, _, t = level(y)
    s = (z - rear) / (front - rear)
    metres = front - rear
    window = (t > 0.06) & (t < 0.84) & (s * metres > 0.13) & ((1 - s) * metres > 0.13)
    for post in posts:
      window &= np.abs(s - post) * metres > 0.075
    if closed_behind is not None:
      window &= s > closed_behind
    rgb = np.where(window[..., None], look.marks.glass, look.base)
    rgb[t > 0.84] = look.roof
    parts.append(paint(facing(cabin, (0,), sign), mt.drawn(rgb)))
    x, y = texels(cabin, 2, sign, SIZE)
    _, _, half, t = level(y)
    window = (t > 0.06) & (t < 0.86) & (np.abs(x) < half - 0.14)
    rgb = np.where(window[..., None], look.marks.glass, look.base)
    rgb[t > 0.86] = look.roof
    parts.append(paint(facing(cabin, (2,), sign), mt.drawn(rgb)))
  x, z = texels(cabin, 1, 1, SIZE)
  rear, front, half, _ = level(np.full(1, np.inf))
  low_rear, low_front, low_half, _ = level(np.full(1, -np.inf))
  beyond = np.maximum((z - front) / (low_front - front), (rear - z) / (rear - low_rear))
  window = (beyond > 0.12) & (beyond < 0.88)
  window &= np.abs(x) < half + beyond * (low_half - half) - 0.14
  rgb = np.broadcast_to(look.roof, (*x.shape, 3)).copy()
  _striped(rgb, x, look)
  rgb[beyond > 0.88] = look.base
  rgb[window] = look.marks.glass
  parts.append(paint(facing(cabin, (1,), 1), mt.drawn(rgb)))
  return [*parts, paint(facing(cabin, (1,), -1), mt.plain(DARK))]


def wheel_face(rng, look: Look) -> mt.Material:
  """A wheel's face: tyre, rim and openings between spokes."""
  t = 2 * (np.arange(128) + 0.5) / 128 - 1
  x, y = np.meshgrid(t, -t)
  r, a = np.hypot(x, y), np.arctan2(y, x)
  spokes = int(rng.integers(3, 7))
  opening = (np.cos(a * spokes) > rng.uniform(0.0, 0.6)) & (r > 0.2) & (r < 0.5)
  mask = np.where(r > rng.uniform(0.6, 0.72), 0, np.where(opening, 1, 2))
  rim = mt.close([DARK, look.rim], 0.45)[1]
  return mt.pictured(mask, [DARK, mt.shade(rim, 0.65), rim])


def crate(rng, colors: mt.Scheme) -> mt.Material:
  """A load's skin: lettered, striped or plain."""
  second, accent, main = mt.close([colors.second, colors.accent, colors.main], CONTRAST)
  kind = int(rng.integers(3))
  if kind == 0:
    return mt.emblem(rng, second, accent)
  if kind == 1:
    return mt.stripes(rng, (second, accent, main), period=rng.uniform(0.8, 1.6))
  return mt.plain(second)
