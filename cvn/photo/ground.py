"""The object on a plain or smoothly shaded ground.

The ground is what smooth shading connects to the picture's border: gradients of a studio, vignettes
and soft shadows have no edge, while the object has one even where it is as pale as the ground. In
detail:

  1. letter boxes and frames are cut off;
  2. pixels where a band-pass filter finds an edge stop a flood from the border; so does a colour
     that is no lighter or darker shade of the ground's;
  3. beyond the flood, a pixel belongs to the object if it differs from the nearest ground by more
     than the noise and by more than half of what its neighbours differ;
  4. enclosed areas in the ground's very colour are gaps.

Images are float32 [H, W, 3], values 0 to 255; masks are bool [H, W]. The constants are chosen by
us; the paper has no photos.
"""

from typing import NamedTuple

import numpy as np
from scipy import ndimage

_PLAIN = 0.35  # share of the border that must be ground
_SURE = 0.7  # from here on, nothing else can be the ground
_NOISY = 10  # standard deviation of the noise: above it nothing is smooth
_CLEAN = (0.0, 2.0, 1.2, 0.35)  # radii of the band-pass filter, its limit, and that for a slope
_GRAINY = (1.5, 4.0)  # radii where there is noise
_HUE = 10  # largest deviation of a shade of the ground from the ground's colour, scaled
_SHADOW, _BRIGHTER = 0.35, 1.06  # shades of the ground, as parts of its brightness
_STRONG = 40  # a contrast around which codecs leave traces
_LINE = 6  # half the width of the line where two grounds meet, in pixels
_LEAK = 1  # half the width of the holes in an edge that the flood does not pass, in pixels
_SPECK = 0.01  # parts smaller than this fraction of the largest one are noise
_ALIKE = 0.25  # parts of at least this fraction of the largest one may be objects of their own


class Found(NamedTuple):
  """An object and what is doubtful about it."""

  mask: np.ndarray  # [H, W] bool
  warnings: tuple[str, ...]  # ends of sentences that begin with the file's name
  sure: bool  # whether most of the border is ground


def find_object(rgb: np.ndarray) -> Found | None:
  """The object in front of a plain or smoothly shaded ground.

  Args:
    rgb: [H, W, 3], u8.

  Returns:
    The object, all False in the mask where the whole picture is ground; None where the border
    shows no such ground.
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


def without_specks(mask: np.ndarray) -> np.ndarray:
  """The mask without parts far smaller than its largest one."""
  label, count = ndimage.label(mask, np.ones((3, 3)))
  area = ndimage.sum_labels(mask, label, np.arange(count + 1))
  return (area >= _SPECK * area.max())[label] & mask


def without_open(ground: np.ndarray) -> np.ndarray:
  """The mask of all but the part of a ground that is connected to the picture's border."""
  label, _ = ndimage.label(ground)
  edge = _border(label)
  return ~np.isin(label, np.unique(edge[edge > 0]))


def doubts(mask: np.ndarray) -> list[str]:
  """What a mask's form alone makes doubtful, as ends of sentences.

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
  if max(touching) > 0.1 or (np.array(touching) > 0.02).sum() > 1:
    found.append('shows an object that touches the edge: it may be cut off, or background')
  rows, columns = bounding_box(mask)
  height, width = rows.stop - rows.start, columns.stop - columns.start
  if mask[rows, columns].mean() > 0.97 and height * width > 0.25 * mask.size:
    found.append('shows an object that fills a rectangle: it may be a frame or a backdrop')
  if max(height, width) < 24:
    found.append(f'shows an object of only {width} x {height} pixels')
  return found


def bounding_box(mask: np.ndarray) -> tuple[slice, slice]:
  """(rows, columns) of a mask that is not empty."""
  rows, columns = (np.flatnonzero(mask.any(axis)) for axis in (1, 0))
  return slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)


def _find(image):
  noise = _noise(image)
  if noise > _NOISY or min(image.shape[:2]) < 4:
    return None
  smooth = _smooth(image, noise)
  regions, _ = ndimage.label(smooth)
  grounds = _grounds(image, regions, smooth, noise)
  if not grounds:
    return None
  ground = np.any(grounds, axis=0)
  share = _border(ndimage.binary_dilation(ground, np.ones((3, 3)))).mean()
  if share < _PLAIN:
    return None
  calm = ndimage.median_filter(image, (3, 3, 1)) if noise >= 0.5 else image
  local = _extend(calm, ground)
  difference = _difference(calm, local, grounds)
  tolerance = max(2.0, 4 * noise)
  near, traces, limit = _limits(difference, ground)
  unlike = difference > np.maximum(tolerance, limit)
  label, count = ndimage.label(~unlike | ground)
  open_ground = np.isin(label, np.unique(label[ground])) & (label > 0)
  mask = ~open_ground
  mask, gaps = _without_gaps(mask, label, count, difference <= max(tolerance, traces), smooth)
  if not mask.any():
    return Found(mask, (), bool(share >= _SURE))
  # What joins two parts of the object and is not quite ground belongs to it.
  mask |= ndimage.binary_closing(mask, np.ones((3, 3)), 3) & (difference > max(tolerance, traces))
  if (difference > _STRONG).any():
    hairs = mask & ~ndimage.binary_opening(mask, np.ones((3, 3)))
    mask &= ~(hairs & (difference < 0.5 * _STRONG))
  mask = without_specks(mask)
  warnings = doubts(mask)
  if len(grounds) > 1:
    warnings.append('has a ground in two parts (wall and floor?): both are left out')
  if gaps:
    warnings.append(f'has {gaps} enclosed areas in the colour of its ground: taken as gaps')
  edge = mask & ~ndimage.binary_erosion(mask, border_value=1)
  if edge.any() and np.percentile(near[edge], 25) < 12:
    warnings.append('shows an object that hardly differs from its ground: parts may be missing')
  if _may_be_shadow(image, mask, local, noise):
    warnings.append("shows a dark part in its ground's hue below the object: it may be a shadow")
  return Found(mask, tuple(warnings), bool(share >= _SURE))


def _noise(image):
  """The standard deviation of the noise, from the calmer half of the picture's border."""
  width = max(2, round(0.03 * min(image.shape[:2])))
  residual = np.abs(image - ndimage.gaussian_filter(image, (1.5, 1.5, 0))).max(-1)
  ring = np.ones(residual.shape, bool)
  ring[width:-width, width:-width] = False
  return float(np.median(residual[ring])) / 1.2


