"""Cars: sedans, hatchbacks, estates, vans, pickups, sports cars, buses, lorries. The nose is at +z.

The ground is y = 0 and lengths are metres. A car is a lower body lofted along z, a glass cabin
lofted upwards from its belt, wheels, and trim. `livery` holds what is painted on.
"""

from typing import NamedTuple

import numpy as np

from datagen.sources.shapes import extras, livery, solids
from datagen.sources.shapes import materials as mt
from datagen.sources.shapes.parts import Part, facing, mirror, paint


class Form(NamedTuple):
  """Proportions; positions along z are fractions of the length, -0.5 rear to 0.5 nose."""

  length: float
  width: float
  height: float
  clearance: float
  belt: float  # height of the windows' lower edge
  bonnet: float  # height over the front axle
  nose: float  # height at the very front
  boot: float  # height at the very rear
  glass: tuple[float, float]  # the cabin's rear and front at the belt
  roof: tuple[float, float]  # and at the roof
  wheel: float  # radius


FORMS = {
  'sedan': Form(4.5, 1.78, 1.42, 0.2, 0.92, 0.86, 0.66, 0.88, (-0.36, 0.23), (-0.2, 0.06), 0.32),
  'hatchback': Form(3.8, 1.7, 1.48, 0.2, 0.93, 0.88, 0.68, 0.85, (-0.49, 0.27), (-0.4, 0.1), 0.31),
  'estate': Form(4.6, 1.78, 1.48, 0.2, 0.93, 0.87, 0.68, 0.85, (-0.49, 0.22), (-0.44, 0.06), 0.32),
  'offroad': Form(4.4, 1.88, 1.82, 0.34, 1.12, 1.08, 0.92, 1.0, (-0.49, 0.2), (-0.46, 0.1), 0.4),
  'van': Form(4.9, 1.9, 2.1, 0.26, 1.15, 1.1, 0.8, 1.0, (-0.495, 0.42), (-0.485, 0.28), 0.34),
  'pickup': Form(5.2, 1.9, 1.75, 0.34, 1.05, 1.02, 0.86, 1.0, (-0.1, 0.2), (-0.07, 0.08), 0.39),
  'sports': Form(4.4, 1.86, 1.22, 0.14, 0.82, 0.74, 0.5, 0.82, (-0.42, 0.22), (-0.16, 0.02), 0.33),
  'open': Form(4.1, 1.76, 1.3, 0.17, 0.86, 0.82, 0.62, 0.84, (-0.16, 0.16), (-0.1, 0.05), 0.32),
  'bus': Form(7.5, 2.3, 2.7, 0.3, 1.25, 1.2, 1.05, 1.2, (-0.497, 0.49), (-0.49, 0.46), 0.45),
  'lorry': Form(6.0, 2.1, 2.3, 0.4, 1.3, 1.25, 1.0, 0.95, (0.16, 0.48), (0.18, 0.4), 0.45),
}
WEIGHTS = (0.2, 0.14, 0.09, 0.12, 0.1, 0.09, 0.12, 0.05, 0.04, 0.05)


def build(rng: np.random.Generator) -> list[Part]:
  """One car."""
  kind = str(rng.choice(list(FORMS), p=WEIGHTS))
  form = vary(rng, FORMS[kind])
  colors = mt.scheme(rng)
  look = livery.choose(rng, colors, form.width)
  power = rng.uniform(2.8, 8.0)  # of the cross-section: round to square
  plan = rng.uniform(2.5, 6.0)  # how square the nose and tail are, seen from above
  hull, half_width = body(form, power, plan, kind)
  axles, wheel = place_axles(rng, form)
  lamps = [
    form.clearance + s * (h - form.clearance) for s, h in ((0.7, form.nose), (0.72, form.boot))
  ]
  arches = [(z, wheel, 1.16 * wheel) for z in axles]
  parts = livery.wear(rng, hull, form, look, arches, lamps)
  parts += wheels(rng, look, half_width, axles, wheel)
  if kind == 'open':
    parts += cockpit(rng, form, colors)
  else:
    parts += cabin(rng, form, power, look, panelled=kind == 'van' and rng.uniform() < 0.5)
  if kind == 'pickup':
    parts += bed(rng, form, look, colors)
  if kind == 'lorry':
    parts += cargo(rng, form, look, colors)
  return parts + extras.add(rng, form, half_width, kind, look, colors)


