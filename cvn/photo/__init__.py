"""Any picture -> the view the networks were trained on.

  reading.py   the file -> upright sRGB pixels
  masks.py     where the object is, by alpha, ground.py or matting.py
  framing.py   the object -> a view

`load_photo` tells everything about a picture, `load_view` returns the view alone.
"""

from typing import NamedTuple

import numpy as np
from absl import logging

from cvn import camera
from cvn.errors import UserError
from cvn.photo import framing, masks, reading

__all__ = ['Photo', 'load_photo', 'load_view']


class Photo(NamedTuple):
  """A picture that was made a view."""

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
  """Reads a picture, finds its object and puts it into the framing of the training views.

  Args:
    path: PNG, JPEG, WebP, AVIF, GIF (first frame), BMP, TIFF, JPEG 2000, PPM or TGA; any colour
      mode and profile, 8 to 16 bits or float; EXIF orientation is applied.
    image_size: height and width of the view.
    mask: a picture of the same size, white (or opaque) where the object is.
    framed: whether the picture is a view already, whose framing stays; None: where it looks so.

  Raises:
    UserError: a file cannot be read, the mask does not fit, the picture shows nothing (all
      transparent, or all one colour), or nothing tells its object from the background.
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