def _smooth(image, noise):
  """Where there is no edge.

  An edge answers to a band-pass filter by more than noise and more than a blurred one (a shadow's)
  would, whose answer is small beside its slope.
  """
  fine, coarse, limit, per_slope = _CLEAN if noise < 0.5 else (*_GRAINY, max(1.2, 0.8 * noise), 0.9)
  low = ndimage.gaussian_filter(image, (coarse, coarse, 0))
  band = np.abs(ndimage.gaussian_filter(image, (fine, fine, 0)) - low).max(-1)
  slope = np.hypot(*np.gradient(low, axis=(0, 1))).max(-1)
  return band <= limit + per_slope * slope


def _grounds(image, regions, smooth, noise):
  """Masks of the ground: one, or two where wall and floor meet in a line across the picture."""
  sides = [regions[0], regions[-1], regions[:, 0], regions[:, -1]]
  contact = np.bincount(np.concatenate(sides), minlength=regions.max() + 1)
  contact[0] = 0
  if not contact.any():
    return []
  main = int(contact.argmax())
  # A strip: it holds one side's corners and most of that side.
  neighbours = ((2, 3), (2, 3), (0, 1), (0, 1))
  strips = [
    int(side[0])
    for side, (a, b) in zip(sides, neighbours, strict=True)
    if side[0] == side[-1] != main
    and side[0] > 0
    and (side == side[0]).mean() > 0.6
    and all((sides[n] == side[0]).mean() < 0.6 for n in (a, b))
  ]
  ring = np.ones(regions.shape, bool)
  margin = max(1, round(0.04 * min(regions.shape)))
  ring[margin:-margin, margin:-margin] = False
  found = []
  for seed in dict.fromkeys([main, *strips]):
    own = regions == seed
    model = _fit(image, own & ring)
    flood = _flood(image, model, own, smooth, noise, 1.2)
    if flood.any():  # the border alone does not tell how bright the middle is
      model = _fit(image, flood)
      flood = _flood(image, model, own, smooth, noise, _BRIGHTER)
    found.append(flood)
  return [g for g in found if g.any()]


def _flood(image, model, own, smooth, noise, brightest):
  """Smooth shades of the ground that are connected to where it touches the border."""
  shade = smooth & _is_shade(image, model, noise, brightest)
  label, _ = ndimage.label(ndimage.binary_erosion(shade, np.ones((3, 3)), _LEAK, border_value=1))
  near = np.abs(image - model).max(-1) <= max(16, 3 * noise)
  edge = _border(label)
  touching = np.unique(edge[_border(near | own) & (edge > 0)])
  flood = np.isin(label, touching) & (label > 0)
  return ndimage.binary_dilation(flood, np.ones((3, 3)), _LEAK) & shade


def _border(values):
  return np.concatenate([values[0], values[-1], values[:, 0], values[:, -1]])