def vary(rng, form: Form) -> Form:
  """The same type in other proportions."""
  stretch, wide, tall = rng.uniform([0.86, 0.9, 0.9], [1.14, 1.1, 1.14])
  lift = rng.uniform(0.9, 1.2)
  shift = rng.uniform(-0.05, 0.05)
  low, high = form.glass, form.roof
  front, rear = low[1] + rng.uniform(-0.05, 0.05), low[0] + max(0, rng.uniform(-0.06, 0.06))
  return form._replace(
    length=form.length * stretch,
    width=form.width * wide,
    height=form.height * tall,
    clearance=form.clearance * lift,
    belt=form.belt * tall * rng.uniform(0.96, 1.06),
    bonnet=form.bonnet * tall * rng.uniform(0.92, 1.04),
    nose=form.nose * tall * rng.uniform(0.85, 1.1),
    boot=form.boot * tall * rng.uniform(0.85, 1.05),
    glass=(rear, min(front, 0.49)),
    roof=(max(high[0] + shift, rear + 0.01), min(high[1] + shift, front - 0.02)),
    wheel=form.wheel * rng.uniform(0.92, 1.15),
  )


def body(form: Form, power, plan, kind):
  """The lower body, and its half width as a function of z."""

  def half_width(z):
    return 0.5 * form.width * (1 - 0.22 * np.abs(2 * z / form.length) ** plan)

  rear, front = form.glass
  knots = [(-0.5, form.boot * 0.93), (-0.46, form.boot), (rear, form.belt), (front, form.belt)]
  knots += [(max(0.34, front + 0.02), form.bonnet), (0.46, form.nose * 1.08), (0.5, form.nose)]
  if kind == 'lorry':
    knots[:3] = [(-0.5, form.boot), (rear - 0.02, form.boot), (rear, form.belt)]
  at, top = np.array([k for k in knots if k[0] <= 0.5]).T
  order = np.argsort(at, kind='stable')
  t = 0.5 * np.sin(np.linspace(-0.5, 0.5, 31) * np.pi)
  high = np.interp(t, at[order], top[order])
  if kind != 'lorry':
    high = np.convolve(np.pad(high, 1, mode='edge'), [0.25, 0.5, 0.25], mode='valid')
  low = form.clearance * (1 + 0.5 * np.abs(2 * t) ** 6)
  ring = solids.ellipse(2, 2, power=power, sides=24)
  z = t * form.length
  x = half_width(z)[:, None] * ring[:, 0]
  y = 0.5 * (high + low)[:, None] + 0.5 * (high - low)[:, None] * ring[:, 1]
  return solids.loft(np.stack([x, y, np.broadcast_to(z[:, None], x.shape)], -1)), half_width


def place_axles(rng, form: Form) -> tuple[list[float], float]:
  """Positions z of two axles (three on a long car), and the wheels' radius."""
  low = 0.95 * min(0.6 * form.bonnet + 0.4 * form.nose, form.boot)  # arches end below the bonnet
  radius = min(form.wheel, 0.47 * low)
  axles = [rng.uniform(0.29, 0.34), -rng.uniform(0.27, 0.33)]
  if form.length > 5.6:
    axles.append(axles[1] + 2.3 * radius / form.length)
  return [a * form.length for a in axles], radius


def wheels(rng, look, half_width, axles, radius) -> list[Part]:
  """The wheels on both sides, a little proud of the body."""
  tread = mt.plain(livery.DARK)
  face = livery.wheel_face(rng, look)
  wide = rng.uniform(0.2, 0.28)
  parts = []
  for z in axles:
    x = half_width(z) + 0.05
    wheel = solids.bar([x - wide, radius, z], [x, radius, z], radius, sides=20)
    parts += [paint(facing(wheel, (1, 2)), tread), paint(facing(wheel, (0,)), face)]
  return parts + [mirror(p) for p in parts]


def cabin(rng, form: Form, power, look, *, panelled) -> list[Part]:
  """A roof over windows all round; `panelled` closes the rear sides, as vans are."""
  power = max(power, 4.0)
  rise = form.height - form.belt

  def level(y):
    t = np.clip((y - form.belt) / rise, 0, 1)
    rear, front = (
      (a + t * (b - a)) * form.length for a, b in zip(form.glass, form.roof, strict=True)
    )
    return rear, front, 0.5 * form.width * (0.93 - 0.17 * t), t

  rings = []
  deep = -0.5 * (form.belt - form.clearance) / rise  # well into the body, which slopes
  for t in (deep, 0.0, 0.3, 0.6, 0.9, 1.0):
    rear, front, half, _ = level(form.belt + t * rise)
    shrink = 0.97 if t == 1.0 else 1.0
    outline = solids.ellipse(2 * half * shrink, (front - rear) * shrink, power=power, sides=32)
    rings.append(np.insert(outline + [0, 0.5 * (front + rear)], 1, form.belt + t * rise, axis=1))
  middle = rings[-1].mean(0)
  rings.append(middle + (rings[-1] - middle) * 0.7 + [0, 0.03, 0])
  count = int(rng.integers(1, 3)) if form.length < 6.5 else 5
  posts = (np.arange(count) + 1) / (count + 1)
  closed = rng.uniform(0.5, 0.7) if panelled else None
  return livery.glaze(solids.loft(rings), look, level, posts, closed_behind=closed)


