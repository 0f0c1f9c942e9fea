"""Cloth: a garment's surface cut into panels, as tailors do, each with its pattern.

Sleeves meet the trunk at the armhole and trouser legs meet in the middle; a pattern is continuous
within each panel and breaks only at these seams.
"""

from typing import NamedTuple

import numpy as np

from datagen.sources.people import patterns
from datagen.sources.people.charts import Chart
from datagen.sources.people.layers import Layer, Paint
from datagen.sources.people.patterns import Pattern

CUTS = ('top', 'trousers', 'overall', 'skirt')
PRINT_SIZE = 0.1  # of a print, in heights of the person
TURNS = 2.1  # about the trunk that are as long as one height of the person


class Garment(NamedTuple):
  """A piece of clothing."""

  faces: np.ndarray  # [F, 4] quads of one group of the body's data
  field: np.ndarray  # [V]; positive, in dm, where the garment is
  lift: np.ndarray  # [V] how far it lies off the group's surface, dm
  cloth: Pattern | np.ndarray  # or a colour [3]
  cut: str = 'top'  # one of CUTS
  ink: np.ndarray | None = None  # [3] of a print on the chest


def lay(chart: Chart, garment: Garment, *, waist: float) -> list[Layer]:
  """A garment's layers: one for each panel, or a single one if it has one colour.

  Args:
    chart: the person's chart.
    garment: the garment.
    waist: y where the legs of an overall begin.
  """
  cloth = garment.cloth
  if not isinstance(cloth, Pattern):
    return [Layer(garment.faces, garment.field, garment.lift, Paint(cloth))]
  if cloth.kind == 'plain' and garment.ink is None:
    return [Layer(garment.faces, garment.field, garment.lift, Paint(cloth.colors[0]))]
  used = np.unique(garment.faces)
  worn = used[(garment.field[used] >= 0) & ~chart.is_arm[used]]
  span = chart.laid['trunk'][worn, 1] if len(worn) else np.array([0.0, 1.0])
  cloth = cloth._replace(low=float(span.min()), high=float(span.max()))
  pictures = {part: patterns.draw(cloth, part=part) for part in ('trunk', 'arm', 'leg')}
  if garment.ink is not None:
    chest = 0.68 * chart.at['spine_03'][1] + 0.32 * chart.at['neck_01'][1]
    patterns.add_print(
      np.random.default_rng(cloth.seed),
      pictures['trunk'],
      garment.ink,
      at=(chest - chart.floor) / chart.height,
      size=PRINT_SIZE,
      wide=TURNS,
    )
  found = []
  for part, seams in _panels(chart, garment.cut, waist).items():
    mine = garment.faces
    for seam in seams:
      mine = mine[(seam[mine] > 0).any(1)]
    uv = chart.laid[part] + [0.5, 0]
    paint = Paint(cloth.colors[0], pictures[part.partition('_')[0]], uv, wraps=True)
    if len(mine):
      found.append(Layer(mine, garment.field, garment.lift, paint, seams))
  return found


def _panels(chart, cut, waist):
  """The fields [V] that are positive in each panel, by the part of the chart."""
  x, y, _ = chart.vertices.T
  arm = chart.arm_weight - 0.5
  sleeves = {'arm_l': (arm, x), 'arm_r': (arm, -x)}
  legs = {'leg_l': (x,), 'leg_r': (-x,)}
  if cut == 'skirt':
    return {'trunk': ()}
  if cut == 'trousers':
    return legs
  if cut == 'top':
    return {'trunk': (-arm,)} | sleeves
  below = np.where(chart.is_arm, -1.0, waist - y)  # a hand may hang below the waist
  legs = {part: (*seams, below) for part, seams in legs.items()}
  return {'trunk': (-arm, y - waist)} | sleeves | legs