def _fit(image, region):
  """The ground's colour everywhere: a parabola in x and y, from a region of it."""
  height, width = region.shape
  v, u = np.mgrid[0:height, 0:width].astype(np.float32)
  u, v = 2 * u / max(1, width - 1) - 1, 2 * v / max(1, height - 1) - 1
  terms = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], -1)
  at = np.flatnonzero(region.ravel())
  at = at[:: max(1, len(at) // 4000)]
  a, b = terms.reshape(-1, 6)[at], image.reshape(-1, 3)[at]
  damping = 1e-3 * len(at) * np.diag([0, 0, 0, 1, 1, 1])  # a region in one corner bends nothing
  weights = np.ones(len(at), np.float32)
  for _ in range(3):
    w = a * weights[:, None]
    solution = np.linalg.solve(w.T @ a + damping + 1e-6 * np.eye(6), w.T @ b)
    weights = 1 / (1 + (np.abs(a @ solution - b).max(-1) / 8) ** 2)
  return np.clip(terms @ solution.astype(np.float32), 0, 255)


def _is_shade(image, model, noise, brightest=_BRIGHTER):
  """Where a colour is the ground's, in shadow or a little brighter."""
  scale = (image * model).sum(-1) / np.maximum((model * model).sum(-1), 1)
  dark = model.max(-1) < 24
  scale = np.where(dark, 1, scale)
  hue = np.abs(image - scale[..., None] * model).max(-1)
  return (hue <= max(_HUE, 4 * noise)) & (scale >= _SHADOW) & (scale <= brightest)


def _extend(image, ground):
  """The ground's colour, smoothed a little, and beyond the ground that of its nearest pixel."""
  weight = ground.astype(np.float32)
  total = np.maximum(ndimage.gaussian_filter(weight, 2), 1e-6)
  own = ndimage.gaussian_filter(image * weight[..., None], (2, 2, 0)) / total[..., None]
  nearest = ndimage.distance_transform_edt(~ground, return_distances=False, return_indices=True)
  return own[tuple(nearest)]


def _difference(image, local, grounds):
  """How much a pixel differs from the nearest ground.

  Where two grounds meet, from the nearest mixture of them.
  """
  difference = np.abs(image - local).max(-1)
  if len(grounds) > 1:
    first, second = (_extend(image, g) for g in grounds[:2])
    line = np.all([ndimage.distance_transform_edt(~g) <= _LINE for g in grounds[:2]], axis=0)
    along = second - first
    length = np.maximum((along * along).sum(-1, keepdims=True), 1e-6)
    share = np.clip(((image - first) * along).sum(-1, keepdims=True) / length, 0, 1)
    mixed = np.abs(image - first - share * along).max(-1)
    difference = np.where(line, np.minimum(mixed, difference), difference)
  return difference


def _limits(difference, ground):
  """Contrast within 3 pixels, the trace of a codec, and how much ground may differ near the object.

  There, an edge's blur (half of the contrast) and what a codec leaves around it are ground as well.
  """
  near = ndimage.maximum_filter(difference, 7)
  strong = difference > _STRONG
  if not strong.any():
    return near, 0, 0.5 * near * (ndimage.distance_transform_edt(~ground) <= 3)
  beyond = ndimage.distance_transform_edt(~strong)
  around = difference[(beyond > 2.5) & (beyond <= 8)]
  traces = min(2 * np.percentile(around, 90), 0.5 * _STRONG) if around.size else 0
  blurred = (ndimage.distance_transform_edt(~ground) <= 3) | (beyond <= 3)
  limit = np.maximum(0.5 * near * blurred, traces * (beyond <= 16))
  return near, traces, limit


def _without_gaps(mask, label, count, like, smooth):
  """The mask without gaps, and how many there are.

  A gap is an enclosed area where at least some pixels have the ground's very colour and whose
  outline is an edge; a highlight in that colour has none.
  """
  numbers = np.arange(1, count + 1)
  inside = mask & (label > 0)
  area = ndimage.sum_labels(inside, label, numbers)
  share = ndimage.sum_labels(inside & like, label, numbers) / np.maximum(area, 1)
  gaps = []
  for number in numbers[(area >= max(9, 0.002 * mask.sum())) & (share >= 0.2)]:
    gap = label == number
    outline = ndimage.binary_dilation(gap, np.ones((3, 3)), 2) & ~gap
    if (~smooth[outline]).mean() >= 0.6:
      gaps.append(number)
  return mask & ~np.isin(label, gaps), len(gaps)


def _may_be_shadow(image, mask, ground, noise):
  """Whether a good part of the mask's lower half is a darker shade of the ground."""
  rows, _ = bounding_box(mask)
  low = mask.copy()
  low[: (rows.start + rows.stop) // 2] = False
  level, base = image.mean(-1), ground.mean(-1)
  shade = _is_shade(image, ground, noise) & mask
  dark = shade & low & (level < 0.95 * base) & (level > 0.5 * base)
  return bool(dark.sum() > 0.15 * mask.sum() and shade.sum() < 0.6 * mask.sum())


def _inside_of_frame(image):
  """(rows, columns) inside of bars at two opposite sides or of a thin frame; None without."""
  height, width = image.shape[:2]
  for side in (image[:, 0], image[0]):
    color = np.median(side, axis=0)
    bars = np.abs(image - color).max(-1) <= 12
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
    rim = _border(image[inside])
    plain = np.abs(rim - np.median(rim, axis=0)).max(-1) <= 16
    if plain.mean() >= 0.5:
      return inside
  return None
