"""Numbers in a glTF file's buffers: accessors of any type, also sparse and normalised ones."""

import base64
import binascii
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from cvn.errors import UserError
from datagen.reading.headers import MAX_FACES

TYPES = {5120: 'i1', 5121: 'u1', 5122: '<i2', 5123: '<u2', 5125: '<u4', 5126: '<f4'}
WIDTHS = {'SCALAR': 1, 'VEC2': 2, 'VEC3': 3, 'VEC4': 4, 'MAT2': 4, 'MAT3': 9, 'MAT4': 16}


class Document(NamedTuple):
  """A glTF file."""

  header: dict[str, Any]
  blob: bytes  # the binary chunk of a GLB file
  get: Callable[[str], bytes]  # the content of a file that it names; UserError
  buffers: dict[int, bytes]  # those that were read before


def items(document: Document, key: str) -> list[dict[str, Any]]:
  """A list in the header, empty if it is missing."""
  return document.header.get(key) or []


def view(document: Document, index: int) -> tuple[bytes, int]:
  """(content, stride) of a buffer view; the stride is 0 if none is given.

  Raises:
    UserError: it extends beyond its buffer.
  """
  described = items(document, 'bufferViews')[_natural(index)]
  if 'EXT_meshopt_compression' in described.get('extensions', {}):
    # The extension's own fallback is a buffer that holds nothing.
    raise UserError(packed('EXT_meshopt_compression'))
  buffer = _buffer(document, described['buffer'])
  start, length = described.get('byteOffset', 0), described['byteLength']
  if not 0 <= start <= start + length <= len(buffer):
    raise UserError(f'its buffer view {index} extends beyond its buffer')
  return buffer[start : start + length], described.get('byteStride', 0)


def packed(extension: str) -> str:
  """The error message for data compressed by an extension."""
  return (
    f'its meshes are packed with {extension}; unpack it first, for example with'
    ' `gltf-transform copy IN.glb OUT.glb`'
  )


def values(document: Document, index: int) -> np.ndarray:
  """The [count, width] values of an accessor as float64, normalised integers in [-1, 1]."""
  raw = raw_values(document, index)
  described = items(document, 'accessors')[index]
  result = raw.astype(np.float64)
  if described.get('normalized') and raw.dtype.kind in 'iu':
    result = np.maximum(result / np.iinfo(raw.dtype).max, -1)
  return result


def raw_values(document: Document, index: int) -> np.ndarray:
  """The [count, width] values of an accessor in its own type.

  Raises:
    UserError: it declares more values than there are.
    Exception: its description is wrong.
  """
  described = items(document, 'accessors')[_natural(index)]
  dtype = np.dtype(TYPES[described['componentType']])
  width, count = WIDTHS[described['type']], _natural(described['count'])
  if 'bufferView' in described:
    content, stride = view(document, described['bufferView'])
    result = _strided(content, described.get('byteOffset', 0), stride, count, dtype, width)
  else:  # zeros, for which room is made
    if count > MAX_FACES:
      raise UserError(f'it declares {count} values and holds none')
    result = np.zeros((count, width), dtype)
  if 'sparse' in described:
    sparse = described['sparse']
    number = _natural(sparse['count'])
    where, content = sparse['indices'], sparse['values']
    kind = np.dtype(TYPES[where['componentType']])
    place = view(document, where['bufferView'])[0]
    at = _strided(place, where.get('byteOffset', 0), 0, number, kind, 1)[:, 0]
    data = view(document, content['bufferView'])[0]
    result = result.copy()
    result[at] = _strided(data, content.get('byteOffset', 0), 0, number, dtype, width)
  return result


def _strided(content, start, stride, count, dtype, width):
  """[count, width] values from bytes, `stride` bytes apart."""
  size = dtype.itemsize * width
  stride = stride or size
  if _natural(start) + (count - 1) * _natural(stride) + size > len(content) and count:
    raise UserError(f'it declares {count} values and holds fewer')
  if not count:
    return np.zeros((0, width), dtype)
  return np.ndarray((count, width), dtype, content, offset=start, strides=(stride, dtype.itemsize))


def _buffer(document, index):
  index = _natural(index)
  if index not in document.buffers:
    described = items(document, 'buffers')[index]
    uri = described.get('uri')
    document.buffers[index] = document.blob if uri is None else read_uri(document, uri)
  return document.buffers[index]


def read_uri(document: Document, uri: str) -> bytes:
  """The content of a data URI or of a file beside this one.

  Raises:
    UserError: there is no such file, or the data URI is damaged.
  """
  head, comma, text = uri.partition('base64,')
  if not (comma and head.startswith('data:')):
    return document.get(uri)
  try:
    return base64.b64decode(text)
  except binascii.Error as e:
    raise UserError(f'one of its data URIs is damaged: {e}') from e


def _natural(number):
  """Checks a count or index: negative ones would count from the end, bools pass as integers."""
  if not isinstance(number, int) or isinstance(number, bool) or number < 0:
    raise UserError(f'it has {str(number)[:40]!r} instead of an index or count')
  return number
