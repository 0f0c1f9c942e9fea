"""The authors' released folders: what lies where, under which name, and how it is stored.

  ShapeNetCore_im2avatar/<synset>/<id>/    human_im2avatar/<clothes>/<mesh>/
    views/<view>.png                         views/<view>.png
    models/model_normalized_64.h5            <mesh>.h5
    models/64_<view>_coor.h5                 flow/64_<view>_coor.h5

<view> is an azimuth in radians with three decimals, 0.000, 0.523, ... 5.757: twelfths of a circle
whose π is 3.14. An HDF5 file holds one dataset, `data`: [64, 64, 64, 3] colours or [64, 64, 64, 2]
flows (u, v), in [0, 1] and -1 where no surface is. 64 is the size of the grid. Which axis of a
volume is which is not said; they are taken to be ours (x right, y up, z to the front).

Views are RGB without alpha. A pixel is ground when all its channels equal the red of the top-left
pixel (245 in the release): that is the authors' rule, by which white is told from ground, but not
an object's own grey 245.
"""

import io
import json
import os
from types import ModuleType
from typing import Any

import numpy as np
from PIL import Image

from cvn.errors import UserError
from cvn.files import atomic_write
from datagen.splits import SYNSETS

HUMAN = 'human'  # the category that has the second layout
COLLECTIONS = 'ShapeNetCore_im2avatar', 'human_im2avatar'
EMPTY = -1.0
GROUND = 245

_PI = 3.14
_OPAQUE = 128  # alpha from which on a pixel is the object's
# As the authors pack, with the bytes of the floats sorted before: it takes less time and room.
_PACKING = {'compression': 'gzip', 'compression_opts': 4, 'shuffle': True}


def h5py() -> ModuleType:
  """The library that reads and writes HDF5, which only these folders need.

  Raises:
    UserError: it is not installed.
  """
  try:
    import h5py
  except ImportError as e:
    raise UserError(
      "the authors' released folders need the package h5py: pip install -e '.[release]'"
    ) from e
  return h5py


def view_name(azimuth: float) -> str:
  """What a view at an azimuth in degrees is called."""
  return f'{azimuth / 180 * _PI:.3f}'


def view_azimuth(name: str) -> float:
  """The azimuth in degrees of a view that is called so."""
  return float(name) / _PI * 180


def view_path(view: str) -> str:
  """Where a view's picture is, below the model's folder."""
  return f'views/{view}.png'


def volume_path(category: str, folder: str, grid_size: int) -> str:
  """Where the colours are, below the model's `folder`, whose name counts."""
  if category == HUMAN:
    return f'{os.path.basename(folder)}.h5'
  return f'models/model_normalized_{grid_size}.h5'


def flow_path(category: str, view: str, grid_size: int) -> str:
  """Where a view's flows are, below the model's folder."""
  return f'{"flow" if category == HUMAN else "models"}/{grid_size}_{view}_coor.h5'


def collection(category: str) -> str:
  """The folder of all categories that are laid out as this one."""
  return COLLECTIONS[category == HUMAN]


def category_folder(category: str) -> str:
  """What a category but people is called in folders and lists: its synset, where it has one."""
  return SYNSETS.get(category, category)


def model_folder(category: str, model_id: str) -> str:
  """A model's folder, below that of its collection.

  Of an id in two parts, `clothes9_mesh8`, the first names the clothes; one without is of the
  clothes `human`.

  Raises:
    UserError: category or id cannot be a folder's name.
  """
  if category == HUMAN:
    parts = model_id.split('_', 1) if '_' in model_id else [HUMAN, model_id]
  else:
    parts = [category_folder(category), model_id]
  for part in parts:
    if part in ('', '.', '..') or '/' in part or os.sep in part:
      raise UserError(f'{part!r} of model {model_id} of {category} cannot be the name of a folder')
  return os.path.join(*parts)


