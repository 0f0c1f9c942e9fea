"""The object on a plain or smoothly shaded background (ground).

The background is everything that smooth shading connects to the image's border: studio gradients,
vignettes and soft shadows have no edge, while an object has one even if it is as pale as the
background. In detail:

  1. letter boxes and frames are cut off;
  2. a flood from the border stops at edges, found by a band-pass filter, and at colours that are
     not a lighter or darker shade of the background's;
  3. beyond the flood, a pixel belongs to the object if it differs from the nearest background by
     more than the noise, and by more than half of its neighbours' difference;
  4. enclosed areas with exactly the background's colour are gaps.

Images are float32 [H, W, 3], values 0 to 255; masks are bool [H, W]. The constants are our choice;
the paper has no photos.
"""

from typing import NamedTuple

import numpy as np
from scipy import ndimage

from cvn.photo.flood import (
  estimate_noise,
  extend,
  find_grounds,
  find_smooth,
  is_shade,
  largest,
)
from cvn.photo.regions import border, bounding_box, doubts, without_open, without_specks

_PLAIN = 0.35  # share of the border that must be ground
_SURE = 0.7  # from here on, nothing else can be the ground
_NOISY = 10  # standard deviation of the noise: above it nothing is smooth
_PIECES = 8  # of an object along the border; a pattern has more
_STRONG = 40  # a contrast around which codecs leave traces
_STEEP = 4  # largest slope of a shadow, in levels a pixel
_LINE = 6  # how far ground goes on beyond what was found of it, in pixels


class Found(NamedTuple):
  """An object and the doubts about it."""

  mask: np.ndarray  # [H, W] bool
  warnings: tuple[str, ...]  # ends of sentences that begin with the file's name
  sure: bool  # whether most of the border is ground


def find_object(rgb: np.ndarray) -> Found | None:
  """The object in front of a plain or smoothly shaded background.

  Args:
    rgb: [H, W, 3], u8.

  Returns:
    The object, with an empty mask if the whole image is background; None if the border shows no
    such background.
  """
  image = np.asarray(rgb, np.float32)
  box = _inside_of_frame(image)
  if box is not None:
    inner = _find(image[box])
    if inner is not None and inner.mask.any():
      mask = np.zeros(image.shape[:2], bool)
      mask[box] = inner.mask
      return inner._replace(
        mask=mask, warnings=('has a frame or letter box, which was cut off', *inner.warnings)
      )
  return _find(image)


def _find(image):
  noise = estimate_noise(image)
  if noise > _NOISY or min(image.shape[:2]) < 4:
    return None
  smooth = find_smooth(image, noise)
  grounds = find_grounds(image, smooth, noise)
  if not grounds:
    return None
  ground = np.any(grounds, axis=0)
  share = border(ndimage.binary_dilation(ground, np.ones((3, 3)))).mean()
  if share < _PLAIN:
    return None
  calm = ndimage.median_filter(image, (3, 3, 1)) if noise >= 0.5 else image
  difference = _difference(calm, grounds)
  tolerance = max(2.0, 4 * noise)
  near, traces, limit = _limits(calm, difference, ground, tolerance)
  unlike = difference > limit
  label, count = ndimage.label(~unlike | ground)
  open_ground = np.isin(label, np.unique(label[ground])) & (label > 0)
  mask = ~open_ground
  mask, gaps = _without_gaps(mask, label, count, difference, max(tolerance, traces))
  if (difference > _STRONG).any():
    hairs = mask & ~ndimage.binary_opening(mask, np.ones((3, 3)))
    mask &= ~(hairs & (difference < 0.5 * _STRONG))
  if not mask.any():
    return Found(mask, (), bool(share >= _SURE))
  mask = without_specks(mask)
  if (np.diff(border(mask).astype(int)) == 1).sum() > _PIECES:
    return None
  # What joins two parts of the object and is not quite ground belongs to it.
  mask |= ndimage.binary_closing(mask, np.ones((3, 3)), 3) & (difference > max(tolerance, traces))
  warnings = doubts(mask)
  if len(grounds) > 1:
    warnings.append('has a background in two parts (wall and floor?): both are left out')
  if gaps:
    warnings.append(f'has {gaps} enclosed areas in the colour of its background: taken as gaps')
  edge = mask & ~ndimage.binary_erosion(mask, border_value=1)
  if edge.any() and np.percentile(near[edge], 25) < 12:
    warnings.append('shows an object that hardly differs from its background: parts may be missing')
  if _may_be_shadow(image, mask, extend(calm, ground), noise):
    warnings.append(
      "shows a dark part in its background's hue below the object: it may be a shadow"
    )
  return Found(mask, tuple(warnings), bool(share >= _SURE))


