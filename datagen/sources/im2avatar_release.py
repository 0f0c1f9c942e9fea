r"""Source `im2avatar_release`: the data released by the paper's authors (datagen/release.py).

It holds records, not meshes: views, coloured voxels and flows are taken as they are. The release
does not state which voxels a view sees, so none is marked as visible. Alpha follows the authors'
rule for the background. The release does not give cameras, so those of the manifest are only
approximate. Volumes keep their axes, so that predictions can be compared with the authors' own
folders; if the axes seem to differ from ours, a warning says so.
"""

import os
import re

import numpy as np
from absl import logging

from cvn.camera import AZIMUTHS
from cvn.dataset import SURFACE_CAPACITY, Record
from cvn.errors import UserError
from cvn.grid import GRID_SIZE
from datagen import release
from datagen.axes import OURS, find_axes
from datagen.reading.files import Files, folder_files
from datagen.sources import SourceModel
from datagen.splits import SYNSETS

LAYOUTS = (
  'the folder ShapeNetCore_im2avatar, of <synset>/<id>, or human_im2avatar, of <clothes>/<mesh>'
)

_LOOKED_AT = 3  # models whose axes are looked at
_AGREEMENT = 0.4  # from which on axes are found: our flows come to 0.69 and more, wrong ones to 0.1
_FOUND = -0.5  # the authors' rule: above it a voxel's first channel is a colour
_ROUNDING = 1e-4  # by which values may be outside [0, 1]
_AWAY = 3.0  # degrees that a view may be away from the azimuth it is taken for


def list_models(
  category: str, input_dir: str | None, limit: int | None = None, seed: int = 0
) -> list[SourceModel]:
  """The models of a category in the order of their ids.

  Warns if the volumes' axes seem to differ from ours.

  Args:
    category: 'human', a key of `SYNSETS`, or the name of a folder such as `03001627`.
    input_dir: folder of the collection.
    limit: maximum number of models; None or 0 takes all.
    seed: unused.

  Raises:
    UserError: h5py is missing, or the input holds no such category or none of its models.
  """
  del seed
  release.h5py()
  if not input_dir or not os.path.isdir(input_dir):
    given = f'--input={input_dir} is none' if input_dir else 'give it as --input=DIR'
    raise UserError(f'--source=im2avatar_release needs {LAYOUTS}: {given}')
  if category == release.HUMAN:
    ids = {
      f'{clothes}_{mesh}': os.path.join(input_dir, clothes, mesh)
      for clothes in _folders(input_dir)
      for mesh in _folders(os.path.join(input_dir, clothes))
      if os.path.isdir(os.path.join(input_dir, clothes, mesh, 'flow'))  # ShapeNet has none
    }
  else:
    synset = SYNSETS.get(category, category)
    category = {s: name for name, s in SYNSETS.items()}.get(synset, category)
    folder = os.path.join(input_dir, synset)
    if not os.path.isdir(folder):
      there = ', '.join(_folders(input_dir)[:5]) or 'none'
      raise UserError(f'{input_dir} has no folder {synset}; it has {there}: give {LAYOUTS}')
    ids = {id: os.path.join(folder, id) for id in _folders(folder)}
  if not ids:
    raise UserError(f'{input_dir} holds no model of category {category}: give {LAYOUTS}')
  models = [SourceModel(id, category, path) for id, path in sorted(ids.items())]
  _check_axes(models[:_LOOKED_AT], input_dir)
  return models[: limit or None]


def read_record(
  model: SourceModel, *, azimuths: tuple[float, ...], image_size: int, grid_size: int
) -> Record:
  """Reads one model.

  Args:
    model: an entry of the list.
    azimuths: azimuths of the record's views, degrees.
    image_size: expected size of the views.
    grid_size: expected size of the volumes.

  Raises:
    UserError: a file is missing or not as expected.
  """
  files = folder_files(model.path)
  names = _view_names(files, azimuths)
  index, color = _read_surface(files, model, grid_size)
  flow = [_read_flow(files, model, name, index, grid_size) for name in names]
  views = []
  for name in names:
    path = release.view_path(name)
    views.append(release.read_view(_content(files, path), f'{model.path}/{path}', image_size))
  visible = np.zeros((len(names), len(index)), bool)
  return Record(np.stack(views), index.astype(np.uint8), color, visible, np.stack(flow))


