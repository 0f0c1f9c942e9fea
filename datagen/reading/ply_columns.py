"""The elements of a PLY file, text or binary, as columns of numbers."""

import re
from typing import NamedTuple

import numpy as np

from cvn.errors import UserError

TYPES = {
  'char': 'i1', 'int8': 'i1', 'uchar': 'u1', 'uint8': 'u1', 'short': 'i2', 'int16': 'i2',
  'ushort': 'u2', 'uint16': 'u2', 'int': 'i4', 'int32': 'i4', 'uint': 'u4', 'uint32': 'u4',
  'float': 'f4', 'float32': 'f4', 'double': 'f8', 'float64': 'f8',
}  # fmt: skip
ORDERS = {'ascii': '=', 'binary_little_endian': '<', 'binary_big_endian': '>'}
MAX_HEADER = 1 << 16  # bytes
MAX_PROPERTIES = 1024


class _Property(NamedTuple):
  name: str
  dtype: str
  length: str = ''  # a list's dtype of its length; '' for one value


class _Element(NamedTuple):
  name: str
  count: int
  properties: list[_Property]


def read_columns(content: bytes) -> tuple[dict[str, dict], list[str]]:
  """Reads all elements.

  Args:
    content: the file's bytes.

  Returns:
    ({element: {property: values [n] or, for a list, (lengths [n], values)}}, names of images);
    names of elements are singular and in lower case.

  Raises:
    UserError: it is not a PLY file, or holds less than it declares.
  """
  order, elements, pictures, body = _header(content)
  text = None
  if order == '=':
    try:
      text = np.array(body.split(), np.float64)
    except ValueError as e:
      raise UserError('it contains something that is not a number') from e
  found, at = {}, 0
  for element in elements:
    _check_count(element, len(body) if text is None else len(text), at)
    read = _read_text if text is not None else _read_binary
    columns, at = read(element, body if text is None else text, at, order)
    found.setdefault(element.name.rstrip('s').lower(), columns)
  return found, pictures


def _header(content):
  """(byte order, elements, names of images, the rest of the file)."""
  match = re.search(rb'\bend_header[ \t]*(\r\n|\n|\r)', content[:MAX_HEADER])
  if not content.startswith(b'ply') or match is None:
    raise UserError('it has no header')
  lines = re.split(r'\r\n|\n|\r', content[: match.start()].decode('utf-8', 'replace'))
  if '\ufffd' in ''.join(lines):
    lines = re.split(r'\r\n|\n|\r', content[: match.start()].decode('latin-1'))
  order, elements, pictures, properties = None, [], [], 0
  for line in lines[1:]:
    words = line.split()
    if not words:
      continue
    if words[0] == 'format':
      order = ORDERS[words[1]]
    elif words[0] == 'element':
      count = int(words[2])
      if count < 0:
        raise UserError(f'it declares {count} {words[1]}')
      elements.append(_Element(words[1], count, []))
    elif words[0] == 'property':
      properties += 1
      if properties > MAX_PROPERTIES:
        raise UserError(f'it has more than {MAX_PROPERTIES} properties')
      if words[1] == 'list':
        described = _Property(words[4], TYPES[words[3]], TYPES[words[2]])
      else:
        described = _Property(words[2], TYPES[words[1]])
      elements[-1].properties.append(described)
    elif words[0] == 'comment' and words[1:2] and words[1].lower() == 'texturefile':
      pictures.append(line.split(None, 2)[2] if len(words) > 2 else '')
  if order is None:
    raise UserError('its header does not state its format')
  return order, elements, pictures, content[match.end() :]


def _check_count(element, size, at):
  """Checks that the file is large enough: each declared item takes at least a byte, or a number."""
  if element.count and not element.properties:
    raise UserError(f'its {element.name} has no properties')
  if element.count > size - at:
    raise UserError(f'it declares {element.count} {element.name} and holds fewer')


def _read_text(element, values, at, _):
  """({property: values [n] or, for a list, (lengths [n], values)}, the position after them)."""
  lists = [n for n, p in enumerate(element.properties) if p.length]
  width = len(element.properties)
  if not lists:
    end = at + element.count * width
    if end > len(values):
      raise UserError(f'it declares {element.count} {element.name} and holds fewer')
    table = values[at:end].reshape(element.count, width)
    return {p.name: _typed(table[:, n], p.dtype) for n, p in enumerate(element.properties)}, end
  columns = {p.name: [] for p in element.properties}
  lengths = {element.properties[n].name: [] for n in lists}
  row = _uniform(element, values, at)
  if row is not None:
    return row
  for _ in range(element.count):
    for p in element.properties:
      if at >= len(values):
        raise UserError(f'it declares {element.count} {element.name} and holds fewer')
      if not p.length:
        columns[p.name].append(values[at : at + 1])
        at += 1
        continue
      length = values[at]
      if not 0 <= length <= len(values) - at - 1:
        raise UserError(f'a list of its {element.name} has {length:g} values')
      columns[p.name].append(values[at + 1 : at + 1 + int(length)])
      lengths[p.name].append(int(length))
      at += 1 + int(length)
  return _joined(element, columns, lengths), at


