"""Garments of an outfit as surfaces: fields over a body's vertices, in dm, positive under cloth.

Garments are listed from the outermost to the innermost. An inner garment ends a little below the
hem of the outer one, so that no voxel holds both.
"""

from typing import NamedTuple

import numpy as np

from datagen.sources.people import cloth
from datagen.sources.people.charts import Chart
from datagen.sources.people.cloth import Garment
from datagen.sources.people.data import BodyData
from datagen.sources.people.layers import Layer
from datagen.sources.people.outfits import Outfit, wants_skirt

OVERLAP = 0.06  # dm, of a garment with what lies further out
NOWHERE, EVERYWHERE = -1.0, 99.0  # values of fields
ALONG_ARM, ALONG_LEG = 2.5, 4.0  # dm that one unit of the chart's arm and leg is long


class _Fit(NamedTuple):
  """Measures of one body."""

  unit: float  # 1 for the base mesh, of 16.7 dm
  waist: float  # y
  hip: float  # y
  neckline: np.ndarray  # [V] positive below it


def dress(data: BodyData, chart: Chart, outfit: Outfit) -> tuple[list[Layer], np.ndarray]:
  """The garments' surfaces, and a field [V] that is positive, in dm, on covered skin."""
  fit = _fit(chart, outfit)
  skirt = _skirt(data, chart, outfit, fit)
  worn = [*_outer(data, chart, outfit, fit), *skirt, *_top(data, chart, outfit, fit)]
  worn += [*_bottom(data, chart, outfit, fit), *_inner(data, chart, outfit, fit)]
  found, covered = [], np.full(len(chart.vertices), NOWHERE)
  for garment in worn:
    shown = garment._replace(field=np.minimum(garment.field, OVERLAP * fit.unit - covered))
    found += cloth.lay(chart, shown, waist=fit.waist)
    covered = np.maximum(covered, np.where(_free(chart, garment), NOWHERE, garment.field))
  return found, covered


def _free(chart, garment):
  """[V] bool: vertices that a garment cannot hide, such as arms beside a skirt."""
  return chart.is_arm if garment.cut == 'skirt' else np.zeros(len(chart.vertices), bool)


def _fit(chart, outfit):
  """Measurements, and the neckline: round, pointed, or with a standing collar."""
  unit = chart.height / 16.7
  x, y, _ = chart.vertices.T
  front = np.clip(np.cos(2 * np.pi * chart.laid['trunk'][:, 0]), 0, 1)
  neckline = chart.at['neck_01'][1] + (0.06 - 0.5 * front) * unit - y
  if outfit.neck == 'high':
    neckline = neckline + 0.32 * unit
  if outfit.neck == 'vee':
    neckline = neckline - (front > 0) * np.clip(unit - 1.6 * np.abs(x), 0, None)
  return _Fit(
    unit=unit,
    waist=0.3 * chart.at['spine_01'][1] + 0.7 * chart.at['spine_02'][1],
    hip=chart.at['thigh_l'][1],
    neckline=neckline,
  )


def _upper(chart, fit, low, sleeve):
  """The field of a top that ends at the height `low` and at `sleeve` of the arms (none below 0)."""
  trunk = np.minimum(chart.vertices[:, 1] - low, fit.neckline)
  if sleeve >= 0:
    return np.where(chart.is_arm, (sleeve - chart.arm) * ALONG_ARM * fit.unit, trunk)
  joints = [chart.at[f'upperarm_{s}'] for s in 'lr']
  away = np.min([np.linalg.norm(chart.vertices - joint, axis=1) for joint in joints], axis=0)
  armhole = np.minimum(away - 0.75 * fit.unit, (0.4 - chart.arm_weight) * fit.unit)
  return np.minimum(trunk, armhole)


def _lower(chart, fit, high, length):
  """The field of trousers from the height `high` to `length` of the legs."""
  trunk = np.where(chart.is_arm, NOWHERE, high - chart.vertices[:, 1])
  ends = (length - chart.leg) * ALONG_LEG * fit.unit
  return np.where(chart.is_leg, np.minimum(trunk, ends), trunk)


def _below(chart, fit, length):
  """The field of footwear up to `length` of the legs."""
  return np.where(chart.is_leg, (chart.leg - length) * ALONG_LEG * fit.unit, NOWHERE)


def _outer(data, chart, outfit, fit):
  """Boots and belt."""
  tights, y = data.groups['helper-tights'], chart.vertices[:, 1]
  found = []
  if outfit.shoes == 'boots':
    lift = np.full(len(y), 0.24 * fit.unit)
    found.append(Garment(tights, _below(chart, fit, 1.45), lift, outfit.shoe))
  if outfit.belt is not None and not wants_skirt(outfit):
    band = np.where(chart.is_arm, NOWHERE, 0.3 * fit.unit - np.abs(y - fit.waist))
    lift = np.full(len(y), (0.2 + 0.12 * outfit.loose) * fit.unit)
    found.append(Garment(tights, band, lift, outfit.belt))
  return found


