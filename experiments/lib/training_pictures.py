"""Pictures that a training shows of its network now and then."""

import numpy as np

from cvn import data, figures, grid, methods
from cvn.dataset import Dataset


def draw_views(kind: str, state, dataset: Dataset, pairs: np.ndarray) -> np.ndarray:
  """Views, what the network makes of them, and the truth, as one uint8 image [H, W, 3]."""
  slots = data.surface_slots(dataset)
  truth = [data.decode(data.read_color(dataset, *p, slots=slots)) for p in pairs]
  images = np.stack([t.image for t in truth])
  variables = {'params': state.params, 'batch_stats': state.batch_stats}
  occupied = predicted = [None] * len(truth)
  if kind in methods.SHAPE_KINDS:
    occupied = methods.score(kind, variables, images) >= methods.THRESHOLDS[kind]
  if kind in methods.COLOR_KINDS:
    predicted = methods.colors(kind, variables, images)
  lines = []
  for t, shape, color, (_, view) in zip(truth, occupied, predicted, pairs, strict=True):
    right = grid.to_voxels(t.index, t.color)
    made = grid.ColoredVoxels(
      right.occupancy if shape is None else shape,
      np.full_like(right.color, 0.7) if color is None else color,
    )
    azimuth = dataset.manifest.azimuths[view]
    drawn = [figures.draw_voxels(v, azimuth) for v in (made, right)]
    lines.append([figures.to_uint8(t.image), *drawn])
  return figures.grid_of_images(lines, column_titles=('view', 'network', 'truth'))
