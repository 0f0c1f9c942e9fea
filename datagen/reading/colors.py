"""Colours of any type and range -> sRGB in [0, 1]."""

import numpy as np

from datagen.geometry.mesh import NO_COLOR
from datagen.reading import notes as notes_lib


def as_rgba(colors: np.ndarray, notes: set[str] | None = None) -> np.ndarray:
  """[..., 3 or 4] of any type -> [..., 4] float32 in [0, 1].

  Integers are divided by their type's maximum; floats are taken as they are. Floats above 2, and
  wide integers that stay below 256, are divided by 255, as some programs write them; that is noted.

  Args:
    colors: the values; NaN becomes 0.
    notes: set that gets a note of such a guess.
  """
  colors = np.asarray(colors)
  top = 1.0
  values = np.nan_to_num(colors.astype(np.float64), posinf=0, neginf=0)
  largest = values.max(initial=0)
  if colors.dtype.kind in 'iu':
    top = float(np.iinfo(colors.dtype).max)
    counts_to_255 = 1 < largest <= 255 < top
  else:
    counts_to_255 = largest > 2
  if counts_to_255:
    top = 255.0
    if notes is not None:
      notes.add(notes_lib.COLOR_RANGE_GUESSED)
  values = (values / top).clip(0, 1).astype(np.float32)
  if values.shape[-1] == 3:
    values = np.concatenate([values, np.ones_like(values[..., :1])], -1)
  return values


def linear_to_srgb(rgba: np.ndarray) -> np.ndarray:
  """The curve of IEC 61966-2-1 on the first three channels of [..., 4]."""
  rgb = rgba[..., :3]
  curve = np.where(
    rgb <= 0.0031308, 12.92 * rgb, 1.055 * np.maximum(rgb, 1e-6) ** (1 / 2.4) - 0.055
  )
  return np.concatenate([curve, rgba[..., 3:]], -1).astype(np.float32)


def grey(faces: int) -> np.ndarray:
  """[F, 3, 4] colours of faces without colours."""
  colors = np.full((faces, 3, 4), NO_COLOR, np.float32)
  colors[..., 3] = 1
  return colors