def _difference(image, grounds):
  """Difference between a pixel and the nearest background, or a mixture where two of them meet."""
  local = [extend(image, g) for g in grounds]
  difference = np.min([largest(image - x) for x in local], axis=0)
  if len(grounds) > 1:
    first, second = local[:2]
    line = np.all([ndimage.distance_transform_edt(~g) <= _LINE for g in grounds[:2]], axis=0)
    along = second - first
    length = np.maximum((along * along).sum(-1, keepdims=True), 1e-6)
    share = np.clip(((image - first) * along).sum(-1, keepdims=True) / length, 0, 1)
    mixed = largest(image - first - share * along)
    difference = np.where(line, np.minimum(mixed, difference), difference)
  return difference


def _limits(image, difference, ground, tolerance):
  """Contrast within 3 pixels, codec artefacts, and the tolerance of the background near the object.

  Near the object, shading continues with its slope. The blur of an edge (half of the contrast) and
  codec artefacts around it also belong to the background.
  """
  near = ndimage.maximum_filter(difference, 7)
  away, nearest = ndimage.distance_transform_edt(~ground, return_indices=True)
  low = ndimage.gaussian_filter(image, (2, 2, 0))
  slope = largest(np.hypot(*np.gradient(low, axis=(0, 1))))[tuple(nearest)]
  limit = tolerance + 1.5 * np.minimum(slope, _STEEP) * away * (away <= _LINE)
  strong = difference > _STRONG
  blurred, traces = away <= 3, 0
  if strong.any():
    beyond = ndimage.distance_transform_edt(~strong)
    around = difference[(beyond > 2.5) & (beyond <= 8)]
    traces = min(2 * np.percentile(around, 90), 0.5 * _STRONG) if around.size else 0
    limit = np.maximum(limit, traces * (beyond <= 16))
    blurred |= beyond <= 3
  return near, traces, np.maximum(limit, 0.5 * near * blurred)


def _without_gaps(mask, label, count, difference, tolerance):
  """The mask without gaps, and the number of gaps.

  A gap is an enclosed area that partly has exactly the background's colour and is outlined by an
  edge; a highlight of that colour fades into the object.
  """
  numbers = np.arange(1, count + 1)
  inside = mask & (label > 0)
  area = ndimage.sum_labels(inside, label, numbers)
  share = ndimage.sum_labels(inside & (difference <= tolerance), label, numbers)
  share /= np.maximum(area, 1)
  gaps = []
  for number in numbers[(area >= max(9, 0.002 * mask.sum())) & (share >= 0.2)]:
    core = (label == number) & (difference <= tolerance)
    close, wide = (ndimage.binary_dilation(core, np.ones((3, 3)), n) & mask & ~core for n in (3, 9))
    if np.percentile(difference[close], 75) >= 0.5 * np.percentile(difference[wide], 75):
      gaps.append(number)
  return mask & ~np.isin(label, gaps), len(gaps)


def _may_be_shadow(image, mask, ground, noise):
  """Whether much of the mask's lower half is a darker shade of the background."""
  rows, _ = bounding_box(mask)
  low = mask.copy()
  low[: (rows.start + rows.stop) // 2] = False
  level, base = image.mean(-1), ground.mean(-1)
  shade = is_shade(image, ground, noise) & mask
  dark = shade & low & (level < 0.95 * base) & (level > 0.5 * base)
  return bool(dark.sum() > 0.15 * mask.sum() and shade.sum() < 0.6 * mask.sum())


def _inside_of_frame(image):
  """(rows, columns) inside bars at two opposite sides or inside a thin frame; None without them."""
  height, width = image.shape[:2]
  for side in (image[:, 0], image[0]):
    color = np.median(side, axis=0)
    bars = largest(image - color) <= 12
    rest = without_open(bars)
    if not rest.any():
      continue
    rest = without_specks(rest)
    rows, columns = bounding_box(rest)
    top, left = rows.start, columns.start
    bottom, right = height - rows.stop, width - columns.stop
    box = rest[rows, columns]
    bar = (top + bottom == 0 and left and right) or (left + right == 0 and top and bottom)
    frame = (
      0 < min(top, bottom, left, right)
      and max(top / height, bottom / height, left / width, right / width) <= 0.15
    )
    if not (bar or frame) or box.mean() < 0.98 or box.size < 0.2 * rest.size:
      continue
    inside = slice(rows.start + 2, rows.stop - 2), slice(columns.start + 2, columns.stop - 2)
    if min(image[inside].shape[:2]) < 8:
      continue
    rim = border(image[inside])
    plain = largest(rim - np.median(rim, axis=0)) <= 16
    if plain.mean() >= 0.5:
      return inside
  return None