def _skirt(data, chart, outfit, fit):
  """A skirt, or a dress's, on the helpers' skirt; wider towards its hem."""
  if not wants_skirt(outfit):
    return []
  y = chart.vertices[:, 1]
  is_dress = outfit.top == 'dress'
  top = fit.waist + (0.1 if is_dress else 0.25) * fit.unit
  field = np.minimum(top - y, (outfit.skirt - chart.leg) * ALONG_LEG * fit.unit)
  wide = np.clip((top - y) / (5 * fit.unit), 0, 1)
  lift = (0.05 + 0.5 * outfit.loose * wide) * fit.unit
  cloth = outfit.top_cloth if is_dress else outfit.bottom_cloth
  return [Garment(data.groups['helper-skirt'], field, lift, cloth, cut='skirt')]


def _top(data, chart, outfit, fit):
  """Shirt, jumper, vest, the upper half of a dress, or a jacket over a shirt."""
  tights, (x, y, _) = data.groups['helper-tights'], chart.vertices.T
  loose, unit = outfit.loose, fit.unit

  def made(field, lift, cloth, **kind):
    return Garment(tights, field, np.full(len(y), lift * unit), cloth, **kind)

  hem = fit.waist if outfit.tucked else fit.hip - 0.1 * unit
  if outfit.top == 'overall':
    flare = np.clip(chart.leg - 0.8, 0, 1) * chart.is_leg
    upper = _upper(chart, fit, NOWHERE * EVERYWHERE, outfit.sleeve)
    whole = np.where(chart.is_leg, _lower(chart, fit, EVERYWHERE, outfit.leg), upper)
    garment = made(whole, 0.08 + 0.12 * loose, outfit.top_cloth, cut='overall', ink=outfit.printed)
    return [garment._replace(lift=garment.lift + 0.1 * loose * flare * unit)]
  if outfit.top == 'jacket':
    in_front = (np.abs(chart.laid['trunk'][:, 0]) < 0.25) & ~chart.is_arm
    opening = np.where(in_front, np.abs(x) - (0.28 + 0.1 * loose) * unit, EVERYWHERE)
    jacket = np.minimum(_upper(chart, fit, fit.hip - 0.35 * unit, outfit.sleeve), opening)
    return [
      made(jacket, 0.2 + 0.14 * loose, outfit.top_cloth),
      made(_upper(chart, fit, hem, 0.5), 0.08, outfit.under),
    ]
  bulk = {'T-shirt': 0.11, 'shirt': 0.13, 'jumper': 0.22, 'vest': 0.1, 'dress': 0.1}[outfit.top]
  hangs = not (outfit.tucked or wants_skirt(outfit))
  low = fit.waist - 0.3 * unit if wants_skirt(outfit) else hem
  lift = bulk + 0.05 * hangs + 0.1 * loose
  field = _upper(chart, fit, low, outfit.sleeve)
  return [made(field, lift, outfit.top_cloth, ink=outfit.printed)]


def _bottom(data, chart, outfit, fit):
  """Trousers, shorts or leggings; wide ones are widest below the knee."""
  if wants_skirt(outfit) or outfit.top == 'overall':
    return []
  wide = {'trousers': 0.35, 'shorts': 0.25, 'leggings': 0.0}[outfit.bottom] * outfit.loose
  flare = np.clip(chart.leg - 0.8, 0, 1) * chart.is_leg
  lift = (0.05 + 0.04 * (outfit.bottom != 'leggings') + wide * flare) * fit.unit
  field = _lower(chart, fit, fit.waist + 0.1 * fit.unit, outfit.leg)
  return [Garment(data.groups['helper-tights'], field, lift, outfit.bottom_cloth, cut='trousers')]


def _inner(data, chart, outfit, fit):
  """Shoes, socks and gloves."""
  tights, found = data.groups['helper-tights'], []

  def add(faces, field, lift, color):
    found.append(Garment(faces, field, np.full(len(field), lift * fit.unit), color))

  if outfit.shoes == 'shoes':
    add(tights, _below(chart, fit, 1.93), 0.12, outfit.shoe)
  if outfit.socks is not None:
    add(tights, _below(chart, fit, outfit.socks), 0.04, outfit.under)
  if outfit.gloves is not None:
    wrist = np.where(chart.is_arm, (chart.arm - 1.85) * ALONG_ARM * fit.unit, NOWHERE)
    add(data.groups['body'], wrist, 0.05, outfit.gloves)
  return found
