"""Augmentation of training elements: horizontal flips and colour jitter.

An element is one of a `data.Batch` or `data.ShapeBatch` as stored, without the batch axis: image
[H, W, 4] uint8, index [S, 3] uint8, padded with PADDING_INDEX, and for the colour network color
[S, 3] uint8 and flow [S, 2] uint16. Both augmentations change image and object alike, so that the
result is an element of another object.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from cvn import dataset, grid


def mirrored(element: Any, *, grid_size: int) -> Any:
  """The element of the object mirrored in x: horizontal-flip augmentation.

  Flipped from left to right, the view from azimuth a is the mirrored object's view from -a.

  Args:
    element: as stored.
    grid_size: of the data set.

  Returns:
    An element of the same type.
  """
  index = element.index.copy()
  real = index[:, 0] != grid.PADDING_INDEX
  index[real, 0] = grid_size - 1 - index[real, 0]
  element = element._replace(image=np.ascontiguousarray(element.image[:, ::-1]), index=index)
  if 'flow' not in element._fields:
    return element
  flow = element.flow.copy()
  flow[real, 0] = dataset.encode_flow(1) - flow[real, 0]
  return element._replace(flow=flow)


def draw_colors(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
  """A random colour jitter, (order, ends) for `recolored`.

  Red, green and blue change places. For one element in two each of them also runs between other
  ends, at least 0.5 apart, rising or falling: colours that differed still do.

  Args:
    rng: the random generator.

  Returns:
    (order [3], ends [3, 2]).
  """
  order = rng.permutation(3)
  if rng.integers(2):
    return order, np.array([[0.0, 1.0]] * 3)
  low = rng.uniform(0, 0.5, 3)
  ends = np.stack([low, rng.uniform(low + 0.5, 1)], 1)
  return order, np.where(rng.integers(2, size=(3, 1)), ends, ends[:, ::-1])


def recolored(element: Any, *, order: Sequence[int], ends: np.ndarray) -> Any:
  """The element in other colours, the same in the image and on the surface: colour jitter.

  Views show albedo without light, so this is the object's view had it been painted so. The
  background is grey and stays grey.

  Args:
    element: as stored.
    order: a permutation of (0, 1, 2): channel c becomes what channel order[c] was.
    ends: [3, 2] in [0, 1], what 0 and 1 of each channel then become.

  Returns:
    An element of the same type.
  """
  table = np.round(255 * np.linspace(*np.transpose(ends), 256)).astype(np.uint8)  # [256, 3]

  def paint(colors):
    return table[colors[..., order], np.arange(3)]

  image = np.concatenate([paint(element.image[..., :3]), element.image[..., 3:]], -1)
  element = element._replace(image=image)
  if 'color' not in element._fields:
    return element
  real = element.index[:, :1] != grid.PADDING_INDEX
  return element._replace(color=np.where(real, paint(element.color), 0))
