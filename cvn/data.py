"""From the data set on disk to batches: a Grain pipeline with sparse targets.

An element is one view of one model. Surfaces are lists of S voxels, where S is one number for the
whole data set (`max_voxels`), so that a step is compiled for one shape. Batching adds an axis in
front. Reading an element touches one view's chunks, not the twelve.

Elements are read, augmented (cvn.augment) and batched in the bytes that are on disk; `decode` turns
a batch into what a network is trained on, within the compiled step. That quarters the traffic from
host to device and leaves more CPU time for compute.

  as stored                                      decoded
  image  [H, W, 4] u8, sRGB and straight alpha   [H, W, 3] float32 sRGB in [0, 1], on plain grey
  index  [S, 3] u8, PADDING_INDEX past the end   int32, PADDING_INDEX past the end
  color  [S, 3] u8 sRGB                          float32 in [0, 1], 0 where padded
  flow   [S, 2] u16 (u, v)                       float32 in [0, 1], 0 where padded

Randomness is a function of (seed, epoch, element) alone: which view an element shows, and where in
the epoch's order it stands. So the state of an iterator is one number, the index of the next batch,
whatever the threads that read ahead have done.
"""

import functools
import os
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import grain
import numpy as np

from cvn import augment
from cvn import dataset as dataset_lib
from cvn.dataset import Dataset
from cvn.errors import UserError

GREY = 245 / 255  # the background of the authors' data
VOXEL_MULTIPLE = 256  # S is a multiple of it: data sets of about one size share compiled programs


class Batch(NamedTuple):
  """What the colour network is trained on, as stored or decoded."""

  image: Any  # [B, H, W, 4 or 3]
  index: Any  # [B, S, 3]
  color: Any  # [B, S, 3]
  flow: Any  # [B, S, 2]


class ShapeBatch(NamedTuple):
  """What the shape network is trained on: colours and flows are not even read."""

  image: Any  # [B, H, W, 4 or 3]
  index: Any  # [B, S, 3]


def select_rows(
  dataset: Dataset, split: str, *, categories: Sequence[str] = (), sources: Sequence[str] = ()
) -> np.ndarray:
  """The rows of the finished models of a split.

  Args:
    dataset: the open data set.
    split: 'train', 'val' or 'test'.
    categories: of the models; empty for all.
    sources: of the models; empty for all.

  Returns:
    [N] int64, empty if the split holds no finished model.

  Raises:
    UserError: the data set has no such split, category or source.
  """
  models = dataset.manifest.models
  if split not in dataset_lib.SPLITS:
    raise UserError(f'{split!r} is no split; there are {", ".join(dataset_lib.SPLITS)}')
  for field, wanted in (('category', categories), ('source', sources)):
    known = sorted({getattr(m, field) for m in models})
    for name in wanted:
      if name not in known:
        raise UserError(f'{dataset.root} has no {field} {name!r}; it has {", ".join(known)}')
  counts = dataset_lib.surface_counts(dataset)
  chosen = [
    row
    for row, m in enumerate(models)
    if m.split == split
    and counts[row] > 0
    and (not categories or m.category in categories)
    and (not sources or m.source in sources)
  ]
  return np.array(chosen, np.int64)