def _folders(path: str) -> list[str]:
  with os.scandir(path) as entries:
    return sorted(e.name for e in entries if e.is_dir() and not e.name.startswith('.'))


def _view_names(files: Files, azimuths: tuple[float, ...]) -> list[str]:
  """The name of the view at each azimuth."""
  found = (re.fullmatch(r'views/(\d+\.\d+)\.png', path) for path in files.names('views'))
  there = [match[1] for match in found if match]

  def away(name, azimuth):
    return abs((release.view_azimuth(name) - azimuth + 180) % 360 - 180)

  names = []
  for azimuth in azimuths:
    name = min(there, key=lambda name, a=azimuth: away(name, a), default=None)
    if name is None or away(name, azimuth) > _AWAY:
      missing = release.view_path(release.view_name(azimuth))
      raise UserError(f'{files.path} has no file {missing}, its view at {azimuth:g} degrees')
    names.append(name)
  return names


def _read_surface(files: Files, model: SourceModel, grid_size: int):
  """The surface voxels [S, 3] and their colours [S, 3] u8."""
  path = release.volume_path(model.category, model.path, grid_size)
  name = os.path.join(model.path, path)
  volume = release.read_array(_content(files, path), name, (*(grid_size,) * 3, 3))
  index = np.argwhere(volume[..., 0] > _FOUND)
  if not 0 < len(index) <= SURFACE_CAPACITY:
    raise UserError(
      f'{name} has {len(index)} surface voxels; a record holds 1 to {SURFACE_CAPACITY}'
    )
  color = _checked(volume[tuple(index.T)], name)
  return index, np.round(color * 255).astype(np.uint8)


def _read_flow(files: Files, model: SourceModel, view: str, index, grid_size: int):
  """The flow [S, 2] of a view at the surface voxels."""
  path = release.flow_path(model.category, view, grid_size)
  name = os.path.join(model.path, path)
  volume = release.read_array(_content(files, path), name, (*(grid_size,) * 3, 2))
  return _checked(volume[tuple(index.T)], name)


def _content(files: Files, path: str) -> bytes:
  try:
    return files.read(path)
  except FileNotFoundError as e:
    raise UserError(str(e)) from e


def _checked(values, name):
  """The values, checked to be in [0, 1]."""
  outside = ~((values >= -_ROUNDING) & (values <= 1 + _ROUNDING))  # so that NaN is, too
  if outside.any():
    raise UserError(
      f'{name}: {outside.any(-1).sum()} of {len(values)} surface voxels have values outside [0, 1],'
      f' such as {values[outside][0]:g}'
    )
  return np.clip(values, 0, 1)


def _check_axes(models: list[SourceModel], input_dir: str) -> None:
  """Warns if the axes of the first models' volumes differ from ours."""
  indices, flows = [], []
  for model in models:
    try:
      files = folder_files(model.path)
      index, _ = _read_surface(files, model, GRID_SIZE)
      names = _view_names(files, AZIMUTHS)
      flow = np.stack([_read_flow(files, model, name, index, GRID_SIZE) for name in names])
    except UserError:
      continue  # it will fail, with its reason, when its turn comes
    indices.append(index)
    flows.append(flow)
  if not indices:
    return
  axes = find_axes(indices, flows, AZIMUTHS)
  if axes.agreement < _AGREEMENT:
    logging.warning(
      '%s: flows do not follow the voxels as views at these azimuths would show them (agreement'
      ' %.2f of 1): look at the contact sheet before you train',
      input_dir,
      axes.agreement,
    )
  elif axes.names != OURS:
    logging.warning(
      '%s: the axes of the volumes run along (%s) of our world, not (x, y, z)%s; they are kept:'
      ' training and scores are not concerned, exported models will lie that way',
      input_dir,
      ', '.join(axes.names),
      ', mirrored, unless azimuths run the other way' if axes.is_mirrored else '',
    )
