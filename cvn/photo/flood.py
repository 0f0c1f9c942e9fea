"""The background of an image: everything that smooth shading connects to its border.

Images are float32 [H, W, 3], values 0 to 255; masks are bool [H, W]. The constants are our choice;
the paper has no photos.
"""

import numpy as np
from scipy import ndimage

from cvn.photo.regions import border

_CLEAN = (0.0, 2.0, 1.2, 0.35)  # radii of the band-pass filter, its limit, and that for a slope
_GRAINY = (1.5, 4.0)  # radii where there is noise
_HUE = 10  # largest deviation of a shade of the ground from the ground's colour, scaled
_SHADOW, _BRIGHTER = 0.35, 1.06  # shades of the ground, as parts of its brightness
_LEAK = 1  # half the width of the holes in an edge that the flood does not pass, in pixels


def largest(values: np.ndarray) -> np.ndarray:
  """The largest absolute value of three channels, [...] of [..., 3]; numpy's `max` is slower."""
  red, green, blue = np.moveaxis(np.abs(values), -1, 0)
  return np.maximum(np.maximum(red, green), blue)


def estimate_noise(image: np.ndarray) -> float:
  """The standard deviation of the noise, from the smoother half of the image's border."""
  width = max(2, round(0.03 * min(image.shape[:2])))
  residual = largest(image - ndimage.gaussian_filter(image, (1.5, 1.5, 0)))
  ring = np.ones(residual.shape, bool)
  ring[width:-width, width:-width] = False
  return float(np.median(residual[ring])) / 1.2


def find_smooth(image: np.ndarray, noise: float) -> np.ndarray:
  """[H, W] bool, True where there is no edge.

  The response of a band-pass filter marks an edge if it exceeds that of noise and that of a blurred
  edge (a shadow's), whose response is small compared with its slope.
  """
  fine, coarse, limit, per_slope = _CLEAN if noise < 0.5 else (*_GRAINY, max(1.2, 0.8 * noise), 0.9)
  margin = int(3 * coarse)
  # Shading goes on beyond the border as it comes: a mere reflection would put a fold there.
  wide = np.pad(image, ((margin,) * 2, (margin,) * 2, (0, 0)), 'reflect', reflect_type='odd')
  low = ndimage.gaussian_filter(wide, (coarse, coarse, 0))
  band = largest(ndimage.gaussian_filter(wide, (fine, fine, 0)) - low)
  slope = largest(np.hypot(*np.gradient(low, axis=(0, 1))))
  return (band <= limit + per_slope * slope)[margin:-margin, margin:-margin]


def find_grounds(image: np.ndarray, smooth: np.ndarray, noise: float) -> list[np.ndarray]:
  """Masks of the background: one, or two if wall and floor meet in a line across the image.

  Args:
    image: [H, W, 3].
    smooth: [H, W], True where there is no edge.
    noise: its standard deviation.

  Returns:
    [H, W] bool each; none if no smooth region touches the border.
  """
  regions, _ = ndimage.label(smooth)
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
  """Smooth shades of the background that are connected to its pixels on the border."""
  shade = smooth & is_shade(image, model, noise, brightest=brightest)
  label, _ = ndimage.label(ndimage.binary_erosion(shade, np.ones((3, 3)), _LEAK, border_value=1))
  near = largest(image - model) <= max(16, 3 * noise)
  edge = border(label)
  touching = np.unique(edge[border(near | own) & (edge > 0)])
  flood = np.isin(label, touching) & (label > 0)
  return ndimage.binary_dilation(flood, np.ones((3, 3)), _LEAK) & shade


def _fit(image, region):
  """The background's colour everywhere: a parabola in x and y fitted to a region of it."""
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
    weights = 1 / (1 + (largest(a @ solution - b) / 8) ** 2)
  return np.clip(terms @ solution.astype(np.float32), 0, 255)


def is_shade(
  image: np.ndarray, model: np.ndarray, noise: float, *, brightest: float = _BRIGHTER
) -> np.ndarray:
  """Where a colour is the background's, in shadow or slightly brighter.

  Args:
    image: [H, W, 3].
    model: [H, W, 3], the background's colour in full light.
    noise: its standard deviation.
    brightest: maximum brightness relative to the background's.
  """
  scale = (image * model).sum(-1) / np.maximum((model * model).sum(-1), 1)
  dark = model.max(-1) < 24
  scale = np.where(dark, 1, scale)
  hue = largest(image - scale[..., None] * model)
  return (hue <= max(_HUE, 4 * noise)) & (scale >= _SHADOW) & (scale <= brightest)


def extend(image: np.ndarray, ground: np.ndarray) -> np.ndarray:
  """The background's colour, slightly smoothed; outside it, that of its nearest pixel."""
  weight = ground.astype(np.float32)
  total = np.maximum(ndimage.gaussian_filter(weight, 2), 1e-6)
  own = ndimage.gaussian_filter(image * weight[..., None], (2, 2, 0)) / total[..., None]
  nearest = ndimage.distance_transform_edt(~ground, return_distances=False, return_indices=True)
  return own[tuple(nearest)]
