"""A small data set made without the generator: coloured ellipsoids, and views that show them.

The pictures are discs drawn with numpy and not renderings; indices, colours, flows and pictures of
a model do belong together, so that a network can learn from them.
"""

import numpy as np

from cvn import camera, dataset, grid


def make_record(seed: int, *, azimuths=camera.AZIMUTHS, image_size=128, grid_size=64):
  """One ellipsoid: its shell, colours that follow the position, flows by projection."""
  rng = np.random.default_rng(seed)
  radius = rng.uniform(0.2, 0.45, 3)
  axis = np.arange(grid_size)
  index = np.stack(np.meshgrid(axis, axis, axis, indexing='ij'), -1).reshape(-1, 3)
  points = grid.index_to_world(index, size=grid_size)
  level = np.linalg.norm(points / radius, axis=-1)
  shell = np.abs(level - 1) * radius.min() < 0.5 / grid_size
  index, points = index[shell].astype(np.uint8), points[shell]
  color = np.clip((points + 0.5) * 255, 0, 255).astype(np.uint8)

  views = np.zeros((len(azimuths), image_size, image_size, 4), np.uint8)
  flow, visible = [], []
  for v, azimuth in enumerate(azimuths):
    pixel, depth = camera.project(points, camera.camera_at(azimuth, image_size=image_size))
    column, row = np.clip(pixel, 0, image_size - 1).astype(int).T
    far_to_near = np.argsort(-depth)  # where points share a pixel the last one stays
    views[v, row[far_to_near], column[far_to_near], :3] = color[far_to_near]
    views[v, row, column, 3] = 255
    flow.append(pixel / image_size)
    visible.append(depth < camera.DISTANCE)
  return dataset.Record(views, index, color, np.stack(visible), np.stack(flow))


def make_dataset(
  path,
  models: int = 6,
  *,
  splits=('train', 'train', 'train', 'train', 'val', 'test'),
  categories=('ball',),
  azimuths=camera.AZIMUTHS,
  image_size: int = 128,
  grid_size: int = 64,
  capacity: int = 16384,
  missing=(),
) -> dataset.Dataset:
  """Makes a data set of ellipsoids; splits and categories are dealt out in turn.

  Args:
    path: the folder.
    models: how many.
    splits: splits of model 0, 1, ..., from the start again at the end.
    categories: likewise.
    azimuths: of the views.
    image_size: of the views.
    grid_size: of the voxel grid.
    capacity: of the records.
    missing: rows that stay unmade.
  """
  planned = tuple(
    dataset.Model(f'm{n}', categories[n % len(categories)], splits[n % len(splits)], 'synthetic')
    for n in range(models)
  )
  manifest = dataset.Manifest(planned, tuple(azimuths), image_size, grid_size, capacity, {})
  made = dataset.create(str(path), manifest)
  for n in range(models):
    if n not in missing:
      record = make_record(n, azimuths=azimuths, image_size=image_size, grid_size=grid_size)
      dataset.write_record(made.arrays, n, record)
  return made