def cockpit(rng, form: Form, colors) -> list[Part]:
  """An open cabin: a well, two seats, a windscreen frame."""
  rear, front = np.array(form.glass) * form.length
  w = 0.4 * form.width
  dark = mt.plain(mt.shade(colors.second, 0.3))
  well = solids.box((2 * w, 0.04, front - rear), (0, form.belt, 0.5 * (front + rear)))
  seat = mt.plain(colors.accent)
  x, z = 0.5 * w, rear + 0.35
  cushion = solids.pillow(solids.ellipse(0.5, 0.55, power=5), form.belt - 0.1, form.belt + 0.06)
  back = solids.pillow(solids.ellipse(0.5, 0.18, power=4), form.belt, form.height * 0.95, power=5)
  parts = [paint(well, dark)]
  for side in (-x, x):
    for solid, dz in ((cushion, 0.3), (back, 0.0)):
      parts.append(paint(solid._replace(vertices=solid.vertices + [side, 0, z + dz]), seat))
  frame = [[-w, form.belt - 0.05, front], [-0.8 * w, form.height, front - 0.3]]
  frame += [[0.8 * w, form.height, front - 0.3], [w, form.belt - 0.05, front]]
  parts.append(paint(solids.tube(solids.smooth(frame), 0.035), mt.plain(colors.metal)))
  pane = np.array([[frame[0], frame[3]], [frame[1], frame[2]]])
  parts.append(paint(solids.sheet(pane, 0.06), mt.plain([0.3, 0.34, 0.38])))
  return parts


def bed(rng, form: Form, look, colors) -> list[Part]:
  """A pickup's load bed: walls around a dark floor, and maybe a load."""
  front, rear = form.glass[0] * form.length - 0.05, -0.49 * form.length
  mid, long, w = 0.5 * (front + rear), front - rear, 0.45 * form.width
  wall = mt.plain(look.base)
  h = form.belt + rng.uniform(0.02, 0.2)
  dark = mt.plain(mt.shade(colors.metal, 0.4))
  parts = [paint(solids.box((2 * w, 0.08, long), (0, form.belt - 0.02, mid)), dark)]
  for size, at in (
    ((0.12, h - 0.6, long), (w, 0.5 * (h + 0.6), mid)),
    ((0.12, h - 0.6, long), (-w, 0.5 * (h + 0.6), mid)),
    ((2 * w, h - 0.6, 0.12), (0, 0.5 * (h + 0.6), rear + 0.04)),
  ):
    parts.append(paint(solids.box(size, at), wall))
  if rng.uniform() < 0.4:
    up = rng.uniform(0.2, 0.6)
    load = solids.box((1.4 * w, up, 0.6 * long), (0, form.belt + up / 2, mid))
    cloth = mt.fabric(rng, (colors.accent, colors.wood, colors.second), period=1.0)
    parts.append(paint(load, cloth))
  return parts


def cargo(rng, form: Form, look, colors) -> list[Part]:
  """A lorry's load: a box, a tank, or an open platform with sides."""
  front, rear = (form.glass[0] - 0.015) * form.length, -0.5 * form.length
  mid, long, low = 0.5 * (front + rear), front - rear, form.boot
  kind = int(rng.integers(3))
  skin = livery.crate(rng, colors)
  if kind == 0:
    high = form.height * rng.uniform(0.95, 1.25)
    outline = solids.rectangle(form.width, long) + [0, mid]
    return [paint(solids.slab(outline, low, high), skin)]
  if kind == 1:
    r = 0.5 * form.width * rng.uniform(0.8, 0.98)
    path = [[0, low + 0.9 * r, z] for z in np.linspace(rear, front, 5)]
    swell = np.array([0.8, 1, 1, 1, 0.8])[:, None] * [r, 0.9 * r]
    return [paint(solids.tube(path, swell, sides=20), skin)]
  high = low + rng.uniform(0.3, 0.7)
  outline = solids.rectangle(form.width, long) + [0, mid]
  heap = solids.pillow(0.9 * (outline - [0, mid]) + [0, mid], low, high + 0.35, power=2)
  return [paint(solids.slab(outline, low, high), skin), paint(heap, mt.plain(colors.wood))]
