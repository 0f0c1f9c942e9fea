"""The data set on disk: Zarr v3 arrays beside a JSON manifest, all through TensorStore.

`root` is a folder or any TensorStore key-value URL (file://, gs://, s3://). It holds

  manifest.json               what `Manifest` describes
  failures.json               {model id: reason} of the models that could not be made
  views          [N,V,H,W,4]  u8   sRGB and alpha
  surface_index  [N,C,3]      u8   voxel (i, j, k), PADDING_INDEX past the count
  surface_color  [N,C,3]      u8   sRGB albedo
  visible        [N,V,C]      u8   1 where the view sees the voxel
  flow           [N,V,C,2]    u16  (u, v) * 65535: 1/512 of a pixel
  facts          [N,4]        f32  statistics of the mesh, `Facts`; older data sets lack the last
  surface_count  [N]          u32  voxels of the model; written last, so 0 means: not made

The manifest's cameras are those that datagen renders with. Models of source im2avatar_release have
views from about the same azimuths, but the release does not give their cameras, and none of their
voxels is marked as visible.

Row n of every array is model n of the manifest. An array has one file (shard) for each model, in
which each view is a chunk, so that a single view can be read. No two models share a file: any
number of processes may write models at the same time, and a model exists only once it is complete.
"""

import hashlib
import json
import math
import os
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import tensorstore as ts

from cvn import camera, grid
from cvn.errors import UserError

FORMAT = 2
SURFACE_CAPACITY = 32768  # of 262,144 voxels; a solid cube's shell has 23,816
SPLITS = ('train', 'val', 'test')
MAX_CHUNK = 1 << 30  # bytes that a chunk unpacks to: 64 times what ours have
ARRAYS = (
  'views',
  'surface_index',
  'surface_color',
  'visible',
  'flow',
  'facts',
  'surface_count',
)


class Model(NamedTuple):
  """One planned row: where a model comes from and what it is used for."""

  id: str
  category: str
  split: str  # 'train', 'val' or 'test'
  source: str  # a key of datagen.sources.SOURCES
  path: str = ''  # the file it was made from, below the source's folder
  licence: str = ''
  creator: str = ''
  content: str = ''  # a checksum of its files: where they change, the record is made anew
  up: str = 'y'  # what pointed up in its file
  turn: float = 0.0  # degrees by which it was turned then, anticlockwise seen from above


class Manifest(NamedTuple):
  """The contents of the data set, and how it was made."""

  models: tuple[Model, ...]
  azimuths: tuple[float, ...]  # degrees, one a view
  image_size: int
  grid_size: int
  capacity: int  # C, the most surface voxels a record can hold
  settings: dict[str, Any]  # the generator's flags and version


class Facts(NamedTuple):
  """Statistics of the mesh that a record was made from."""

  faces: float = 0  # triangles with an area
  missing: float = 0  # files of textures and materials that are named but not there
  volume: float = 0  # signed, of its bounding box's: below 0 where faces look inwards
  notes: float = 0  # bits of what its reader ignored or guessed (datagen/reading/notes.py)


class Record(NamedTuple):
  """One model: V views and S surface voxels."""

  views: np.ndarray  # [V, H, W, 4] u8
  surface_index: np.ndarray  # [S, 3] u8, in row-major order of the voxels
  surface_color: np.ndarray  # [S, 3] u8
  visible: np.ndarray  # [V, S] bool
  flow: np.ndarray  # [V, S, 2] float, (u, v) in [0, 1]
  facts: Facts = Facts()


class Dataset(NamedTuple):
  """An open data set."""

  root: str  # TensorStore URL, ends in '/'
  manifest: Manifest
  arrays: dict[str, ts.TensorStore]


def to_url(root: str) -> str:
  """The TensorStore URL of a folder name or URL, with a slash at its end."""
  url = root if '://' in root else 'file://' + os.path.abspath(root)
  return url.rstrip('/') + '/'


def encode_flow(flow: Any) -> np.ndarray:
  """(u, v) in [0, 1] -> u16."""
  return np.round(np.clip(flow, 0, 1) * 65535).astype(np.uint16)


def decode_flow(flow: Any) -> Any:
  """The inverse of `encode_flow`, as float32."""
  return flow.astype(np.float32) / 65535


