"""Hair and headwear: the scalp lifted off the head, the helpers' long hair, and attachments.

A hairline is a line over the head seen from the side, in head units from the eyes: z forward and y
up, 1 from the eyes to the crown. Ears stay uncovered.
"""

from typing import NamedTuple

import numpy as np

from datagen.sources.people.charts import Chart
from datagen.sources.people.data import BodyData
from datagen.sources.people.layers import Layer, Paint, Prop
from datagen.sources.shapes import solids

STYLES = ('bald', 'cropped', 'short', 'full', 'afro', 'bun', 'ponytail', 'long', 'bob')
HEADWEAR = ('none', 'cap', 'beanie', 'hat', 'headscarf')
COLORS = np.array(
  [
    [0.05, 0.04, 0.05],
    [0.14, 0.08, 0.05],
    [0.3, 0.17, 0.08],
    [0.5, 0.3, 0.12],
    [0.85, 0.68, 0.35],
    [0.62, 0.22, 0.08],
    [0.55, 0.55, 0.56],
    [0.86, 0.86, 0.84],
  ]
)
GREY = 6  # from here on
LINE = ((-2.0, -0.95), (-1.0, -0.75), (-0.62, -0.1), (-0.45, 0.12), (-0.1, 0.62), (1.0, 0.75))
# Where the ears are on the base mesh: farther from the middle than x, between y and between z, dm.
EARS = (0.76, (6.7, 7.68), (0.18, 0.9))
THICK = {'bald': 0.0, 'cropped': 0.05, 'short': 0.133, 'full': 0.25, 'afro': 0.625}  # head units
TIED = 0.117  # the same of all other styles
RIMS = {'cap': 0.42, 'beanie': 0.3, 'hat': 0.45}  # how far above the eyes, head units
NOWHERE = -1.0  # a field's value


class Head(NamedTuple):
  """Hair and headwear of a person."""

  style: str
  headwear: str
  hair: np.ndarray  # [3]
  cloth: np.ndarray  # [3] of the headwear
  trim: np.ndarray  # [3] of a brim or ribbon


def sample(rng: np.random.Generator, *, woman: bool, old: bool, cloth, trim) -> Head:
  """A random haircut and sometimes a hat."""
  share = [0, 1, 2, 1, 1, 1.5, 1.5, 2, 2] if woman else [1, 2, 4, 2, 1, 0.2, 0.4, 0.5, 0.3]
  style = STYLES[rng.choice(len(STYLES), p=np.array(share) / sum(share))]
  worn = [5, 1, 1, 0.8, 0.5 if woman else 0]
  headwear = HEADWEAR[rng.choice(len(HEADWEAR), p=np.array(worn) / sum(worn))]
  if headwear != 'none' and style in ('afro', 'bun'):
    style = 'short'
  grey = old and rng.random() < 0.8
  hair = COLORS[rng.integers(GREY, len(COLORS)) if grey else rng.integers(GREY)]
  if rng.random() < 0.05:
    hair = cloth
  return Head(style, headwear, np.clip(hair + rng.normal(0, 0.02, 3), 0, 1), cloth, trim)


class _Skull(NamedTuple):
  """Measurements of a head."""

  eyes: np.ndarray  # [3] midway between them
  unit: float  # from the eyes to the crown, dm
  forward: np.ndarray  # [V] from the eyes, head units
  up: np.ndarray  # [V]
  is_head: np.ndarray  # [V] bool


def layers(
  rng: np.random.Generator, data: BodyData, chart: Chart, head: Head
) -> tuple[list[Layer], list[Prop], np.ndarray]:
  """Surfaces of hair and headwear.

  Returns:
    layers and props; and a field [V] that is positive, in dm, on covered skin.
  """
  skull = _skull(data, chart)
  found: list[Layer] = []
  props: list[Prop] = []
  covered = np.full(len(chart.vertices), NOWHERE)
  if head.style != 'bald' and head.headwear != 'headscarf':
    paint = Paint(head.hair)
    above = (skull.up - np.interp(skull.forward, *np.array(LINE).T)) * skull.unit
    covered = np.where(skull.is_head & ~_is_ear(data), above, NOWHERE)
    thick = THICK.get(head.style, TIED) * skull.unit
    lift = thick * np.clip(0.15 + covered / (0.35 * skull.unit), 0.15, 1)
    found.append(Layer(data.groups['body'], covered, lift, paint))
    if head.style in ('long', 'bob'):
      found.append(_curtain(rng, data, chart, head.style, skull, paint))
    props += _tied(rng, head.style, skull, paint)
  if head.headwear != 'none':
    hat = _hat_field(head.headwear, skull)
    found = [_under_hat(layer, data, skull, hat) for layer in found]
    lift = {'headscarf': 0.14, 'beanie': 0.24}.get(head.headwear, 0.2) * skull.unit
    found.append(Layer(data.groups['body'], hat, np.full(len(hat), lift), Paint(head.cloth)))
    props += _trimmings(head, skull)
    covered = np.maximum(covered, hat)
  return found, props, covered