def _uniform(element, values, at):
  """Reads text whose lists all have the length of the first one; None if they do not."""
  if not element.count:
    return {p.name: (np.zeros(0, np.int64), np.zeros(0)) for p in element.properties}, at
  places, place = [], 0
  for p in element.properties:
    if at + place >= len(values):
      return None
    length = int(values[at + place]) if p.length and 0 <= values[at + place] < 1e6 else -1
    if p.length and length < 0:
      return None
    places.append((p, place, length))
    place += 1 + max(length, 0) if p.length else 1
  end = at + element.count * place
  if end > len(values):
    return None
  table = values[at:end].reshape(element.count, place)
  columns = {}
  for p, first, length in places:
    if not p.length:
      columns[p.name] = _typed(table[:, first], p.dtype)
    elif (table[:, first] != length).any():
      return None
    else:
      columns[p.name] = (
        np.full(element.count, length),
        _typed(table[:, first + 1 : first + 1 + length].ravel(), p.dtype),
      )
  return columns, end


def _joined(element, columns, lengths):
  result = {}
  for p in element.properties:
    joined = np.concatenate([np.zeros(0), *columns[p.name]])
    values = _typed(joined, p.dtype)
    result[p.name] = (np.array(lengths[p.name], np.int64), values) if p.length else values
  return result


def _typed(values, dtype):
  """Numbers of a text in their declared type, if they fit."""
  kind = np.dtype(dtype)
  if kind.kind == 'f':
    return values
  limits = np.iinfo(kind)
  return np.nan_to_num(values).clip(limits.min, limits.max).astype(kind)


def _read_binary(element, body, at, order):
  """`_read_text` for binary files."""
  row = _binary_row(element, body, at, order)
  if row is not None:
    dtype, lengths = row
    end = at + element.count * dtype.itemsize
    if end <= len(body):
      table = np.frombuffer(body, dtype, element.count, at)
      if all((table[f'n{n}'] == length).all() for n, length in lengths.items()):
        columns = {}
        for n, p in enumerate(element.properties):
          values = table[f'v{n}']
          columns[p.name] = values
          if p.length:
            columns[p.name] = (np.full(element.count, lengths[n]), values.reshape(-1))
        return columns, end
    if not lengths:
      raise UserError(f'it declares {element.count} {element.name} and holds fewer')
  columns = {p.name: [] for p in element.properties}
  counts = {p.name: [] for p in element.properties}
  types = [
    (p, np.dtype(order + p.dtype), np.dtype(order + p.length) if p.length else None)
    for p in element.properties
  ]
  for _ in range(element.count):
    for p, dtype, length_type in types:
      length = 1
      if length_type is not None:
        if at + length_type.itemsize > len(body):
          raise UserError(f'it declares {element.count} {element.name} and holds fewer')
        length = int(np.frombuffer(body, length_type, 1, at)[0])
        at += length_type.itemsize
        counts[p.name].append(length)
      if not 0 <= length * dtype.itemsize <= len(body) - at:
        raise UserError(f'it declares {element.count} {element.name} and holds fewer')
      columns[p.name].append(np.frombuffer(body, dtype, length, at))
      at += length * dtype.itemsize
  result = {}
  for p, dtype, length_type in types:
    values = np.concatenate([np.zeros(0, dtype), *columns[p.name]])
    result[p.name] = values if length_type is None else (np.array(counts[p.name], np.int64), values)
  return result, at


def _binary_row(element, body, at, order):
  """(type of a row, lengths of lists by property) if all rows are like the first one."""
  fields, lengths, place = [], {}, at
  for n, p in enumerate(element.properties):
    dtype = np.dtype(order + p.dtype)
    if not p.length:
      fields.append((f'v{n}', dtype))
      place += dtype.itemsize
      continue
    length_type = np.dtype(order + p.length)
    if place + length_type.itemsize > len(body):
      return None
    length = int(np.frombuffer(body, length_type, 1, place)[0])
    place += length_type.itemsize + length * dtype.itemsize
    if length < 0 or place > len(body):
      return None
    lengths[n] = length
    fields += [(f'n{n}', length_type), (f'v{n}', dtype, (length,))]
  return np.dtype(fields), lengths
