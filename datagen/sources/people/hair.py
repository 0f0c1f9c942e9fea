"""Hair and headwear: the scalp lifted off the head, the helpers' long hair, and things on top.

A hairline is a line over the head seen from the side, in head units about the eyes: z forward and y
up, 1 from the eyes to the crown. Ears stay out.
"""

from typing import NamedTuple

import numpy as np

from datagen.sources.people.charts import Chart
from datagen.sources.people.data import BodyData
from datagen.sources.people.layers import Layer, Paint, Prop
from datagen.sources.shapes import solids

STYLES = ('bald', 'cropped', 'short', 'full', 'afro', 'bun', 'ponytail', 'long', 'bob')
HEADWEAR = ('none', 'cap', 'beanie', 'hat', 'headscarf')
COLORS = np.array([
  [0.05, 0.04, 0.05], [0.14, 0.08, 0.05], [0.3, 0.17, 0.08], [0.5, 0.3, 0.12], [0.85, 0.68, 0.35],
  [0.62, 0.22, 0.08], [0.55, 0.55, 0.56], [0.86, 0.86, 0.84],
])  # fmt: skip
LINE = ((-2.0, -0.95), (-1.0, -0.75), (-0.62, -0.1), (-0.45, 0.12), (-0.1, 0.62), (1.0, 0.75))
# Where the ears are on the base mesh: farther from the middle than x, between y and between z, dm.
EARS = (0.76, (6.7, 7.68), (0.18, 0.9))


class Head(NamedTuple):
  """What is worn on it."""

  style: str
  headwear: str
  hair: np.ndarray  # [3]
  cloth: np.ndarray  # [3] of the headwear
  trim: np.ndarray  # [3] of a brim or ribbon


def sample(rng: np.random.Generator, *, woman: bool, old: bool, cloth, trim) -> Head:
  """A hair cut and, at times, a hat."""
  share = [0, 1, 2, 1, 1, 1.5, 1.5, 2, 2] if woman else [1, 2, 4, 2, 1, 0.2, 0.4, 0.5, 0.3]
  style = STYLES[rng.choice(len(STYLES), p=np.array(share) / sum(share))]
  worn = [5, 1, 1, 0.8, 0.5 if woman else 0]
  headwear = HEADWEAR[rng.choice(len(HEADWEAR), p=np.array(worn) / sum(worn))]
  if headwear != 'none' and style in ('afro', 'bun'):
    style = 'short'
  hair = COLORS[rng.integers(5, 8) if old and rng.random() < 0.8 else rng.integers(6)]
  if rng.random() < 0.05:
    hair = cloth
  return Head(style, headwear, np.clip(hair + rng.normal(0, 0.02, 3), 0, 1), cloth, trim)


def layers(
  rng: np.random.Generator, data: BodyData, chart: Chart, head: Head
) -> tuple[list[Layer], list[Prop], np.ndarray]:
  """Surfaces of hair and headwear.

  Returns:
    layers and things; and a field [V] that is positive, in dm, where the skin is covered.
  """
  eyes = 0.5 * sum(chart.vertices[np.unique(data.groups[f'helper-{s}-eye'])].mean(0) for s in 'lr')
  used = np.unique(data.groups['body'])
  skull = used[chart.head_weight[used] > 0.5]
  unit = chart.vertices[skull, 1].max() - eyes[1]
  z, y = ((chart.vertices - eyes) / unit).T[[2, 1]]
  body = data.groups['body']
  line = y - np.interp(z, *np.array(LINE).T)
  is_head = chart.head_weight > 0.3
  field = np.where(is_head & ~_is_ear(data), line * unit, -1.0)
  thick = {'bald': 0.0, 'cropped': 0.06, 'short': 0.16, 'full': 0.3, 'afro': 0.75}
  thick = thick.get(head.style, 0.14) * unit / 1.2
  found, props = [], []
  hair = Paint(head.hair)
  covered = np.full(len(field), -1.0)
  if head.style != 'bald' and head.headwear != 'headscarf':
    lift = thick * np.clip(0.15 + field / (0.35 * unit), 0.15, 1)
    found.append(Layer(body, field, lift, hair))
    covered = field
    if head.style in ('long', 'bob'):
      found += _curtain(rng, data, chart, head, eyes, unit, hair)
    if head.style == 'bun':
      up = rng.uniform(0.2, 0.8)
      props.append(_ball(eyes, unit, (0, up, -1.72 + 0.35 * up), (0.42, 0.42, 0.42), hair))
    if head.style == 'ponytail':
      props.append(_ball(eyes, unit, (0, 0.45, -1.58), (0.22, 0.22, 0.3), hair))
      props.append(_ball(eyes, unit, (0, -0.22, -1.8), (0.26, 0.8, 0.24), hair))
  if head.headwear != 'none':
    found, hat_field = _headwear(body, field, y, z, unit, is_head, head, found, props, eyes)
    covered = np.maximum(covered, hat_field)
  return found, props, covered