def _skull(data, chart):
  """Measures a head."""
  eyes = 0.5 * sum(chart.vertices[np.unique(data.groups[f'helper-{s}-eye'])].mean(0) for s in 'lr')
  used = np.unique(data.groups['body'])
  unit = chart.vertices[used[chart.head_weight[used] > 0.5], 1].max() - eyes[1]
  _, up, forward = ((chart.vertices - eyes) / unit).T
  return _Skull(eyes, float(unit), forward, up, chart.head_weight > 0.3)


def _is_ear(data):
  """[V] bool."""
  x, y, z = data.vertices.T
  beyond, (low, high), (back, front) = EARS
  return (np.abs(x) > beyond) & (y > low) & (y < high) & (z > back) & (z < front)


def _curtain(rng, data, chart, style, skull, paint):
  """The helpers' long hair, behind the face and down to a length."""
  quads = data.groups['helper-hair']
  low = rng.uniform(0.7, 1.0) if style == 'bob' else rng.uniform(1.3, 2.6)
  field = np.full(len(chart.vertices), NOWHERE)
  used = np.unique(quads)
  field[used] = skull.unit * np.minimum(skull.up + low, -0.38 - skull.forward)[used]
  return Layer(quads, field, np.full(len(field), 0.02), paint)


def _tied(rng, style, skull, paint):
  """A bun or a ponytail behind the head."""
  if style == 'bun':
    up = rng.uniform(0.2, 0.8)
    return [_ball(skull, (0, up, -1.72 + 0.35 * up), (0.42, 0.42, 0.42), paint)]
  if style == 'ponytail':
    return [
      _ball(skull, (0, 0.45, -1.58), (0.22, 0.22, 0.3), paint),
      _ball(skull, (0, -0.22, -1.8), (0.26, 0.8, 0.24), paint),
    ]
  return []


def _hat_field(headwear, skull):
  """[V] positive under headwear, dm; a headscarf reaches down to the neck behind the face."""
  if headwear != 'headscarf':
    above = skull.up - RIMS[headwear] - 0.12 * skull.forward
    return np.where(skull.is_head, above * skull.unit, NOWHERE)
  above = skull.up - np.interp(skull.forward, *np.array(LINE).T) + 0.08
  above = np.where(skull.forward < -0.35, skull.up + 1.05, np.minimum(above, 1.0))
  return np.where(skull.is_head, above * skull.unit, NOWHERE)


def _under_hat(layer, data, skull, hat):
  """Hair visible under a hat: the scalp's below the rim, long hair's below the brow."""
  is_scalp = layer.faces is data.groups['body']
  below = 0.05 - hat if is_scalp else (0.35 - skull.up) * skull.unit
  return layer._replace(field=np.minimum(layer.field, below))


def _trimmings(head, skull):
  """Peak, brim or bobble."""
  cloth, trim = Paint(head.cloth), Paint(head.trim)
  if head.headwear == 'cap':
    return [_ball(skull, (0, 0.46, 0.42), (0.62, 0.07, 0.6), trim)]
  if head.headwear == 'hat':
    return [
      _ball(skull, (0, 0.42, -0.62), (1.35, 0.07, 1.5), trim),
      _ball(skull, (0, 0.85, -0.66), (0.82, 0.62, 1.0), cloth),
    ]
  if head.headwear == 'beanie':
    return [_ball(skull, (0, 1.3, -0.68), (0.24, 0.24, 0.24), trim)]
  return []


def _ball(skull, center, radii, paint):
  """An ellipsoid in head units about the eyes."""
  center = skull.eyes + skull.unit * np.array(center)
  solid = solids.ellipsoid(tuple(skull.unit * np.array(radii)), tuple(center))
  return Prop(solid.vertices, solid.faces, 'head', paint)
