"""An image of some models of a data set, to check at a glance.

There is a row for each model. Views are shown beside the colour voxels drawn through the same
cameras, so that a mirrored or rotated model is obvious. Then come the flow of the first view, in
the paper's colour code on the voxels, from the front and from behind, and the colours that this
flow fetches from the view: where the flow is right, they match the voxels.
"""

import itertools
from collections.abc import Sequence

import numpy as np

from cvn import grid
from cvn.camera import IMAGE_SIZE
from cvn.dataset import Dataset, Record, read_record
from cvn.figures import draw_voxels, flow_color_code, grid_of_images, over

PAIRS = (1, 4)  # views shown beside the voxels from the same side: 30 and 120 degrees
FLOW_VIEW = 1  # the view whose flow is shown
ELEVATION = 20  # degrees, of the voxels seen from behind
GROUND = (245, 245, 245)


def contact_sheet(dataset: Dataset, rows: Sequence[int]) -> np.ndarray:
  """Draws models below each other.

  Args:
    dataset: the data set.
    rows: rows of finished models, at least one.

  Returns:
    uint8 [H, W, 3].
  """
  pictures = [_pictures(dataset, read_record(dataset, row)) for row in rows]
  titles = list(pictures[0])
  legend = [flow_legend() if t.startswith('flow') else None for t in titles]
  return grid_of_images(
    [*(list(p.values()) for p in pictures), legend],
    column_titles=titles,
    row_titles=[*(_wrapped(dataset.manifest.models[row].id) for row in rows), 'flow colours'],
    background=GROUND,
  )


def rows_to_show(dataset: Dataset, done: np.ndarray, new: Sequence[int], count: int) -> list[int]:
  """Chooses some models of each category, new ones first, as evenly as possible.

  Args:
    dataset: the data set.
    done: [N] bool, finished models.
    new: rows of models made in this run.
    count: maximum number of rows.
  """
  models, is_new = dataset.manifest.models, set(new)
  waiting: dict[str, list[int]] = {}
  for row in sorted(np.flatnonzero(done).tolist(), key=lambda row: row not in is_new):
    waiting.setdefault(models[row].category, []).append(row)
  chosen = []
  for turn in itertools.zip_longest(*waiting.values()):
    chosen += [row for row in turn if row is not None]
  return sorted(chosen[:count], key=lambda row: (list(waiting).index(models[row].category), row))


def flow_legend(size: int = IMAGE_SIZE) -> np.ndarray:
  """The colour code of the image plane: uint8 [size, size, 3]."""
  at = (np.arange(size) + 0.5) / size
  uv = np.stack(np.meshgrid(at, at), -1)
  return np.round(flow_color_code(uv) * 255).astype(np.uint8)


def _pictures(dataset: Dataset, record: Record) -> dict[str, np.ndarray]:
  """The images of a row by their titles."""
  azimuths = dataset.manifest.azimuths

  def voxels(values):
    return grid.to_voxels(record.surface_index, values, size=dataset.manifest.grid_size)

  def view(v):
    image = over(record.views[v], background=GROUND)
    enlarge = max(1, IMAGE_SIZE // len(image))
    return np.repeat(np.repeat(image, enlarge, 0), enlarge, 1)

  def drawn(volume, azimuth, elevation):
    return draw_voxels(volume, azimuth, elevation=elevation, size=IMAGE_SIZE, background=GROUND)

  own = voxels(record.surface_color / 255)
  pictures = {}
  for v in PAIRS:
    pictures[f'view {azimuths[v]}'] = view(v)
    pictures[f'voxels {azimuths[v]}'] = drawn(own, azimuths[v], 0)
  front, back = azimuths[FLOW_VIEW], azimuths[FLOW_VIEW] + 180
  pictures[f'voxels {back}'] = drawn(own, back, ELEVATION)
  flow = record.flow[FLOW_VIEW]
  coded = voxels(flow_color_code(flow))
  pictures[f'flow of view {front},\nseen from {front}'] = drawn(coded, front, 0)
  pictures[f'seen from {back}'] = drawn(coded, back, ELEVATION)
  height, width = record.views.shape[1:3]
  column, row = np.minimum((flow * [width, height]).astype(int), [width - 1, height - 1]).T
  sampled = voxels(record.views[FLOW_VIEW, row, column, :3] / 255)
  pictures[f'what it fetches,\nseen from {front}'] = drawn(sampled, front, 0)
  pictures[f'what it fetches,\nseen from {back}'] = drawn(sampled, back, ELEVATION)
  return pictures


def _wrapped(text: str, width: int = 16) -> str:
  return '\n'.join(text[i : i + width] for i in range(0, len(text), width))
