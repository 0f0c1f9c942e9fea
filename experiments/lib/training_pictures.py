"""Pictures of a network in the course of its training."""

import numpy as np

from cvn import data, figures, grid, infer
from cvn.dataset import Dataset
from cvn.infer import Network
from cvn.readouts import COLOR_KINDS, SHAPE_KINDS


def draw_views(network: Network, dataset: Dataset, pairs: np.ndarray) -> np.ndarray:
  """Views, their reconstructions and the truth, as one uint8 image [H, W, 3]."""
  slots = data.max_voxels(dataset)
  truth = [data.decode(data.read_color(dataset, *p, max_voxels=slots)) for p in pairs]
  images = np.stack([t.image for t in truth])
  found = infer.reconstruct(
    images,
    shape=network if network.kind in SHAPE_KINDS else None,
    color=network if network.kind in COLOR_KINDS else None,
  )
  lines = []
  for t, result, (_, view) in zip(truth, infer.split(found), pairs, strict=True):
    right = grid.to_voxels(t.index, t.color)
    made = grid.ColoredVoxels(
      right.occupancy if result.occupancy is None else result.occupancy,
      np.full_like(right.color, 0.7) if result.color is None else result.color,
    )
    azimuth = dataset.manifest.azimuths[view]
    drawn = [figures.draw_voxels(v, azimuth) for v in (made, right)]
    lines.append([figures.to_uint8(t.image), *drawn])
  return figures.grid_of_images(lines, column_titles=('view', 'network', 'truth'))
