"""Any picture -> the view the networks were trained on.

A view is uint8 RGBA [H, W, 4], square, colours as stored in the file, alpha 0 on the background.
Where the foreground comes from, in this order:

  1. the picture's alpha channel, when it has one that is not opaque everywhere;
  2. a plain border: what is connected to it, in its colour, is background;
  3. otherwise the whole picture counts as foreground, and a warning says so.

A picture of exactly the view's size is taken to be framed already (a data set's view). Any other is
reframed: the foreground's bounding box goes to the middle, its longer side as long as the longest
side of a normalised object at the distance of the world's origin, 77.5 of 128 pixels. That is exact
where the longest side is seen in full; how much shorter it looks from elsewhere is not known here.
"""

import warnings

import numpy as np
from absl import logging
from PIL import Image, ImageOps
from scipy import ndimage

from cvn import camera, grid
from cvn.errors import UserError

FORMATS = ('PNG', 'JPEG', 'WEBP', 'GIF', 'BMP', 'TIFF', 'PPM', 'TGA')
MAX_PIXELS = 100_000_000  # a decompression bomb otherwise

# Chosen by us; the paper has no photos.
_OPAQUE = 250  # alpha from here on counts as opaque
_SOLID = 128  # and from here on as foreground
_TOLERANCE = 16  # largest difference of a channel to the border's colour, of 255
_EXACT_TOLERANCE = 2  # the same in a picture already framed: its ground is drawn, not taken
_PLAIN_BORDER = 0.7  # part of the border that must have its colour: the object may touch the rest
_SPECK = 0.01  # parts smaller than this fraction of the largest one are noise
_WORKING_SIZE = 1024  # larger pictures are shrunk first


def load_view(path: str, *, image_size: int = camera.IMAGE_SIZE) -> np.ndarray:
  """Reads a picture and puts it into the framing of the training views.

  Args:
    path: PNG, JPEG, WebP, GIF (first frame), BMP, TIFF, PPM or TGA; any colour mode, 8 or 16 bits;
      EXIF orientation is applied.
    image_size: height and width of the result.

  Returns:
    uint8 [image_size, image_size, 4] sRGB and alpha.

  Raises:
    UserError: there is no such file, it is no picture, it is damaged or too large, or it shows
      nothing: all transparent, or all one colour.
  """
  rgba = _read(path)
  framed = rgba.shape[:2] == (image_size, image_size)
  foreground = _foreground(rgba, _EXACT_TOLERANCE if framed else _TOLERANCE, path)
  if not (rgba[..., 3] < _OPAQUE).any():
    rgba = np.dstack([rgba[..., :3], np.uint8(255) * foreground])
  return rgba if framed else _reframe(rgba, foreground, image_size)


def _read(path: str) -> np.ndarray:
  """The picture as uint8 RGBA [H, W, 4], upright, shrunk to the working size if larger."""
  try:
    with warnings.catch_warnings():
      warnings.simplefilter('ignore')  # Pillow's: on size (checked here) and on damaged metadata
      with Image.open(path, formats=FORMATS) as image:
        if image.width * image.height > MAX_PIXELS:
          raise Image.DecompressionBombError
        image.load()
        image = ImageOps.exif_transpose(image)
      if image.mode.startswith('I') or image.mode == 'F':
        deep = np.asarray(image, np.float32) / (1 if image.mode == 'F' else 65535)
        image = Image.fromarray(np.round(np.clip(deep, 0, 1) * 255).astype(np.uint8))
      rgba = image.convert('RGBA')
  except FileNotFoundError as e:
    raise UserError(f'{path}: there is no such file') from e
  except Image.DecompressionBombError as e:
    raise UserError(f'{path} has more than {MAX_PIXELS} pixels: shrink it first') from e
  except Image.UnidentifiedImageError as e:
    raise UserError(f'{path} is no picture that can be read ({", ".join(FORMATS)})') from e
  except Exception as e:  # damaged bytes make Pillow's parsers fail in every way there is
    reason = getattr(e, 'strerror', None) or str(e).split('\n', 1)[0]
    raise UserError(f'{path} cannot be read: {reason}') from e
  rgba.thumbnail((_WORKING_SIZE,) * 2, Image.Resampling.BOX)
  return np.asarray(rgba)


def _foreground(rgba: np.ndarray, tolerance: int, path: str) -> np.ndarray:
  """[H, W] bool: where the object is, without specks."""
  alpha = rgba[..., 3]
  if (alpha < _OPAQUE).any():
    mask = alpha >= _SOLID
    if not mask.any():
      raise UserError(f'{path} is transparent everywhere: there is nothing to reconstruct')
  else:
    mask = _without_plain_border(rgba[..., :3].astype(int), tolerance)
    if mask is None:
      logging.warning(
        '%s has neither transparency nor a plain background: all of it is taken as the object; '
        'give a picture with one of them',
        path,
      )
      return np.ones(alpha.shape, bool)
    if not mask.any():
      raise UserError(f'{path} is all one colour: there is nothing to reconstruct')
  label, count = ndimage.label(mask, np.ones((3, 3)))
  area = ndimage.sum_labels(mask, label, np.arange(count + 1))
  return (area >= _SPECK * area.max())[label] & mask


def _without_plain_border(rgb: np.ndarray, tolerance: int) -> np.ndarray | None:
  """[H, W] bool: all but what is connected to the border in its colour; None for a busy border."""
  border = np.concatenate([rgb[0], rgb[-1], rgb[:, 0], rgb[:, -1]])
  plain = np.median(border, axis=0)
  if (np.abs(border - plain).max(-1) <= tolerance).mean() < _PLAIN_BORDER:
    return None
  near = np.abs(rgb - plain).max(-1) <= tolerance
  label, _ = ndimage.label(near)
  touching = np.unique(np.concatenate([label[0], label[-1], label[:, 0], label[:, -1]]))
  return ~(np.isin(label, touching) & near)


def _reframe(rgba: np.ndarray, foreground: np.ndarray, image_size: int) -> np.ndarray:
  """Crops to the foreground, scales it to the training views' size and centres it."""
  rows, columns = (np.flatnonzero(foreground.any(axis)) for axis in (1, 0))
  top, bottom, left, right = rows[0], rows[-1] + 1, columns[0], columns[-1] + 1
  focal = camera.camera_at(0, image_size=image_size).K[0, 0]
  extent = focal * grid.OBJECT_EXTENT / camera.DISTANCE  # pixels
  scale = extent / max(bottom - top, right - left)
  width, height = (max(1, round(scale * x)) for x in (right - left, bottom - top))
  cut = rgba[top:bottom, left:right].copy()
  cut[..., 3] *= foreground[top:bottom, left:right] | (cut[..., 3] < _SOLID)  # drops specks
  # Pillow weighs colours by alpha when it resizes RGBA: no background bleeds into the edge.
  small = Image.fromarray(cut).resize((width, height), Image.Resampling.LANCZOS)
  view = Image.new('RGBA', (image_size, image_size))
  view.paste(small, ((image_size - width) // 2, (image_size - height) // 2))
  return np.asarray(view)
