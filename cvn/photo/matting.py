"""Masks of objects in front of busy backgrounds, by optional packages (pip install 'cvn[photo]').

Images are [H, W, 3] u8, masks [H, W] bool.
"""

import functools

import numpy as np
from PIL import Image

_BOX = 0.08  # margin of the central box, as a part of the picture's sides
_ITERATIONS = 6
_SIZE = 400  # pixels of the longer side that GrabCut works on
_OVERLAP = 0.55  # of the colours of object and background: above it nothing tells them apart


class UnavailableError(Exception):
  """The package or its network is missing; the message says which."""


def by_rembg(rgb: np.ndarray) -> np.ndarray | None:
  """The mask of the `rembg` network, which downloads its weights the first time.

  Raises:
    UnavailableError: the package is not installed, or its weights cannot be downloaded.
  """
  try:
    session = _session()
  except ImportError as e:
    raise UnavailableError('rembg is not installed') from e
  except Exception as e:  # no network, no space, a broken download
    reason = str(e).split('\n', 1)[0]
    raise UnavailableError(f'rembg cannot load its network: {reason}') from e
  import rembg

  mask = np.asarray(rembg.remove(Image.fromarray(rgb), session=session, only_mask=True))
  return _plausible(mask >= 128)


@functools.cache
def _session():
  import rembg

  return rembg.new_session()


def by_grabcut(rgb: np.ndarray) -> np.ndarray | None:
  """OpenCV's GrabCut from the central box; None if its result does not separate colours.

  Rother et al., GrabCut: interactive foreground extraction using iterated graph cuts, 2004.

  Raises:
    UnavailableError: OpenCV is not installed.
  """
  try:
    import cv2
  except ImportError as e:
    raise UnavailableError('OpenCV is not installed') from e
  height, width = rgb.shape[:2]
  scale = min(1, _SIZE / max(height, width))
  size = max(8, round(scale * width)), max(8, round(scale * height))
  small = np.asarray(Image.fromarray(rgb).resize(size, Image.Resampling.BOX))
  left, top = (max(1, round(_BOX * s)) for s in size)
  box = left, top, size[0] - 2 * left, size[1] - 2 * top
  mask = np.zeros(small.shape[:2], np.uint8)
  models = np.zeros((1, 65)), np.zeros((1, 65))
  cv2.setRNGSeed(0)
  cv2.grabCut(small[..., ::-1].copy(), mask, box, *models, _ITERATIONS, cv2.GC_INIT_WITH_RECT)
  mask = (mask == cv2.GC_FGD) | (mask == cv2.GC_PR_FGD)
  if _plausible(mask) is None or _overlap(small, mask) > _OVERLAP:
    return None
  large = Image.fromarray(np.uint8(255) * mask).resize((width, height), Image.Resampling.BILINEAR)
  return np.asarray(large) >= 128


def _plausible(mask):
  return mask if 0.01 < mask.mean() < 0.95 else None


def _overlap(rgb, mask):
  """Similarity of the colours inside and outside: Bhattacharyya's coefficient, 0 to 1."""
  bins = (rgb // 32).astype(int) @ np.array([64, 8, 1])
  inside, outside = (np.bincount(bins[m], minlength=512) / max(1, m.sum()) for m in (mask, ~mask))
  return float(np.sqrt(inside * outside).sum())