def create(root: str, manifest: Manifest) -> Dataset:
  """Creates an empty data set: manifest and arrays, no record.

  Raises:
    UserError: a data set is already there, or the place cannot be written.
  """
  url = to_url(root)
  if read_json(url, 'manifest.json') is not None:
    raise UserError(f'{root} already holds a data set')
  arrays = {k: _open_array(url, k, spec) for k, spec in _array_specs(manifest).items()}
  _write_manifest(url, manifest)
  return Dataset(url, manifest, arrays)


def extend(dataset: Dataset, models: Sequence[Model]) -> Dataset:
  """Plans more models, in rows after the existing ones.

  The manifest is written last: if this is interrupted, the data set is unchanged.

  Args:
    dataset: the open data set.
    models: the new rows.

  Raises:
    UserError: the place cannot be written.
  """
  manifest = dataset.manifest._replace(models=(*dataset.manifest.models, *models))
  try:
    arrays = {
      k: a.resize(exclusive_max=[len(manifest.models), *a.shape[1:]], expand_only=True).result()
      for k, a in dataset.arrays.items()
    }
  except ValueError as e:
    raise UserError(f'cannot extend {dataset.root}: {_first_line(e)}') from e
  _write_manifest(dataset.root, manifest)
  return Dataset(dataset.root, manifest, arrays)


def replan(dataset: Dataset, models: Mapping[int, Model]) -> Dataset:
  """Replaces planned models; their records are dropped, to be made again.

  Args:
    dataset: the open data set.
    models: the new model of each row.

  Raises:
    UserError: the place cannot be written.
  """
  try:
    for row in models:  # first, so that no old record is taken for the new model's
      dataset.arrays['surface_count'][row].write(0).result()
  except ValueError as e:
    raise UserError(f'cannot write {dataset.root}: {_first_line(e)}') from e
  rows = tuple(models.get(row, m) for row, m in enumerate(dataset.manifest.models))
  manifest = dataset.manifest._replace(models=rows)
  _write_manifest(dataset.root, manifest)
  return dataset._replace(manifest=manifest)


def _write_manifest(url: str, manifest: Manifest) -> None:
  as_json = manifest._asdict()
  as_json['models'] = [m._asdict() for m in manifest.models]
  as_json['cameras'] = [
    {
      k: np.asarray(v).tolist()
      for k, v in camera.camera_at(a, image_size=manifest.image_size)._asdict().items()
    }
    for a in manifest.azimuths
  ]
  write_json(url, 'manifest.json', {'format': FORMAT, **as_json})


def open_dataset(root: str) -> Dataset:
  """Opens a data set that `create` made.

  Raises:
    UserError: there is none, it is damaged, or another version of this program made it.
  """
  url = to_url(root)
  raw = read_json(url, 'manifest.json')
  if raw is None:
    raise UserError(f'{root} is no data set: it has no manifest.json (make one: datagen.generate)')
  if not isinstance(raw, dict) or raw.get('format') != FORMAT:
    raise UserError(f'{root}/manifest.json is not of format {FORMAT}: make the data set again')
  try:
    manifest = Manifest(
      tuple(Model(**m) for m in raw['models']),
      tuple(raw['azimuths']),
      *(raw[k] for k in ('image_size', 'grid_size', 'capacity', 'settings')),
    )
    arrays = open_arrays(root)
    for name, (dtype, shape, *_) in _array_specs(manifest).items():
      _check_array(name, arrays[name], dtype, shape)
  except (KeyError, TypeError, ValueError, OverflowError) as e:
    raise UserError(f'{root} is a damaged data set: {_first_line(e)}') from e
  return Dataset(url, manifest, arrays)


def open_arrays(root: str) -> dict[str, ts.TensorStore]:
  """The arrays of a data set without its manifest, which can be long: all that a worker needs.

  Raises:
    UserError: they are missing.
  """
  url = to_url(root)
  try:
    return {k: _open_array(url, k, None) for k in ARRAYS}
  except ValueError as e:
    raise UserError(f'{root} is a damaged data set: {_first_line(e)}') from e


