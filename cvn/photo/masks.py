"""The foreground mask of an image. The first of these that applies:

1. the user's mask;
2. the alpha channel, if it cuts out an object; rounded corners of a window or a few transparent
   pixels do not count;
3. a plain or smoothly shaded background (cvn/photo/ground.py);
4. the network of `rembg`, if that package is installed;
5. GrabCut from the central box, if OpenCV is installed;
6. an error that says what to do.
"""

from typing import NamedTuple

import numpy as np
from PIL import Image
from scipy import ndimage

from cvn.errors import UserError
from cvn.photo import ground, matting, regions

# Chosen by us; the paper has no photos.
OPAQUE = 250  # alpha from here on counts as opaque
SOLID = 128  # and from here on as the object
_FAINT = 32  # the least alpha of an object that is transparent all over
_MARGIN = 0.3  # around an object that is searched again, of its longer side
_LEAST_SIDE = 64  # smaller pictures are searched enlarged
_WORKING_PIXELS = 512 * 512  # larger pictures are searched at this size


class Mask(NamedTuple):
  """An object in an image of H x W pixels."""

  alpha: np.ndarray  # [H, W] u8: 0 outside of the object, soft at the edge of a cut-out
  source: str  # 'mask', 'alpha', 'ground', 'rembg' or 'grabcut'
  warnings: tuple[str, ...]  # ends of sentences that begin with the file's name


def find_mask(rgba: np.ndarray, path: str, *, given: np.ndarray | None = None) -> Mask:
  """Finds the object.

  Args:
    rgba: [H, W, 4] u8.
    path: path of the image, for messages.
    given: [H, W] bool, the user's mask.

  Raises:
    UserError: the image is transparent or a single colour, or the object cannot be separated from a
      busy background.
  """
  if given is not None:
    soft = rgba[..., 3] if (rgba[..., 3] < OPAQUE).any() else np.uint8(255)
    alpha = np.where(given, soft, np.uint8(0))
    if not alpha.any():
      raise UserError(f'{path} is transparent wherever its mask is white')
    return Mask(alpha, 'mask', tuple(regions.doubts(given)))
  if (rgba[..., 3] < OPAQUE).any():
    return _from_alpha(rgba, path)
  return _search(rgba[..., :3], path)


def _from_alpha(rgba, path):
  alpha, warnings = rgba[..., 3], []
  highest = int(np.percentile(alpha[alpha >= _FAINT], 95)) if (alpha >= _FAINT).any() else 0
  if highest == 0:
    raise UserError(
      f'{path} is transparent everywhere (alpha is at most {alpha.max()} of 255): there is nothing'
      ' to reconstruct'
    )
  if highest < 2 * SOLID - 56:  # glass: what is most opaque is taken as solid
    warnings.append(f'shows a transparent object (alpha {highest} of 255): taken as opaque')
    alpha = np.minimum(255, alpha.astype(int) * 255 // highest).astype(np.uint8)
  solid = regions.without_specks(alpha >= SOLID)
  if not solid.any():
    raise UserError(f'{path} is transparent everywhere: there is nothing to reconstruct')
  rows, columns = box = regions.bounding_box(solid)
  if solid[box].mean() > 0.9:  # a window or a whole picture: its object may lie inside
    nearest = ndimage.distance_transform_edt(
      ~solid[box], return_distances=False, return_indices=True
    )
    try:
      inner = _search(rgba[box][..., :3][tuple(nearest)], path, only_ground=True)
    except UserError:
      inner = None
    if inner is not None:
      whole = np.zeros_like(alpha)
      whole[rows, columns] = np.minimum(inner.alpha, alpha[box])
      return inner._replace(alpha=whole)
    warnings.append(
      'has an alpha channel in the shape of a rectangle: all of it is taken as the object'
    )
  # Soft shadows and the noise of matting networks go; the soft edge stays.
  edge = ndimage.binary_dilation(solid, np.ones((3, 3)), 2)
  return Mask(np.where(edge, alpha, np.uint8(0)), 'alpha', (*warnings, *regions.doubts(solid)))


def _search(rgb, path, *, only_ground=False):
  """The object of an opaque image; None if there is none and only the background may decide."""
  small = _resize(rgb)
  found = ground.find_object(small)
  if found is not None and not found.mask.any():
    raise UserError(f'{path} is a single colour: there is nothing to reconstruct')
  if found is not None and (found.sure or only_ground):
    if small.size < rgb.size:
      found = _closer(rgb, found)
    return _fitted(found.mask, rgb, 'ground', found.warnings)
  if only_ground:
    return None
  notes = []
  for name, method in (('rembg', matting.by_rembg), ('grabcut', matting.by_grabcut)):
    if name == 'grabcut' and found is not None:
      break  # a ground that the object covers in part is better than a guess
    try:
      mask = method(small)
    except matting.UnavailableError as e:
      notes.append(str(e))
      continue
    if mask is not None and mask.any():
      mask = regions.without_specks(mask)
      guess = f'has a busy background: {name} guessed the object, check the mask'
      return _fitted(mask, rgb, name, (guess, *regions.doubts(mask)))
  if found is not None:
    return _fitted(found.mask, rgb, 'ground', found.warnings)
  why = f' ({"; ".join(notes)})' if notes else ''
  raise UserError(
    f'{path}: the object cannot be separated from the background{why}: use a plain background,'
    ' a cut-out (PNG with transparency) or --mask=FILE'
  )


def _closer(rgb, found):
  """Searches the object's surroundings again, if they can be searched at a finer scale."""
  height, width = rgb.shape[:2]
  scale = np.array([height, width]) / found.mask.shape
  rows, columns = regions.bounding_box(found.mask)
  margin = _MARGIN * max(rows.stop - rows.start, columns.stop - columns.start) + 4
  (top, bottom), (left, right) = (
    (max(0, int(k * (s.start - margin))), min(n, int(k * (s.stop + margin)) + 1))
    for k, s, n in zip(scale, (rows, columns), (height, width), strict=True)
  )
  if (bottom - top) * (right - left) > 0.25 * height * width:
    return found
  crop = rgb[top:bottom, left:right]
  inner = ground.find_object(_resize(crop))
  if inner is None or not inner.sure or not inner.mask.any():
    return found
  mask = np.zeros((height, width), bool)
  mask[top:bottom, left:right] = _fitted(inner.mask, crop, '', ()).alpha > 0
  return inner._replace(mask=mask)


def _resize(rgb):
  """Shrinks large images for speed, and enlarges tiny ones with square pixels."""
  height, width = rgb.shape[:2]
  times = -(-_LEAST_SIDE // min(height, width))
  if times > 1 and height * width * times**2 <= _WORKING_PIXELS:
    return rgb.repeat(times, 0).repeat(times, 1)
  scale = (_WORKING_PIXELS / (height * width)) ** 0.5
  if scale >= 1:
    return rgb
  size = max(1, round(scale * width)), max(1, round(scale * height))
  return np.asarray(Image.fromarray(rgb).resize(size, Image.Resampling.BOX))


def _fitted(mask, rgb, source, warnings):
  alpha = Image.fromarray(np.uint8(255) * mask)
  if alpha.size != (rgb.shape[1], rgb.shape[0]):
    alpha = alpha.resize((rgb.shape[1], rgb.shape[0]), Image.Resampling.BILINEAR)
    alpha = alpha.point(lambda x: 255 * (x >= SOLID))
  return Mask(np.asarray(alpha), source, tuple(warnings))
