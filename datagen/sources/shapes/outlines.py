"""Outlines of guitars' bodies and heads, as seen from the front.

Knots [N, 2] are (x, y): x in halves of the width, y in lengths, both 0 in the middle of the lower
end. Symmetric outlines list the right half from below.
"""

import numpy as np

from datagen.sources.shapes import solids

ACOUSTIC = {
  'dreadnought': [(0.6, 0), (1, 0.08), (1, 0.36), (0.76, 0.56), (0.82, 0.84), (0.6, 1)],
  'classical': [(0.5, 0), (1, 0.07), (1.02, 0.36), (0.6, 0.58), (0.78, 0.86), (0.35, 1)],
  'jumbo': [(0.4, 0), (1, 0.02), (1.08, 0.36), (0.5, 0.58), (0.78, 0.88), (0.3, 1)],
  'pear': [(0.4, 0), (0.95, 0.04), (1.1, 0.32), (0.7, 0.64), (0.35, 0.94), (0.12, 1)],
}
CUTAWAY = [(0.6, 0), (1, 0.08), (1, 0.36), (0.74, 0.56), (0.86, 0.74), (0.74, 0.88), (0.38, 0.8)]
CUTAWAY_TOP = (0.14, 0.84)

# Left and right halves, each from below.
ELECTRIC = {
  'double': (
    [(0.5, 0), (1, 0.04), (1.02, 0.32), (0.66, 0.5), (0.96, 0.78), (0.84, 1.1), (0.5, 1.02)]
    + [(0.46, 0.82), (0.14, 0.8)],
    [(0.5, 0.02), (1, 0.08), (1.02, 0.36), (0.7, 0.52), (0.94, 0.72), (0.8, 0.98), (0.5, 0.94)]
    + [(0.42, 0.78), (0.14, 0.78)],
  ),
  'single': (
    [(0.5, 0), (1, 0.04), (1.02, 0.34), (0.66, 0.58), (0.8, 0.84), (0.6, 1), (0.14, 1)],
    [(0.5, 0), (1, 0.04), (1.02, 0.34), (0.66, 0.58), (0.84, 0.7), (0.84, 0.92), (0.46, 0.92)]
    + [(0.4, 0.76), (0.14, 0.8)],
  ),
  'horned': (
    [(0.5, 0), (1, 0.06), (0.98, 0.32), (0.7, 0.55), (0.78, 0.8), (0.92, 1.05), (0.6, 0.92)]
    + [(0.36, 0.74), (0.14, 0.76)],
    [(0.5, 0), (1, 0.06), (0.98, 0.32), (0.7, 0.55), (0.76, 0.78), (0.86, 1.02), (0.56, 0.9)]
    + [(0.36, 0.74), (0.14, 0.76)],
  ),
  'hollow': (
    [(0.5, 0), (1, 0.04), (1.04, 0.34), (0.66, 0.58), (0.9, 0.84), (0.62, 1), (0.34, 0.88)]
    + [(0.14, 0.86)],
  )
  * 2,
  'vee': ([(0.02, 0.3), (0.8, -0.1), (1.15, 0.02), (0.4, 0.84), (0.14, 0.98)],) * 2,
  'bolt': (
    [(0.1, 0.1), (1.15, -0.05), (1.05, 0.25), (0.55, 0.62), (0.7, 0.96), (0.14, 0.88)],
    [(0.2, 0.12), (1.15, 0.24), (1.0, 0.46), (0.5, 0.66), (0.95, 1.08), (0.55, 1.0), (0.14, 0.8)],
  ),
}
SHARP = ('vee', 'bolt')

HEADS = {
  'paddle': [(-0.8, 0), (0.8, 0), (1.15, 0.2), (1.0, 1), (-1.0, 1), (-1.15, 0.2)],
  'crown': [(-0.8, 0), (0.8, 0), (1.1, 0.2), (1.2, 0.92), (0.4, 1.04), (0, 0.94), (-0.4, 1.04)]
  + [(-1.2, 0.92), (-1.1, 0.2)],
  'spear': [(-0.8, 0), (0.8, 0), (1.2, 0.15), (0.7, 0.85), (0, 1.15), (-0.7, 0.85), (-1.2, 0.15)],
  'in line': [(-0.8, 0), (0.8, 0), (0.6, 0.25), (1.1, 0.9), (0.6, 1.1), (-0.2, 1.0), (-1.3, 0.3)],
  'fishtail': [(-0.7, 0), (0.7, 0), (0.9, 0.5), (1.3, 1), (0, 0.86), (-1.3, 1), (-0.9, 0.5)],
}
SPACING = 0.012  # metres between an outline's points


def body(kind: str, width: float, length: float, *, cutaway: bool) -> np.ndarray:
  """A body's outline [M, 2] in metres."""
  if kind in ACOUSTIC:
    left = ACOUSTIC[kind]
    right = CUTAWAY + [CUTAWAY_TOP] if cutaway else left
    left = left + [(CUTAWAY_TOP[0], 1.0)] if cutaway else left
  else:
    left, right = ELECTRIC[kind]
  knots = [*right, *[(-x, y) for x, y in left[::-1]]]
  return _finish(knots, [0.5 * width, length], rounds=1 if kind in SHARP else 3)


def head(kind: str, width: float, length: float, *, rounded: bool) -> np.ndarray:
  """A head's outline [M, 2] in metres."""
  return _finish(HEADS[kind], [width, length], rounds=2 if rounded else 0)


def _finish(knots, scale, *, rounds) -> np.ndarray:
  points = solids.smooth(np.array(knots, float), rounds=rounds, closed=True)
  return solids.resample(points * scale, SPACING)