def read_array(content: bytes, name: str, shape: tuple[int, ...]) -> np.ndarray:
  """The dataset `data` of an HDF5 file, as float32.

  Args:
    content: of the file.
    name: of the file, for messages.
    shape: that it must have.

  Raises:
    UserError: it is no such file, or holds no such array.
  """
  lib = h5py()
  try:
    with lib.File(io.BytesIO(content), 'r') as file:
      # A link, a virtual or an external dataset would have HDF5 open another file.
      if not isinstance(file.get('data', getlink=True), lib.HardLink):
        raise UserError(f'{name} has no dataset `data`')
      data = file['data']
      if not isinstance(data, lib.Dataset) or data.is_virtual or data.external:
        raise UserError(f'{name} has no dataset `data` of its own')
      if data.shape != shape or data.dtype.kind not in 'fiu':
        raise UserError(f'{name}: `data` is {data.dtype} {data.shape}, not numbers {shape}')
      return data[()].astype(np.float32)
  except (UserError, MemoryError):
    raise
  except Exception as e:  # HDF5 and what wraps it raise whatever a broken file leads them to
    raise UserError(f'{name} cannot be read as HDF5: {" ".join(str(e).split())}') from e


def write_array(path: str, array: np.ndarray) -> None:
  """Writes an array as the one dataset of an HDF5 file, whole or not at all.

  Raises:
    UserError: the place cannot be written.
  """
  lib = h5py()
  with atomic_write(path) as temporary, lib.File(temporary, 'w') as file:
    file.create_dataset('data', data=array, dtype=np.float32, **_PACKING)


def read_view(content: bytes, name: str, size: int) -> np.ndarray:
  """A picture, with alpha by the authors' rule.

  Args:
    content: of the file.
    name: of the file, for messages.
    size: pixels that its sides must have.

  Returns:
    [size, size, 4] u8; alpha is 0 or 255.

  Raises:
    UserError: it is no PNG of that size, or shows nothing but ground.
  """
  try:
    with Image.open(io.BytesIO(content), formats=['PNG']) as image:
      if image.size == (size, size):  # before anything is unpacked
        rgb = np.asarray(image.convert('RGB'))
      width, height = image.size
  except MemoryError:
    raise
  except Exception as e:  # as above, of PIL
    raise UserError(f'{name} cannot be read as PNG: {" ".join(str(e).split())}') from e
  if (width, height) != (size, size):
    raise UserError(f'{name} has {width} x {height} pixels, not {size} x {size}')
  foreground = (rgb != rgb[0, 0, 0]).any(-1)
  if not foreground.any():
    raise UserError(f'{name} shows nothing but its ground')
  return np.concatenate([rgb, np.uint8(255) * foreground[..., None]], -1)


def write_view(path: str, rgba: np.ndarray) -> None:
  """Writes [H, W, 4] u8 as RGB on grey 245, with hard edges, whole or not at all.

  The object's own pixels of exactly that grey become 244, so that they are not taken for ground.

  Raises:
    UserError: the place cannot be written.
  """
  alpha = rgba[..., 3:] / 255
  rgb = np.round(rgba[..., :3] * alpha + GROUND * (1 - alpha)).astype(np.uint8)
  foreground = rgba[..., 3] >= _OPAQUE
  rgb[foreground & (rgb == GROUND).all(-1)] = GROUND - 1
  rgb[~foreground] = GROUND
  with atomic_write(path) as temporary:
    Image.fromarray(rgb).save(temporary, 'PNG')


def claim(folder: str, name: str, content: dict[str, Any]) -> None:
  """Notes in a folder what its files are written from, or checks that it is the same as before.

  Args:
    folder: that is written; made where it is missing.
    name: of the note.
    content: JSON values.

  Raises:
    UserError: the files there were written from something else, or the place cannot be written.
  """
  path = os.path.join(folder, name)
  text = json.dumps(content, indent=1, sort_keys=True) + '\n'
  if not os.path.exists(path):
    with atomic_write(path) as temporary, open(temporary, 'w') as file:
      file.write(text)
    return
  try:
    with open(path) as file:
      before = file.read()
  except (OSError, UnicodeDecodeError) as e:
    raise UserError(f'cannot read {path}: {getattr(e, "strerror", None) or e}') from e
  if before != text:
    raise UserError(
      f'{folder} holds what was written from something else (see {name} in it): choose another'
      ' --output, or delete it'
    )
