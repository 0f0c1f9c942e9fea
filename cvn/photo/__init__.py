"""Any image -> the view the networks were trained on.

  reading.py   image file -> upright sRGB pixels
  masks.py     foreground mask, from alpha, ground.py or matting.py
  framing.py   foreground -> view

`load_photo` returns all results for an image, `load_view` the view alone.
"""

from typing import NamedTuple

import numpy as np
from absl import logging

from cvn import camera
from cvn.errors import UserError
from cvn.photo import framing, masks, reading

__all__ = ['Photo', 'load_photo', 'load_view']


class Photo(NamedTuple):
  """An image converted to a view."""

  view: np.ndarray  # [S, S, 4] u8, sRGB and alpha
  mask: np.ndarray  # [H, W] u8, the object in the upright picture: 0 outside
  source: str  # of the mask: 'mask', 'alpha', 'ground', 'rembg', 'grabcut' or 'framed'
  warnings: tuple[str, ...]  # whole sentences without a full stop


def load_photo(
  path: str,
  *,
  image_size: int = camera.IMAGE_SIZE,
  mask: str | None = None,
  framed: bool | None = None,
) -> Photo:
  """Reads an image, finds the object and crops it to the framing of the training views.

  Args:
    path: PNG, JPEG, WebP, AVIF, GIF (first frame), BMP, TIFF, JPEG 2000, PPM or TGA; any colour
      mode and profile, 8 to 16 bits or float; EXIF orientation is applied.
    image_size: height and width of the view.
    mask: path of a mask: an image of the same size, white (or opaque) on the object.
    framed: whether the image already has a view's framing, which is then kept; None to detect it.

  Raises:
    UserError: a file cannot be read, the mask does not fit, the image is empty (transparent or a
      single colour), or the object cannot be separated from the background.
  """
  rgba, notes = reading.read_picture(path)
  given = None if mask is None else reading.read_mask(mask, rgba.shape[:2])
  if framed and rgba.shape[:2] != (image_size, image_size):
    height, width = rgba.shape[:2]
    raise UserError(
      f'{path} has {width} x {height} pixels: a framed view has {image_size} x {image_size}'
    )
  own = None
  if framed is None and given is None:
    own = framing.find_framed(rgba, image_size)
  elif framed and given is None:
    own = framing.framed_mask(rgba)
  if own is not None and own.any():
    alpha = np.where(own, rgba[..., 3], np.uint8(0))
    view, source, doubts = np.dstack([rgba[..., :3], alpha]), 'framed', ()
  else:
    alpha, source, doubts = masks.find_mask(rgba, path, given=given)
    if framed:
      view = np.dstack([rgba[..., :3], alpha])
    else:
      view = framing.reframe(rgba[..., :3], alpha, image_size)
  warnings = tuple(f'{path} {w}' for w in (*notes, *doubts))
  return Photo(view, alpha, source, warnings)


def load_view(path: str, *, image_size: int = camera.IMAGE_SIZE) -> np.ndarray:
  """The view of `load_photo`, u8 [image_size, image_size, 4]; warnings go to the log."""
  photo = load_photo(path, image_size=image_size)
  for warning in photo.warnings:
    logging.warning('%s', warning)
  return photo.view