def check_size(arrays: dict[str, ts.TensorStore], record: Record) -> None:
  """Checks that a data set has room for a record.

  Args:
    arrays: of the data set, see `open_arrays`.
    record: the model.

  Raises:
    UserError: the record has no voxel, or more than the data set's capacity.
  """
  count, capacity = len(record.surface_index), arrays['surface_index'].shape[1]
  if not 0 < count <= capacity:
    raise UserError(f'{count} surface voxels; a record holds 1 to {capacity}')


def write_record(arrays: dict[str, ts.TensorStore], row: int, record: Record) -> None:
  """Writes one model; a reader sees it only once all of it is there.

  Args:
    arrays: of the data set, see `open_arrays`.
    row: of the model.
    record: the model.

  Raises:
    UserError: the record does not fit (`check_size`), or the place cannot be written (no space).
  """
  check_size(arrays, record)
  count, capacity = len(record.surface_index), arrays['surface_index'].shape[1]

  def padded(x, axis, fill):
    pad = [(0, 0)] * x.ndim
    pad[axis] = (0, capacity - count)
    return np.pad(x, pad, constant_values=fill)

  values = {
    'views': record.views,
    'surface_index': padded(record.surface_index, 0, grid.PADDING_INDEX),
    'surface_color': padded(record.surface_color, 0, 0),
    'visible': padded(record.visible.astype(np.uint8), 1, 0),
    'flow': padded(encode_flow(record.flow), 1, 0),
    'facts': np.array(record.facts, np.float32),
  }
  try:
    writes = [arrays[name][row].write(value) for name, value in values.items()]
    for w in writes:
      w.result()
    arrays['surface_count'][row].write(count).result()
  except ValueError as e:
    raise UserError(f'cannot write the record: {_first_line(e)}') from e


def read_record(dataset: Dataset, row: int) -> Record:
  """Reads one whole model back.

  Raises:
    UserError: the row's model was not made, or its files are damaged.
  """
  count = int(surface_counts(dataset)[row])
  if count == 0:
    raise UserError(f'{dataset.manifest.models[row].id} is not made yet')
  a = dataset.arrays
  views, index, color, visible, flow, facts = read_parts(
    dataset,
    row,
    a['views'][row],
    a['surface_index'][row, :count],
    a['surface_color'][row, :count],
    a['visible'][row, :, :count],
    a['flow'][row, :, :count],
    a['facts'][row],
  )
  facts = Facts(*(float(x) for x in facts))
  return Record(views, index, color, visible.astype(bool), decode_flow(flow), facts)


def read_parts(dataset: Dataset, row: int, *parts: ts.TensorStore) -> list[np.ndarray]:
  """Reads slices of the arrays of one model at the same time.

  Args:
    dataset: the open data set.
    row: of the model, for the message.
    *parts: of the arrays.

  Raises:
    UserError: the model's files are damaged.
  """
  try:
    return [r.result() for r in [p.read() for p in parts]]
  except (ValueError, IndexError) as e:
    name = dataset.manifest.models[row].id
    raise UserError(
      f'{dataset.root}: the files of model {name} are damaged ({_first_line(e)}): make the data set'
      ' again'
    ) from e


def surface_counts(dataset: Dataset) -> np.ndarray:
  """[N] surface voxels of each row; 0 where the model is not made.

  Raises:
    UserError: the files are damaged.
  """
  m = dataset.manifest
  try:
    # Not all there are: arrays are extended before the manifest is, and one may claim any length.
    counts = np.asarray(dataset.arrays['surface_count'][: len(m.models)].read().result())
  except ValueError as e:
    raise UserError(f'{dataset.root}surface_count is damaged: {_first_line(e)}') from e
  for row in np.flatnonzero(counts > m.capacity)[:1]:
    raise UserError(
      f'{dataset.root}surface_count is damaged: model {m.models[row].id} has {counts[row]} voxels,'
      f' more than a record can hold ({m.capacity})'
    )
  return counts


def digest(dataset: Dataset, rows: Sequence[int]) -> str:
  """A fingerprint of some models of a data set, wherever it is stored: 16 hexadecimal digits.

  Two fingerprints are equal if the models have the same names, categories, splits, sources and
  numbers of voxels in the same order, and the same views and settings of the generator. Models
  outside the rows, such as those planned later, do not matter.

  Args:
    dataset: the open data set.
    rows: of the models.
  """
  m, counts = dataset.manifest, surface_counts(dataset)
  parts = [m.settings, m.azimuths, m.image_size, m.grid_size]
  parts += [[*m.models[r][:4], int(counts[r])] for r in rows]
  return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:16]


