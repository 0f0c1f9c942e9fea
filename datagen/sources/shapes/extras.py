"""Parts that stand out from a car: mirrors, taxi signs, light bars, racks, spoilers, wheels."""

import numpy as np

from datagen.sources.shapes import livery, solids
from datagen.sources.shapes import materials as mt
from datagen.sources.shapes.parts import Part, facing, mirror, paint

_LOW = ('open', 'lorry')  # these carry nothing on the roof


def add(rng, form, half_width, kind, look: livery.Look, colors: mt.Scheme) -> list[Part]:
  """Mirrors, and some of the rest.

  Args:
    rng: the generator.
    form: a `car.Form`.
    half_width: of the body, as a function of z.
    kind: a key of `car.FORMS`.
    look: its paint.
    colors: for what is not painted with the body.
  """
  z = form.glass[1] * form.length - 0.35
  at = (half_width(z) + 0.06, form.belt + 0.06, z)
  wing = paint(solids.ellipsoid((0.12, 0.1, 0.08), at, sides=8), mt.plain(look.base))
  parts = [wing, mirror(wing)]
  if kind not in _LOW:
    parts += _on_the_roof(rng, form, look, colors)
  if kind in ('sports', 'hatchback', 'sedan') and rng.uniform() < 0.4:
    parts += _spoiler(rng, form, look)
  if kind in ('offroad', 'pickup', 'van') and rng.uniform() < 0.5:
    size = (0.2, 0.1, 0.4 * form.length)
    board = solids.box(size, (0.5 * form.width, form.clearance + 0.05, 0))
    board = paint(board, mt.plain(livery.DARK * 1.5))
    parts += [board, mirror(board)]
  if kind == 'offroad' and rng.uniform() < 0.5:
    spare = [[0, form.belt - 0.1, z] for z in (-0.5 * form.length - 0.22, -0.5 * form.length)]
    wheel = solids.bar(*spare, form.wheel * 0.9, sides=16)
    parts.append(paint(facing(wheel, (0, 1)), mt.plain(livery.DARK)))
    parts.append(paint(facing(wheel, (2,)), livery.wheel_face(rng, look)))
  return parts


def _on_the_roof(rng, form, look, colors) -> list[Part]:
  """A taxi sign, a light bar, a box or luggage on bars, or mostly nothing."""
  rear, front = np.array(form.roof) * form.length
  mid, top = 0.5 * (rear + front), form.height + 0.01
  wide, pick = 0.7 * form.width, rng.uniform()
  if pick < 0.08:
    sign = solids.box((0.6, 0.26, 0.26), (0, top + 0.12, mid))
    return [paint(sign, mt.plain([0.85, 0.7, 0.15]))]
  if pick < 0.16:
    tones = ((-0.3, [0.75, 0.12, 0.12]), (0.3, [0.12, 0.25, 0.75]))
    lamps = [solids.box((0.58, 0.2, 0.28), (x, top + 0.09, mid)) for x, _ in tones]
    return [paint(s, mt.plain(tone)) for s, (_, tone) in zip(lamps, tones, strict=True)]
  if pick > 0.28:
    return []
  parts = []
  for z in (rear + 0.2, front - 0.2):
    bar = solids.box((wide, 0.1, 0.1), (0, top + 0.05, z))
    parts.append(paint(bar, mt.plain(colors.metal)))
  if rng.uniform() < 0.7:
    long = 0.8 * (front - rear)
    outline = solids.ellipse(wide * rng.uniform(0.4, 0.9), long, power=6) + [0, mid]
    load = solids.slab(outline, top + 0.08, top + rng.uniform(0.25, 0.45), bevel=0.05)
    parts.append(paint(load, mt.plain(colors.accent)))
  return parts


def _spoiler(rng, form, look) -> list[Part]:
  """A wing over the tail on two posts."""
  up, z = form.boot + rng.uniform(0.18, 0.3), -0.47 * form.length
  skin = mt.plain(look.base if rng.uniform() < 0.5 else look.accent)
  post = paint(solids.box((0.1, 0.4, 0.16), (0.3 * form.width, up - 0.2, z)), skin)
  blade = paint(solids.box((0.85 * form.width, 0.08, 0.28), (0, up, z)), skin)
  return [blade, post, mirror(post)]
