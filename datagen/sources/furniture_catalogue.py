"""Catalogues of Sweet Home 3D's furniture libraries.

A library (a `.sh3f` file, or the `.jar` of the program itself) is a zip archive of models with a
catalogue in Java's properties format: keys `name#N`, `model#N`, ... for piece N, and some without a
number for the whole library. Translations are files of their own with names only.
"""

import posixpath
import re
from typing import NamedTuple

from cvn.errors import UserError
from datagen.reading.files import Files

MAX_CATALOGUE = 1 << 24  # bytes; the largest real one has 0.15 million
_CATALOGUE = re.compile(
  r'[A-Za-z]*FurnitureCatalog\.properties'
)  # no language behind an underscore
_BLANKS = ' \t\f'


class Piece(NamedTuple):
  """A catalogue's entry for a model, as written; '' for missing values."""

  model: str  # its mesh file in the archive
  id: str
  name: str
  tags: tuple[str, ...]
  rotation: str  # a matrix, row by row, that sets the model upright and to the front
  size: tuple[str, str, str]  # of the turned model along x, y and z, in centimetres
  creator: str
  licence: str


def read_catalogue(files: Files) -> list[Piece]:
  """The pieces of a library in the order of its catalogue; none if it has no catalogue.

  Raises:
    UserError: a catalogue cannot be read.
  """
  pieces = []
  for name in files.names():
    if not _CATALOGUE.fullmatch(posixpath.basename(name)):
      continue
    content = files.read(name)
    if len(content) > MAX_CATALOGUE:
      raise UserError(f'{files.path}: {name} is larger than {MAX_CATALOGUE >> 20} MiB')
    pieces += _pieces(parse_properties(content.decode('latin-1')), posixpath.dirname(name))
  return pieces


def _pieces(properties, folder):
  """A catalogue's pieces; model paths are relative to the archive's root or to the catalogue."""
  numbers = [key[6:] for key in properties if re.fullmatch(r'model#[0-9]{1,9}', key)]
  pieces = []
  for number in sorted(numbers, key=int):

    def value(key, number=number):
      text = properties.get(f'{key}#{number}') or properties.get(key, '')
      return ' '.join(text.split())

    pieces.append(
      Piece(
        model=posixpath.normpath(posixpath.join('/', folder, value('model'))).lstrip('/'),
        id=value('id'),
        name=value('name'),
        tags=tuple(tag.strip() for tag in value('tags').split(',')),
        rotation=value('modelRotation'),
        size=(value('width'), value('height'), value('depth')),
        creator=value('creator'),
        licence=value('license'),
      )
    )
  return pieces


def parse_properties(text: str) -> dict[str, str]:
  r"""Keys and values of a file in Java's properties format.

  Lines are `key=value`, `key: value` or `key value`. Lines that begin with # or ! are comments. A \
  at the end of a line joins it with the next, \uXXXX is a UTF-16 unit, and \ escapes any other
  character.
  """
  properties = {}
  lines = iter(re.split(r'\r\n?|\n', text))
  for line in lines:
    parts = [line.lstrip(_BLANKS)]
    if not parts[0] or parts[0][0] in '#!':
      continue
    while (len(parts[-1]) - len(parts[-1].rstrip('\\'))) % 2:
      parts[-1] = parts[-1][:-1]
      parts.append(next(lines, '').lstrip(_BLANKS))
    key, value = re.fullmatch(
      r'((?:\\.|[^\\=: \t\f])*)[ \t\f]*[=:]?[ \t\f]*(.*)', ''.join(parts), re.DOTALL
    ).groups()
    properties[_unescape(key)] = _unescape(value)
  return properties


def _unescape(text):
  """Replaces escapes by their text."""
  plain = re.sub(r'\\(u([0-9A-Fa-f]{4})|.)', _escaped, text, flags=re.DOTALL)
  # What lies beyond 16 bits has two escapes, which belong together.
  return plain.encode('utf-16', 'surrogatepass').decode('utf-16', 'replace')


def _escaped(match):
  if match[2]:
    return chr(int(match[2], 16))
  return {'t': '\t', 'n': '\n', 'r': '\r', 'f': '\f'}.get(match[1], match[1])
