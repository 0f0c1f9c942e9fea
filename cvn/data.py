"""From the data set on disk to batches: a Grain pipeline with sparse targets.

An element is one view of one model. Surfaces are lists of S voxels, where S is one number for the
whole data set (`surface_slots`), so that a compiled step meets one shape. Batching adds an axis in
front. Reading an element touches one view's chunks, not the twelve.

Elements are read, turned and batched in the bytes that are on disk; `decode` makes of a batch what
a network is trained on, in the compiled step. So the host has a quarter of the bytes to move, and
threads that read take less of the processors that compute.

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

from cvn import dataset as dataset_lib
from cvn import grid
from cvn.dataset import Dataset
from cvn.errors import UserError

GREY = 245 / 255  # the background of the authors' data
SLOT_MULTIPLE = 256  # S is a multiple of it: data sets of about one size share compiled programs


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
  dataset: Dataset, split: str, categories: Sequence[str] = (), sources: Sequence[str] = ()
) -> np.ndarray:
  """Rows [N] of the finished models of a split; of the categories and sources named, or of all.

  The result may be empty where the split holds no finished model.

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


def surface_slots(dataset: Dataset) -> int:
  """S: the most voxels a finished model of the data set has, up to the next SLOT_MULTIPLE.

  Raises:
    UserError: no model is finished.
  """
  most = int(dataset_lib.surface_counts(dataset).max(initial=0))
  if most == 0:
    raise UserError(f'{dataset.root} holds no finished model (make them: datagen.generate)')
  return min(-(-most // SLOT_MULTIPLE) * SLOT_MULTIPLE, dataset.manifest.capacity)


def composite(rgba: Any, background: float = GREY) -> Any:
  """[..., 4] sRGB and straight alpha, u8 or in [0, 1], over grey -> [..., 3] in [0, 1]."""
  if rgba.dtype == np.uint8:
    rgba = rgba.astype(np.float32) / 255
  alpha = rgba[..., 3:]
  return rgba[..., :3] * alpha + background * (1 - alpha)


def decode(batch: Any, background: float = GREY) -> Any:
  """A `Batch` or `ShapeBatch`, or an element of one, as a network is trained on it.

  Args:
    batch: as stored, of NumPy or JAX; what is decoded already comes back as it is.
    background: grey level in [0, 1] behind the object.
  """
  if batch.image.dtype != np.uint8:
    return batch
  batch = batch._replace(
    image=composite(batch.image, background), index=batch.index.astype(np.int32)
  )
  if isinstance(batch, ShapeBatch):
    return batch
  return batch._replace(
    color=batch.color.astype(np.float32) / 255, flow=dataset_lib.decode_flow(batch.flow)
  )


def read_shape(dataset: Dataset, row: int, view: int, *, slots: int) -> ShapeBatch:
  """One element of a `ShapeBatch`, as stored: its arrays without the batch axis.

  Raises:
    UserError: the model's files are damaged.
  """
  a = dataset.arrays
  return ShapeBatch(
    *dataset_lib.read_parts(dataset, row, a['views'][row, view], a['surface_index'][row, :slots])
  )


def read_color(dataset: Dataset, row: int, view: int, *, slots: int) -> Batch:
  """One element of a `Batch`, as stored: its arrays without the batch axis.

  Raises:
    UserError: the model's files are damaged.
  """
  a = dataset.arrays
  return Batch(
    *dataset_lib.read_parts(
      dataset,
      row,
      a['views'][row, view],
      a['surface_index'][row, :slots],
      a['surface_color'][row, :slots],
      a['flow'][row, view, :slots],
    )
  )


def read_name(dataset: Dataset, row: int, view: int, *, slots: int) -> str:
  """An element's model and azimuth; batches of them say what is in those of `read_color`."""
  del slots
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
    batch_size: elements of a batch of this process.
    seed: of order and views, 0 to 2^32 - 1.
    mirror: whether a random half of the elements is mirrored, see `mirrored`.
    recolor: whether every element is painted in other colours, see `recolored`.
    shard: (process, processes): each process sees its own part of every epoch.

  Raises:
    UserError: there are fewer models than a batch needs.
  """
  process, processes = shard
  share = len(rows) // processes
  if share < batch_size:
    needed = f'{processes} processes of batch size' if processes > 1 else 'a batch of'
    raise UserError(
      f'{dataset.root} has {len(rows)} finished training models, too few for {needed} {batch_size}:'
      + (f' make more of them, or take a batch size of at most {share}' if share else ' make more')
    )
  views = len(dataset.manifest.azimuths)

  read_one = _reader(read, dataset)

  def choose(row, rng: np.random.Generator):
    view = rng.integers(views)
    return row, view, mirror and rng.integers(2), draw_paint(rng) if recolor else None

  def read_chosen(chosen):
    row, view, flipped, paint = chosen
    element = read_one((row, view))
    if flipped:
      element = mirrored(element, dataset.manifest.grid_size)
    return element if paint is None else recolored(element, *paint)

  return (
    grain.MapDataset.source([int(r) for r in rows])
    .seed(seed)
    .random_map(choose)  # before the shuffle: there its index is (epoch, element)
    .shuffle()
    .slice(slice(process, share * processes, processes))
    .map(read_chosen)
    .batch(batch_size, drop_remainder=True)
  )


def mirrored(element: Any, grid_size: int) -> Any:
  """An element of the object's mirror image in x.

  Turned over from left to right, the view from azimuth a is the mirrored object's view from -a.

  Args:
    element: of a `Batch` or `ShapeBatch`, as stored, without the batch axis.
    grid_size: of the data set.
  """
  index = element.index.copy()
  real = index[:, 0] != grid.PADDING_INDEX
  index[real, 0] = grid_size - 1 - index[real, 0]
  element = element._replace(image=np.ascontiguousarray(element.image[:, ::-1]), index=index)
  if isinstance(element, ShapeBatch):
    return element
  flow = element.flow.copy()
  flow[real, 0] = dataset_lib.encode_flow(1) - flow[real, 0]
  return element._replace(flow=flow)


def draw_paint(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
  """Other colours, at random: (order, ends) for `recolored`.

  Red, green and blue change places. For one element in two each of them also runs between other
  ends, at least 0.5 apart, rising or falling, so that all that could be told apart still can.
  """
  order = rng.permutation(3)
  if rng.integers(2):
    return order, np.array([[0.0, 1.0]] * 3)
  low = rng.uniform(0, 0.5, 3)
  ends = np.stack([low, rng.uniform(low + 0.5, 1)], 1)
  return order, np.where(rng.integers(2, size=(3, 1)), ends, ends[:, ::-1])


def recolored(element: Any, order: Sequence[int], ends: np.ndarray) -> Any:
  """An element in other colours, the same in the picture and on the surface.

  Views show albedo without light, so this is the object's view had it been painted so; the ground
  is grey and stays it.

  Args:
    element: of a `Batch` or `ShapeBatch`, as stored, without the batch axis.
    order: a permutation of (0, 1, 2): channel c becomes what channel order[c] was.
    ends: [3, 2] in [0, 1], what 0 and 1 of each channel then become.
  """
  table = np.round(255 * np.linspace(*np.transpose(ends), 256)).astype(np.uint8)  # [256, 3]

  def paint(colors):
    return table[colors[..., order], np.arange(3)]

  image = np.concatenate([paint(element.image[..., :3]), element.image[..., 3:]], -1)
  element = element._replace(image=image)
  if isinstance(element, ShapeBatch):
    return element
  real = element.index[:, :1] != grid.PADDING_INDEX
  return element._replace(color=np.where(real, paint(element.color), 0))


def evaluation_pairs(rows: Sequence[int], views: int, limit: int | None = None) -> np.ndarray:
  """[P, 2] pairs (row, view): all of them by row, or `limit` spread evenly over the rows' views."""
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
  """Batches of the pairs [P, 2] in their order; the last one holds what is left over."""
  return (
    grain.MapDataset.source([(int(row), int(view)) for row, view in pairs])
    .map(_reader(read, dataset))
    .batch(batch_size)
  )


def iterate(batches: grain.MapDataset, num_epochs: int | None = None) -> grain.DatasetIterator:
  """Iterates over epochs of batches, without end where `num_epochs` is None; threads read ahead.

  `get_state()` of the result is JSON, and `set_state` continues there.
  """
  threads = min(os.cpu_count() or 1, 8)
  options = grain.ReadOptions(num_threads=threads, prefetch_buffer_size=threads)
  return iter(batches.repeat(num_epochs).to_iter_dataset(options))


def _reader(read, dataset):
  one = functools.partial(read, dataset, slots=surface_slots(dataset))
  return lambda pair: one(*pair)
