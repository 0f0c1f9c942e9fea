"""From an object in an image to a view.

A view is u8 RGBA [S, S, 4], square, sRGB, alpha 0 on the background. The object's bounding box is
centred, its longer side as long as the longest side of a normalised object at the distance of the
world's origin, 77.5 of 128 pixels. That is exact if the longest side is seen in full; how much
shorter it looks from elsewhere is unknown.
"""

import numpy as np
from PIL import Image

from cvn import camera, grid
from cvn.photo import regions

_EXACT = 2  # largest difference of a drawn ground to its colour, of 255; a photo's differs by more
_CENTER = 0.09  # largest distance of an object's centre from a view's, by perspective; of its size
_SMALLEST = 0.15  # the longer side of an object in a view, of the view's size


def find_framed(rgba: np.ndarray, image_size: int) -> np.ndarray | None:
  """The object's mask if an image looks like a data set's view, otherwise None.

  Such a view has the networks' size and a background that is transparent or exactly one colour,
  with the object centred and clear of the edges.

  Args:
    rgba: [H, W, 4] u8.
    image_size: height and width of the views.
  """
  if rgba.shape[:2] != (image_size, image_size):
    return None
  mask = framed_mask(rgba)
  if mask is None or not mask.any():
    return None
  rows, columns = regions.bounding_box(mask)
  middle = 0.5 * image_size
  off = max(abs(0.5 * (s.start + s.stop) - middle) for s in (rows, columns))
  longer = max(s.stop - s.start for s in (rows, columns))
  clear = all(0 < s.start and s.stop < image_size for s in (rows, columns))
  fits = off <= _CENTER * image_size and longer >= _SMALLEST * image_size and clear
  return mask if fits else None


def framed_mask(rgba: np.ndarray) -> np.ndarray | None:
  """The object's mask [H, W] on a background of exactly one colour; otherwise None."""
  if rgba[..., 3].min() < 255:
    border = np.concatenate([rgba[0], rgba[-1], rgba[:, 0], rgba[:, -1]])[..., 3]
    return rgba[..., 3] > 0 if (border == 0).mean() > 0.5 else None
  rgb = rgba[..., :3].astype(int)
  border = np.concatenate([rgb[0], rgb[-1], rgb[:, 0], rgb[:, -1]])
  plain = np.median(border, axis=0)
  difference = np.abs(rgb - plain).max(-1)
  almost = (difference > 0) & (difference <= _EXACT)  # a codec's traces
  if (np.abs(border - plain).max(-1) == 0).mean() < 0.7 or almost.mean() > 0.01:
    return None
  return regions.without_open(difference <= _EXACT)


def reframe(rgb: np.ndarray, alpha: np.ndarray, image_size: int) -> np.ndarray:
  """Crops to the object, scales it to the training views' size and centres it.

  Args:
    rgb: [H, W, 3] u8.
    alpha: [H, W] u8, 0 outside the object.
    image_size: height and width of the view.

  Returns:
    u8 [image_size, image_size, 4].
  """
  solid = alpha >= 128
  rows, columns = regions.bounding_box(solid if solid.any() else alpha > 0)
  shape = rows.stop - rows.start, columns.stop - columns.start
  focal = camera.camera_at(0, image_size=image_size).K[0, 0]
  extent = focal * grid.OBJECT_EXTENT / camera.DISTANCE  # pixels
  height, width = (max(1, round(extent * side / max(shape))) for side in shape)
  cut = np.dstack([rgb[rows, columns], alpha[rows, columns]])
  # Pillow weighs colours by alpha when it resizes RGBA: no background bleeds into the edge.
  # Enlarged ones are interpolated linearly: the others would make colours that are not there.
  larger = extent > max(shape)
  filtered = Image.Resampling.BILINEAR if larger else Image.Resampling.LANCZOS
  small = Image.fromarray(cut).resize((width, height), filtered)
  view = Image.new('RGBA', (image_size, image_size))
  view.paste(small, ((image_size - width) // 2, (image_size - height) // 2))
  return np.asarray(view)
