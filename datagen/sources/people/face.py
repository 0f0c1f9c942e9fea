"""Faces: a picture of eyes, brows, mouth and cheeks, laid on the head from the front.

It is drawn a little larger than life: in a view of 128 pixels a head is 16 pixels high, and its
front is to be told from its back.
"""

from typing import NamedTuple

import numpy as np

from datagen.sources.people.charts import Chart
from datagen.sources.people.data import BodyData

SIZE = 192  # pixels of the picture's sides
# Where on the base mesh the middle and a corner of the mouth and a brow are, dm.
MOUTH, CORNER, BROW = (0.0, 6.63, 1.6), (0.33, 6.6, 1.35), (0.33, 7.52, 1.4)


class Face(NamedTuple):
  """Colours of a head's front, [3] each, and its habits."""

  skin: np.ndarray
  brow: np.ndarray
  iris: np.ndarray
  lips: np.ndarray
  beard: np.ndarray | None
  smile: float  # how far the mouth's corners go up, in its width
  glasses: np.ndarray | None


def sample(rng: np.random.Generator, skin: np.ndarray, hair: np.ndarray, *, beard: bool) -> Face:
  """Chance's face on a skin, with brows of the hair's colour."""
  iris = np.array([[0.2, 0.12, 0.06], [0.15, 0.3, 0.6], [0.15, 0.4, 0.2], [0.1, 0.08, 0.06]])
  dark = 0.45 * hair + 0.2 * skin * [0.6, 0.5, 0.5]
  lips = 0.45 * skin + 0.55 * np.array([[0.75, 0.2, 0.22], [0.6, 0.2, 0.2]])[rng.integers(2)]
  frame = np.array([[0.05, 0.05, 0.06], [0.5, 0.1, 0.1]])[rng.integers(2)]
  return Face(
    skin=skin,
    brow=dark,
    iris=iris[rng.integers(len(iris))],
    lips=lips,
    beard=0.9 * hair + 0.1 * skin if beard else None,
    smile=rng.uniform(-0.08, 0.25),
    glasses=frame if rng.random() < 0.15 else None,
  )


def frame(data: BodyData, chart: Chart) -> tuple[np.ndarray, np.ndarray]:
  """The window of the picture: its lower left corner [2] and its size [2], dm."""
  head = chart.vertices[np.unique(data.groups['body'])]
  head = head[chart.head_weight[np.unique(data.groups['body'])] > 0.5]
  low, high = head[:, :2].min(0), head[:, :2].max(0)
  return low - 0.02 * (high - low), 1.04 * (high - low)


def uv(chart: Chart, window: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
  """Where each vertex [V] lies in the picture, from the front: [V, 2]."""
  return (chart.vertices[:, :2] - window[0]) / window[1]


def draw(data: BodyData, chart: Chart, window, face: Face) -> np.ndarray:
  """The picture [SIZE, SIZE, 4] uint8."""
  center = (np.arange(SIZE) + 0.5) / SIZE
  x, y = np.meshgrid(center, 1 - center)
  x, y = window[0][0] + x * window[1][0], window[0][1] + y * window[1][1]
  eyes = [_middle(data, chart, f'helper-{s}-eye') for s in 'lr']
  mouth, corner, brow = (_near(data, chart, p) for p in (MOUTH, CORNER, BROW))
  unit = 0.5 * np.linalg.norm(eyes[0] - eyes[1])  # half the distance of the eyes, dm: about 0.31
  across = 0.5 * (eyes[0][0] + eyes[1][0])
  image = np.tile(face.skin, (SIZE, SIZE, 1))

  def spot(px, py, rx, ry):
    return ((x - px) / rx) ** 2 + ((y - py) / ry) ** 2

  def blend(color, share):
    image[:] += np.clip(share, 0, 1)[..., None] * (np.asarray(color) - image)

  for eye in eyes:
    side = np.sign(eye[0] - across)
    blend(0.75 * face.skin + [0.2, 0.04, 0.04], 0.5 * (spot(
      across + side * 1.5 * unit, 0.5 * (eye[1] + mouth[1]), 0.8 * unit, 0.7 * unit) < 1))  # fmt: skip
  if face.beard is not None:
    jaw = (y < mouth[1] + 0.75 * unit) & (spot(across, mouth[1], 0.95 * unit, 0.45 * unit) > 1)
    moustache = spot(across, mouth[1] + 0.5 * unit, 1.2 * unit, 0.3 * unit) < 1
    blend(face.beard, jaw | moustache)
  blend(0.6 * face.skin, 0.9 * (spot(across, 0.42 * eyes[0][1] + 0.58 * mouth[1], 0.55 * unit,
                                     0.12 * unit) < 1))  # fmt: skip
  for eye in eyes:
    side = np.sign(eye[0] - across)
    blend(0.5 * face.skin, spot(eye[0], eye[1], 0.82 * unit, 0.52 * unit) < 1)
    blend([0.97, 0.97, 0.97], spot(eye[0], eye[1] - 0.03 * unit, 0.72 * unit, 0.4 * unit) < 1)
    blend(face.iris, spot(eye[0], eye[1], 0.36 * unit, 0.4 * unit) < 1)
    blend([0.02, 0.02, 0.02], spot(eye[0], eye[1], 0.17 * unit, 0.19 * unit) < 1)
    arch = brow[1] + 0.06 * unit - 0.25 * unit * ((x - eye[0]) / unit - 0.1 * side) ** 2
    blend(face.brow, (np.abs(y - arch) < 0.14 * unit) & (np.abs(x - eye[0]) < 0.85 * unit))
    if face.glasses is not None:
      rim = spot(eye[0], eye[1] - 0.1 * unit, 0.88 * unit, 0.75 * unit)
      blend(face.glasses, (rim < 1) & (rim > 0.62))
  if face.glasses is not None:
    blend(face.glasses, (np.abs(x - across) < 0.3 * unit) & (np.abs(y - eyes[0][1]) < 0.1 * unit))
  half = 1.15 * abs(corner[0] - across)
  curve = mouth[1] + 2 * half * face.smile * (((x - across) / half) ** 2 - 0.3)
  thick = 0.27 * unit * np.sqrt(np.clip(1 - ((x - across) / half) ** 2, 0, 1))
  blend(face.lips, np.abs(y - curve) < thick)
  blend(0.4 * face.lips, np.abs(y - curve) < 0.25 * thick)
  out = np.full((SIZE, SIZE, 4), 255, np.uint8)
  out[..., :3] = np.round(255 * np.clip(image, 0, 1))
  return out


def _middle(data, chart, group):
  """The mean [3] of a group's vertices."""
  return chart.vertices[np.unique(data.groups[group])].mean(0)


def _near(data, chart, point):
  """Where the body's vertex is now that on the base mesh is nearest to a point."""
  body = np.unique(data.groups['body'])
  nearest = body[np.argmin(np.linalg.norm(data.vertices[body] - point, axis=1))]
  return chart.vertices[nearest]