def _is_ear(data):
  """[V] bool."""
  x, (low, high), (back, front) = EARS
  p = data.vertices
  return (
    (np.abs(p[:, 0]) > x)
    & (p[:, 1] > low)
    & (p[:, 1] < high)
    & (p[:, 2] > back)
    & (p[:, 2] < front)
  )


def _curtain(rng, data, chart, head, eyes, unit, paint):
  """The helpers' long hair, behind the face and down to a length."""
  quads = data.groups['helper-hair']
  used = np.unique(quads)
  p = chart.vertices
  end = eyes[1] - unit * (rng.uniform(0.7, 1.0) if head.style == 'bob' else rng.uniform(1.3, 2.6))
  field = np.full(len(p), -1.0)
  z = (p[used, 2] - eyes[2]) / unit
  field[used] = np.minimum(p[used, 1] - end, unit * (-0.38 - z))
  return [Layer(quads, field, np.full(len(p), 0.02), paint)]


def _headwear(body, field, y, z, unit, is_head, head, hair, props, eyes):
  """Adds the headwear to what is on the head; hair under it goes."""
  cloth, trim = Paint(head.cloth), Paint(head.trim)
  if head.headwear == 'headscarf':
    line = np.interp(z, *np.array(LINE).T) - 0.08
    hat = np.where(is_head, np.minimum(y - line, 1.0) * unit, -1.0)
    hat = np.where(is_head & (z < -0.35), unit * (y + 1.05), hat)
    lift = 0.14 * unit
  else:
    rim = {'cap': 0.42, 'beanie': 0.3, 'hat': 0.45}[head.headwear]
    hat = np.where(is_head, (y - rim - 0.12 * z) * unit, -1.0)
    lift = {'cap': 0.2, 'beanie': 0.24, 'hat': 0.2}[head.headwear] * unit
  found = [
    layer._replace(field=np.minimum(layer.field, 0.05 - hat)) if layer.faces is body else layer
    for layer in hair
  ]
  found = [
    layer
    if layer.faces is body
    else layer._replace(field=np.minimum(layer.field, (0.35 - y) * unit))
    for layer in found
  ]
  found.append(Layer(body, hat, np.full(len(hat), lift), cloth))
  if head.headwear == 'cap':
    props.append(_ball(eyes, unit, (0, 0.46, 0.42), (0.62, 0.07, 0.6), trim))
  if head.headwear == 'hat':
    props.append(_ball(eyes, unit, (0, 0.42, -0.62), (1.35, 0.07, 1.5), trim))
    props.append(_ball(eyes, unit, (0, 0.85, -0.66), (0.82, 0.62, 1.0), cloth))
  if head.headwear == 'beanie':
    props.append(_ball(eyes, unit, (0, 1.3, -0.68), (0.24, 0.24, 0.24), trim))
  return found, hat


def _ball(eyes, unit, center, radii, paint):
  """An ellipsoid in head units."""
  solid = solids.ellipsoid(tuple(unit * np.array(radii)), tuple(eyes + unit * np.array(center)))
  return Prop(solid.vertices, solid.faces, 'head', paint)
