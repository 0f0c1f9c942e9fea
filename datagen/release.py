"""The layout and storage of the authors' released folders.

  ShapeNetCore_im2avatar/<synset>/<id>/    human_im2avatar/<clothes>/<mesh>/
    views/<view>.png                         views/<view>.png
    models/model_normalized_64.h5            <mesh>.h5
    models/64_<view>_coor.h5                 flow/64_<view>_coor.h5

<view> is an azimuth in radians with three decimals, 0.000, 0.523, ... 5.757: twelfths of a circle
with π = 3.14. An HDF5 file holds one dataset, `data`: colours [64, 64, 64, 3] or flows (u, v) [64,
64, 64, 2], in [0, 1] and -1 off the surface. 64 is the size of the grid. The release does not state
the order of a volume's axes; it is taken to be ours (x right, y up, z to the front).

Views are RGB without alpha. A pixel is background if all its channels equal the red channel of the
top-left pixel (245 in the release). This is the authors' rule. It separates white from the
background, but not a foreground grey of exactly 245.
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
  """The HDF5 library, which only these folders need.

  Raises:
    UserError: it is not installed.
  """
  try:
    import h5py
  except ImportError as e:
    raise UserError("the authors' released folders need h5py: pip install 'cvn[release]'") from e
  return h5py


def view_name(azimuth: float) -> str:
  """The name of a view at an azimuth in degrees."""
  return f'{azimuth / 180 * _PI:.3f}'


def view_azimuth(name: str) -> float:
  """The azimuth in degrees of a view with this name."""
  return float(name) / _PI * 180


def view_path(view: str) -> str:
  """Path of a view's image below the model's folder."""
  return f'views/{view}.png'


def volume_path(category: str, folder: str, grid_size: int) -> str:
  """Path of the colours below the model's `folder`; it may contain the folder's name."""
  if category == HUMAN:
    return f'{os.path.basename(folder)}.h5'
  return f'models/model_normalized_{grid_size}.h5'


def flow_path(category: str, view: str, grid_size: int) -> str:
  """Path of a view's flows below the model's folder."""
  return f'{"flow" if category == HUMAN else "models"}/{grid_size}_{view}_coor.h5'


def collection(category: str) -> str:
  """The folder of all categories with the same layout as this one."""
  return COLLECTIONS[category == HUMAN]


def category_folder(category: str) -> str:
  """Name of a category (except people) in folders and lists: its synset, if it has one."""
  return SYNSETS.get(category, category)


def model_folder(category: str, model_id: str) -> str:
  """A model's folder below that of its collection.

  An id in two parts such as `clothes9_mesh8` begins with the clothes; an id without clothes belongs
  to the clothes `human`.

  Raises:
    UserError: category or id cannot be the name of a folder.
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
    content: the file's bytes.
    name: the file's name, for messages.
    shape: the expected shape.

  Raises:
    UserError: it is not an HDF5 file, or does not hold such an array.
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
  """Writes an array as the only dataset of an HDF5 file, atomically.

  Raises:
    UserError: the file cannot be written.
  """
  lib = h5py()
  with atomic_write(path) as temporary, lib.File(temporary, 'w') as file:
    file.create_dataset('data', data=array, dtype=np.float32, **_PACKING)


def read_view(content: bytes, name: str, size: int) -> np.ndarray:
  """An image, with alpha by the authors' rule.

  Args:
    content: the file's bytes.
    name: the file's name, for messages.
    size: expected height and width, pixels.

  Returns:
    [size, size, 4] u8; alpha is 0 or 255.

  Raises:
    UserError: it is not a PNG of this size, or shows only background.
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
    raise UserError(f'{name} shows only its background')
  return np.concatenate([rgb, np.uint8(255) * foreground[..., None]], -1)


def write_view(path: str, rgba: np.ndarray) -> None:
  """Writes [H, W, 4] u8 as RGB on grey 245, with hard edges, atomically.

  Foreground pixels of exactly this grey become 244, so that they do not count as background.

  Raises:
    UserError: the file cannot be written.
  """
  alpha = rgba[..., 3:] / 255
  rgb = np.round(rgba[..., :3] * alpha + GROUND * (1 - alpha)).astype(np.uint8)
  foreground = rgba[..., 3] >= _OPAQUE
  rgb[foreground & (rgb == GROUND).all(-1)] = GROUND - 1
  rgb[~foreground] = GROUND
  with atomic_write(path) as temporary:
    Image.fromarray(rgb).save(temporary, 'PNG')


def claim(folder: str, name: str, content: dict[str, Any]) -> None:
  """Records in a folder what its files are written from, or checks that this has not changed.

  Args:
    folder: the folder; it is created if missing.
    name: file name of the record.
    content: JSON values.

  Raises:
    UserError: the existing files were written from something else, or nothing can be written.
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
      f'{folder} was written from something else (see {name} there): choose another --output, or'
      ' delete it'
    )
