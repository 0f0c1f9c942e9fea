"""The pictures of the user study: turntables of models, and views cut to their object."""

import io
import math

import numpy as np
from PIL import Image

from cvn import figures
from cvn.grid import ColoredVoxels
from experiments.study.page import Sheet

FRAMES = 32  # pictures of a turn; a multiple of 4, for the four sides
COLUMNS = 8
QUALITY = 88  # of WebP: the page has some 2,000 pictures in 15 MB
GREY = (246, 246, 246)  # background: similar to the views', and WebP keeps it exactly
MARGIN = 8  # pixels around the object


def crop_to_object(view: np.ndarray) -> np.ndarray:
  """The square around the object in a view: uint8 [H, W, 4] -> [S, S, 3] on `GREY`."""
  rows, columns = np.nonzero(view[..., 3]) if view[..., 3].any() else np.indices(view.shape[:2])
  low = np.array([rows.min(), columns.min()])
  high = np.array([rows.max(), columns.max()]) + 1
  side = int((high - low).max()) + 2 * MARGIN
  top, left = (low + high - side) // 2 + side  # in the padded picture
  around = ((side, side), (side, side), (0, 0))
  padded = np.pad(figures.over(view, background=GREY), around, constant_values=GREY[0])
  return padded[top : top + side, left : left + side]


def draw(results: list[ColoredVoxels], azimuth: float, size: int) -> list[Sheet]:
  """Turntables that start at `azimuth`, all cut to one frame.

  Args:
    results: models of one shape.
    azimuth: degrees.
    size: of the pictures in pixels, before the cut.
  """
  turn = [
    np.stack(
      [
        figures.draw_voxels(r, azimuth + 360 * n / FRAMES, size=size, background=GREY)
        for n in range(FRAMES)
      ]
    )
    for r in results
  ]
  rows, columns = common_frame(turn)
  return [_make_sheet(frames[:, rows, columns]) for frames in turn]


def common_frame(turns: list[np.ndarray]) -> tuple[slice, slice]:
  """Rows and columns that hold everything drawn, with the turning axis in the middle.

  Args:
    turns: uint8 pictures [F, S, S, 3] on `GREY`.
  """
  size = turns[0].shape[1]
  drawn = np.any([(t != GREY).any((0, 3)) for t in turns], axis=0)
  if not drawn.any():
    return slice(0, size), slice(0, size)
  rows, columns = (np.flatnonzero(drawn.any(axis)) for axis in (1, 0))
  half = max(size / 2 - columns[0], columns[-1] + 1 - size / 2)
  left = max(0, math.floor(size / 2 - half) - MARGIN)
  top, bottom = max(0, rows[0] - MARGIN), min(size, rows[-1] + 1 + MARGIN)
  return slice(int(top), int(bottom)), slice(left, size - left)


def _make_sheet(frames: np.ndarray) -> Sheet:
  """Pictures [F, H, W, 3] as one image."""
  height, width = frames.shape[1:3]
  lines = frames.reshape(-1, COLUMNS, height, width, 3).swapaxes(1, 2)
  file = io.BytesIO()
  image = Image.fromarray(lines.reshape(-1, COLUMNS * width, 3))
  image.save(file, 'webp', quality=QUALITY, method=4)
  return Sheet(file.getvalue(), width, height)
