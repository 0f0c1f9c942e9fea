"""Measurements of a record, and which models look wrong.

Colour distances are Euclidean, for RGB in [0, 1].
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cvn.dataset import Record
from datagen.geometry.flow import FIDELITY, FlowStats, sampling_error

FEW_VOXELS = 300  # a flat square of 17 voxels' side
ONE_COLOR = 0.02  # mean distance to the mean colour; texture and shadow are beyond it
INSIDE_OUT = -0.02  # signed volume, of the bounding box's
SLENDER = 2.0  # how many times taller or flatter than its category's median is far from upright
# What is usual in a category: height over the longer of width and depth, and width over depth.
USUAL = {
  'car': ((0.15, 0.8), (0.2, 0.9)),
  'chair': ((0.7, 2.8), (0.4, 2.0)),
  'guitar': ((1.5, 6.0), (1.2, 20.0)),
  'human': ((0.8, 6.0), (0.3, 10.0)),
  'person': ((0.8, 6.0), (0.3, 10.0)),
  'sofa': ((0.15, 1.1), (0.9, 5.0)),
  'table': ((0.1, 1.6), (0.3, 4.0)),
}
PEERS = 5  # models of a category that make a median


class Examined(NamedTuple):
  """The measurements of one model."""

  voxels: int
  visible: float  # share of (view, voxel) pairs that are visible
  visible_error: float  # mean `sampling_error` of visible voxels
  visible_faithful: float  # share of visible voxels for which it is below FIDELITY
  error: float  # mean distance over all pairs
  color_spread: float  # mean distance of the voxels' colours to their mean
  uprightness: float  # height over the longer of width and depth
  missing: int  # files of textures and materials that were not there
  volume: float  # signed, of its bounding box's
  notes: int = 0  # bits of datagen.reading.notes
  breadth: float = 1.0  # width over depth


def examine(record: Record) -> Examined:
  """Measures one model. Under any shading but flat, errors include the light."""
  error = _errors(record)
  color = record.surface_color.astype(np.float32)
  seen = error[record.visible] if record.visible.any() else np.zeros(1)
  extent = np.ptp(record.surface_index.astype(int), axis=0) + 1
  return Examined(
    voxels=len(record.surface_index),
    visible=float(record.visible.mean()),
    visible_error=float(seen.mean()),
    visible_faithful=float((seen < FIDELITY).mean()),
    error=float(error.mean()),
    color_spread=float(np.linalg.norm(color - color.mean(0), axis=-1).mean() / 255),
    uprightness=float(extent[1] / max(extent[0], extent[2])),
    missing=int(record.facts.missing),
    volume=float(record.facts.volume),
    notes=int(record.facts.notes),
    breadth=float(extent[0] / extent[2]),
  )


def flow_stats(record: Record, similarity: float) -> FlowStats:
  """The statistics of `datagen.geometry.flow`, for flows that were made elsewhere.

  Args:
    record: the model.
    similarity: maximum distance of similar colours.
  """
  examined = examine(record)
  hidden_similar = ~record.visible & (_errors(record) <= similarity)
  matched = float(hidden_similar.mean())
  return FlowStats(
    visible=examined.visible,
    matched=matched,
    fallback=1 - examined.visible - matched,
    visible_error=examined.visible_error,
    visible_faithful=examined.visible_faithful,
    error=examined.error,
  )


def suspicions(examined: Sequence[Examined], categories: Sequence[str]) -> list[list[str]]:
  """The reasons to suspect each model; most lists are empty.

  Args:
    examined: the models.
    categories: the category of each.
  """
  tall = {}
  for category in set(categories):
    values = [
      np.log(e.uprightness) for e, c in zip(examined, categories, strict=True) if c == category
    ]
    if len(values) >= PEERS:
      tall[category] = np.median(values)
  result = []
  for e, category in zip(examined, categories, strict=True):
    reasons = []
    if e.voxels < FEW_VOXELS:
      reasons.append(f'almost empty ({e.voxels} voxels)')
    if e.color_spread < ONE_COLOR:
      reasons.append('a single colour')
    if e.volume < INSIDE_OUT:
      reasons.append(f'inside out (signed volume {e.volume:.2f} of its box)')
    times = np.exp(np.log(e.uprightness) - tall.get(category, np.log(e.uprightness)))
    unusual = _unusual(e, category)
    if not unusual and max(times, 1 / times) > SLENDER:
      reasons.append(f'far from upright ({times:.1f} times as tall as the median {category})')
    reasons += unusual
    if e.missing:
      reasons.append(f'{e.missing} files or materials missing')
    result.append(reasons)
  return result


def _unusual(e, category):
  """Proportions that are unusual for the category itself, not for the data set."""
  if category.lower() not in USUAL:
    return []
  (low, high), (narrow, broad) = USUAL[category.lower()]
  if not low <= e.uprightness <= high:
    return [
      f'seems to lie down: {e.uprightness:.1f} times as high as wide or deep, usual for a'
      f' {category}: {low:g} to {high:g} (--up)'
    ]
  if not narrow <= e.breadth <= broad:
    return [
      f'seems to face another way: {e.breadth:.1f} times as wide as deep, usual for a {category}:'
      f' {narrow:g} to {broad:g} (--turn)'
    ]
  return []


def _errors(record):
  """[V, S] distances between the voxels' colours and the colours that their flows fetch."""
  size = np.array(record.views.shape[2:0:-1])
  return np.stack(
    [
      sampling_error(view, flow * size, record.surface_color)
      for view, flow in zip(record.views, record.flow, strict=True)
    ]
  )