def read_json(root: str, name: str) -> Any:
  """A JSON file of the data set; None if there is none.

  Raises:
    UserError: it cannot be read.
  """
  try:
    raw = ts.KvStore.open(to_url(root)).result().read(name).result()
    return json.loads(raw.value) if raw.state == 'value' else None
  except (ValueError, json.JSONDecodeError) as e:
    raise UserError(f'cannot read {root}{name}: {_first_line(e)}') from e


def write_json(root: str, name: str, value: Any) -> None:
  """Writes a JSON file of the data set, whole or not at all.

  Args:
    root: of the data set.
    name: of the file.
    value: JSON values.

  Raises:
    UserError: it cannot be written.
  """
  text = json.dumps(value, indent=1, sort_keys=True) + '\n'
  try:
    ts.KvStore.open(to_url(root)).result().write(name, text.encode()).result()
  except ValueError as e:
    raise UserError(f'cannot write {root}{name}: {_first_line(e)}') from e


def _array_specs(m: Manifest) -> dict[str, tuple[str, Sequence[int], bool, int]]:
  """name -> dtype, shape, whether the second axis is views, fill value."""
  n, v, s, c = len(m.models), len(m.azimuths), m.image_size, m.capacity
  return {
    'views': ('uint8', (n, v, s, s, 4), True, 0),
    'surface_index': ('uint8', (n, c, 3), False, grid.PADDING_INDEX),
    'surface_color': ('uint8', (n, c, 3), False, 0),
    'visible': ('uint8', (n, v, c), True, 0),
    'flow': ('uint16', (n, v, c, 2), True, 0),
    'facts': ('float32', (n, len(Facts._fields)), False, 0),
    'surface_count': ('uint32', (n,), False, 0),
  }


def _check_array(name: str, array: ts.TensorStore, dtype: str, shape: Sequence[int]) -> None:
  """Checks that an array is what the manifest says, and that one chunk of it fits into memory.

  Raises:
    ValueError: it is not.
  """
  # An array is extended before the manifest is.
  if array.dtype.name != dtype or array.shape[1:] != tuple(shape[1:]) or array.shape[0] < shape[0]:
    raise ValueError(
      f'{name} is {array.dtype.name} {array.shape}, but the manifest says {dtype} {tuple(shape)}'
    )
  size = math.prod(array.chunk_layout.write_chunk.shape) * array.dtype.numpy_dtype.itemsize
  if size > MAX_CHUNK:
    raise ValueError(f'{name} has chunks of {size} bytes, more than {MAX_CHUNK}')


def _open_array(url: str, name: str, spec) -> ts.TensorStore:
  """Opens the array, or makes it where `spec` is given."""
  json_spec = {'driver': 'zarr3', 'kvstore': url + name + '/'}
  if spec is None:
    return ts.open(json_spec, open=True).result()
  dtype, shape, by_view, fill = spec
  raw = {'name': 'bytes'}
  if dtype != 'uint8':
    raw['configuration'] = {'endian': 'little'}
  codecs = [raw, {'name': 'zstd', 'configuration': {'level': 3}}]
  if by_view:
    sharded = {
      'chunk_shape': (1, 1, *shape[2:]),
      'codecs': codecs,
      'index_codecs': [
        {'name': 'bytes', 'configuration': {'endian': 'little'}},
        {'name': 'crc32c'},
      ],
    }
    codecs = [{'name': 'sharding_indexed', 'configuration': sharded}]
  json_spec['metadata'] = {
    'shape': shape,
    'data_type': dtype,
    'fill_value': fill,
    'chunk_grid': {'name': 'regular', 'configuration': {'chunk_shape': (1, *shape[1:])}},
    'codecs': codecs,
  }
  try:
    return ts.open(json_spec, create=True, open=True).result()
  except ValueError as e:
    raise UserError(f'cannot make {url}{name}: {_first_line(e)}') from e


def _first_line(e: Exception) -> str:
  return str(e).strip().split('\n', 1)[0].split(' [tensorstore_spec=', 1)[0]