def max_voxels(dataset: Dataset) -> int:
  """S: the maximum number of surface voxels of a finished model, rounded up to VOXEL_MULTIPLE.

  Raises:
    UserError: no model is finished.
  """
  most = int(dataset_lib.surface_counts(dataset).max(initial=0))
  if most == 0:
    raise UserError(f'{dataset.root} holds no finished model (make them: datagen.generate)')
  return min(-(-most // VOXEL_MULTIPLE) * VOXEL_MULTIPLE, dataset.manifest.capacity)


def composite(rgba: Any, *, background: float = GREY) -> Any:
  """An image over a plain grey background.

  Args:
    rgba: [..., 4] sRGB and straight alpha, uint8 or float in [0, 1].
    background: grey level in [0, 1].

  Returns:
    [..., 3] float in [0, 1].
  """
  if rgba.dtype == np.uint8:
    rgba = rgba.astype(np.float32) / 255
  alpha = rgba[..., 3:]
  return rgba[..., :3] * alpha + background * (1 - alpha)


def decode(batch: Any) -> Any:
  """A `Batch` or `ShapeBatch`, or an element of one, as a network is trained on it.

  Args:
    batch: as stored, of NumPy or JAX; a decoded one is returned as it is.

  Returns:
    A batch of the same type, on the grey background.
  """
  if batch.image.dtype != np.uint8:
    return batch
  batch = batch._replace(image=composite(batch.image), index=batch.index.astype(np.int32))
  if isinstance(batch, ShapeBatch):
    return batch
  return batch._replace(
    color=batch.color.astype(np.float32) / 255, flow=dataset_lib.decode_flow(batch.flow)
  )


def read_shape(dataset: Dataset, row: int, view: int, *, max_voxels: int) -> ShapeBatch:
  """One element of a `ShapeBatch`, as stored: its arrays without the batch axis.

  Args:
    dataset: the open data set.
    row: of the model.
    view: of the model.
    max_voxels: S, see `max_voxels`.

  Raises:
    UserError: the model's files are damaged.
  """
  a = dataset.arrays
  return ShapeBatch(
    *dataset_lib.read_parts(
      dataset, row, a['views'][row, view], a['surface_index'][row, :max_voxels]
    )
  )


def read_color(dataset: Dataset, row: int, view: int, *, max_voxels: int) -> Batch:
  """One element of a `Batch`, as stored: its arrays without the batch axis.

  Args:
    dataset: the open data set.
    row: of the model.
    view: of the model.
    max_voxels: S, see `max_voxels`.

  Raises:
    UserError: the model's files are damaged.
  """
  a = dataset.arrays
  return Batch(
    *dataset_lib.read_parts(
      dataset,
      row,
      a['views'][row, view],
      a['surface_index'][row, :max_voxels],
      a['surface_color'][row, :max_voxels],
      a['flow'][row, view, :max_voxels],
    )
  )


def read_name(dataset: Dataset, row: int, view: int, *, max_voxels: int) -> str:
  """An element's model and azimuth; batches of them describe the elements of `read_color`.

  Args:
    dataset: the open data set.
    row: row of the model.
    view: its number.
    max_voxels: unused; all readers have this argument.
  """
  del max_voxels
  return f'{dataset.manifest.models[row].id} at {dataset.manifest.azimuths[view]:g}'


def training_batches(
  read: Callable,
  dataset: Dataset,
  rows: Sequence[int],
  *,
  batch_size: int,
  seed: int,
  mirror: bool = False,
  recolor: bool = False,
  shard: tuple[int, int] = (0, 1),
) -> grain.MapDataset:
  """The batches of an epoch; indices past the end go on with the next epochs.

  Each epoch shows every model once, in its own order, from its own random view. Models that do not
  fill a last batch are left out of that epoch.

  Args:
    read: `read_shape` or `read_color`.
    dataset: the open data set.
    rows: [N] models to train on.
    batch_size: elements of a batch, of all processes together.
    seed: of order and views, 0 to 2^32 - 1.
    mirror: whether a random half of the elements is mirrored, see cvn.augment.
    recolor: whether elements get random colours, see cvn.augment.
    shard: (process, processes): this process gets its part of every batch; the batch size is a
      multiple of their number, and the parts together are the batch that one process would get.

  Raises:
    UserError: there are fewer models than a batch needs.
  """
  count, (process, processes) = len(rows), shard
  if count < batch_size:
    raise UserError(
      f'{dataset.root} has {count} finished training models, too few for a batch of {batch_size}:'
      + (f' make more of them, or take a batch size of at most {count}' if count else ' make more')
    )
  views = len(dataset.manifest.azimuths)

  read_one = _reader(read, dataset)

  def choose(row, rng: np.random.Generator):
    view = rng.integers(views)
    return row, view, mirror and rng.integers(2), augment.draw_colors(rng) if recolor else None

  def read_chosen(chosen):
    row, view, flipped, colors = chosen
    element = read_one((row, view))
    if flipped:
      element = augment.mirrored(element, grid_size=dataset.manifest.grid_size)
    if colors is None:
      return element
    order, ends = colors
    return augment.recolored(element, order=order, ends=ends)

  return (
    grain.MapDataset.source([int(r) for r in rows])
    .seed(seed)
    .random_map(choose)  # before the shuffle: there its index is (epoch, element)
    .shuffle()
    .slice(slice(process, count // processes * processes, processes))
    .map(read_chosen)
    .batch(batch_size // processes, drop_remainder=True)
  )


def evaluation_pairs(rows: Sequence[int], views: int, *, limit: int | None = None) -> np.ndarray:
  """Pairs (row, view) to evaluate on, ordered by row.

  Args:
    rows: of the models.
    views: of each model.
    limit: the most pairs, which are spread evenly over all of them; None for all.

  Returns:
    [P, 2] int64.
  """
  pairs = np.stack(np.meshgrid(rows, np.arange(views), indexing='ij'), -1).reshape(-1, 2)
  if limit is not None and limit < len(pairs):
    pairs = pairs[np.linspace(0, len(pairs) - 1, limit).round().astype(int)]
  return pairs.astype(np.int64)


def evaluation_batches(
  read: Callable,
  dataset: Dataset,
  pairs: np.ndarray,
  *,
  batch_size: int,
) -> grain.MapDataset:
  """Batches of pairs in their order; the last one may be smaller.

  Args:
    read: `read_shape` or `read_color`.
    dataset: the open data set.
    pairs: [P, 2] (row, view), see `evaluation_pairs`.
    batch_size: elements of a batch.
  """
  return (
    grain.MapDataset.source([(int(row), int(view)) for row, view in pairs])
    .map(_reader(read, dataset))
    .batch(batch_size)
  )


def iterate(batches: grain.MapDataset, *, num_epochs: int | None = None) -> grain.DatasetIterator:
  """Iterates over epochs of batches; threads read ahead.

  Args:
    batches: of `training_batches` or `evaluation_batches`.
    num_epochs: None for no end.

  Returns:
    An iterator. Its `get_state()` is JSON, and `set_state` continues from there.
  """
  threads = min(os.cpu_count() or 1, 8)
  options = grain.ReadOptions(num_threads=threads, prefetch_buffer_size=threads)
  return iter(batches.repeat(num_epochs).to_iter_dataset(options))


def _reader(read, dataset):
  one = functools.partial(read, dataset, max_voxels=max_voxels(dataset))
  return lambda pair: one(*pair)
