"""Shapes of masks, [H, W] bool: bounding boxes, parts, and doubts that a shape raises."""

import numpy as np
from scipy import ndimage

# Chosen by us; the paper has no photos.
_SPECK = 0.01  # parts smaller than this fraction of the largest one are noise
_ALIKE = 0.25  # parts of at least this fraction of the largest one may be objects of their own


def bounding_box(mask: np.ndarray) -> tuple[slice, slice]:
  """(rows, columns) of a nonempty mask."""
  rows, columns = (np.flatnonzero(mask.any(axis)) for axis in (1, 0))
  return slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)


def without_specks(mask: np.ndarray) -> np.ndarray:
  """The mask without parts far smaller than its largest one."""
  label, count = ndimage.label(mask, np.ones((3, 3)))
  area = ndimage.sum_labels(mask, label, np.arange(count + 1))
  return (area >= _SPECK * area.max())[label] & mask


def without_open(ground: np.ndarray) -> np.ndarray:
  """Everything but the part of a background that is connected to the image's border."""
  label, _ = ndimage.label(ground)
  edge = border(label)
  return ~np.isin(label, np.unique(edge[edge > 0]))


def doubts(mask: np.ndarray) -> list[str]:
  """Doubts raised by a mask's shape alone, as ends of sentences.

  Args:
    mask: [H, W], not empty.
  """
  found = []
  label, count = ndimage.label(mask, np.ones((3, 3)))
  area = ndimage.sum_labels(mask, label, np.arange(1, count + 1))
  alike = int((area >= _ALIKE * area.max()).sum())
  if alike > 1:
    found.append(f'shows {alike} separate parts of similar size: one object is expected')
  touching = [side.mean() for side in (mask[0], mask[-1], mask[:, 0], mask[:, -1])]
  if max(touching) > 0.05 or (np.array(touching) > 0.02).sum() > 1:
    found.append('shows an object that touches the edge: it may be cut off, or background')
  rows, columns = bounding_box(mask)
  height, width = rows.stop - rows.start, columns.stop - columns.start
  if mask[rows, columns].mean() > 0.97 and height * width > 0.25 * mask.size:
    found.append('shows an object that fills a rectangle: it may be a frame or a backdrop')
  if max(height, width) < 24:
    found.append(f'shows an object of only {width} x {height} pixels')
  return found


def border(values: np.ndarray) -> np.ndarray:
  """The values along the four sides: [2 W + 2 H, ...] of [H, W, ...]."""
  return np.concatenate([values[0], values[-1], values[:, 0], values[:, -1]])
