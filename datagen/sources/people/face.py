"""Faces: an image of eyes, brows, mouth and cheeks, projected onto the head from the front.

It is drawn a little larger than life, so that the front of a head can be distinguished from its
back: in a view of 128 pixels a head is 16 pixels high.
"""

from typing import NamedTuple

import numpy as np

from datagen.sources.people.charts import Chart
from datagen.sources.people.data import BodyData

SIZE = 192  # pixels of the picture's sides
# Where on the base mesh the middle and a corner of the mouth and a brow are, dm.
MOUTH, CORNER, BROW = (0.0, 6.63, 1.6), (0.33, 6.6, 1.35), (0.33, 7.52, 1.4)
IRISES = np.array([[0.2, 0.12, 0.06], [0.15, 0.3, 0.6], [0.15, 0.4, 0.2], [0.1, 0.08, 0.06]])
LIPS = np.array([[0.75, 0.2, 0.22], [0.6, 0.2, 0.2]])
FRAMES = np.array([[0.05, 0.05, 0.06], [0.5, 0.1, 0.1]])
EYE_WHITE, PUPIL = (0.97, 0.97, 0.97), (0.02, 0.02, 0.02)


class Face(NamedTuple):
  """Colours [3] of a head's front, and its features."""

  skin: np.ndarray
  brow: np.ndarray
  iris: np.ndarray
  lips: np.ndarray
  beard: np.ndarray | None
  smile: float  # how far the mouth's corners go up, in its width
  glasses: np.ndarray | None


def sample(rng: np.random.Generator, skin: np.ndarray, hair: np.ndarray, *, beard: bool) -> Face:
  """A random face for a skin, with brows of the hair's colour."""
  dark = 0.45 * hair + 0.2 * skin * [0.6, 0.5, 0.5]
  return Face(
    skin=skin,
    brow=dark,
    iris=IRISES[rng.integers(len(IRISES))],
    lips=0.45 * skin + 0.55 * LIPS[rng.integers(len(LIPS))],
    beard=0.9 * hair + 0.1 * skin if beard else None,
    smile=rng.uniform(-0.08, 0.25),
    glasses=FRAMES[rng.integers(len(FRAMES))] if rng.random() < 0.15 else None,
  )


class Marks(NamedTuple):
  """Positions (x, y) of features on a head, seen from the front, in dm."""

  window: np.ndarray  # [2, 2] the picture's lower left corner and its size
  eyes: np.ndarray  # [2, 2] left and right
  mouth: np.ndarray  # [2]
  corner: np.ndarray  # [2] of the mouth
  brow: np.ndarray  # [2] the left one


def marks(data: BodyData, chart: Chart) -> Marks:
  """Finds the features of a body's head."""
  used = np.unique(data.groups['body'])
  head = chart.vertices[used[chart.head_weight[used] > 0.5], :2]
  low, size = head.min(0), np.ptp(head, axis=0)
  eyes = [chart.vertices[np.unique(data.groups[f'helper-{s}-eye']), :2].mean(0) for s in 'lr']

  def moved(point):  # where that is now that was there on the base mesh
    nearest = np.linalg.norm(data.vertices[used] - point, axis=1).argmin()
    return chart.vertices[used[nearest], :2]

  window = np.stack([low - 0.02 * size, 1.04 * size])
  return Marks(window, np.stack(eyes), moved(MOUTH), moved(CORNER), moved(BROW))


def uv(chart: Chart, window: np.ndarray) -> np.ndarray:
  """Texture coordinates [V, 2] of each vertex in the image of a window, from the front."""
  return (chart.vertices[:, :2] - window[0]) / window[1]


def draw(face: Face, at: Marks) -> np.ndarray:
  """The image [SIZE, SIZE, 4] uint8."""
  center = (np.arange(SIZE) + 0.5) / SIZE
  x, y = np.meshgrid(center, 1 - center)
  x, y = at.window[0][0] + x * at.window[1][0], at.window[0][1] + y * at.window[1][1]
  # Half the distance of the eyes is the unit, about 0.31 dm; 0 is midway between them.
  unit = 0.5 * np.linalg.norm(at.eyes[0] - at.eyes[1])
  middle = at.eyes.mean(0)
  x, y = (x - middle[0]) / unit, (y - middle[1]) / unit
  mouth, corner, brow = ((p - middle) / unit for p in (at.mouth, at.corner, at.brow))
  image = np.tile(face.skin, (SIZE, SIZE, 1))

  def paint(color, where, share=1.0):
    image[where] += share * (np.asarray(color) - image[where])

  def spot(px, py, rx, ry):
    return ((x - px) / rx) ** 2 + ((y - py) / ry) ** 2

  for side in (-1, 1):
    cheek = spot(1.5 * side, 0.5 * mouth[1], 0.8, 0.7) < 1
    paint(0.75 * face.skin + [0.2, 0.04, 0.04], cheek, 0.5)
  if face.beard is not None:
    jaw = (y < mouth[1] + 0.75) & (spot(0, mouth[1], 0.95, 0.45) > 1)
    paint(face.beard, jaw | (spot(0, mouth[1] + 0.5, 1.2, 0.3) < 1))
  paint(0.6 * face.skin, spot(0, 0.58 * mouth[1], 0.55, 0.12) < 1, 0.9)  # under the nose
  for side in (-1, 1):
    paint(0.5 * face.skin, spot(side, 0, 0.82, 0.52) < 1)
    paint(EYE_WHITE, spot(side, -0.03, 0.72, 0.4) < 1)
    paint(face.iris, spot(side, 0, 0.36, 0.4) < 1)
    paint(PUPIL, spot(side, 0, 0.17, 0.19) < 1)
    arch = brow[1] + 0.06 - 0.25 * (x - 1.1 * side) ** 2
    paint(face.brow, (np.abs(y - arch) < 0.14) & (np.abs(x - side) < 0.85))
    if face.glasses is not None:
      rim = spot(side, -0.1, 0.88, 0.75)
      paint(face.glasses, (rim < 1) & (rim > 0.62))
  if face.glasses is not None:
    paint(face.glasses, (np.abs(x) < 0.3) & (np.abs(y) < 0.1))
  half = 1.15 * abs(corner[0])
  curve = mouth[1] + 2 * half * face.smile * ((x / half) ** 2 - 0.3)
  thick = 0.27 * np.sqrt(np.clip(1 - (x / half) ** 2, 0, 1))
  paint(face.lips, np.abs(y - curve) < thick)
  paint(0.4 * face.lips, np.abs(y - curve) < 0.25 * thick)
  out = np.full((SIZE, SIZE, 4), 255, np.uint8)
  out[..., :3] = np.round(255 * np.clip(image, 0, 1))
  return out
