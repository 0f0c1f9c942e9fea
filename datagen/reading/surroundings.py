"""The files that a mesh file names, found where it says or nearby, never outside.

A name is looked up as written, with Windows' habits allowed (datagen/reading/files.py). Of an
absolute path or a URL, only the last part is searched for, among the model's own files. The same is
done for a relative path that does not exist, for archives that were unpacked differently.
"""

import posixpath
import urllib.parse
from typing import NamedTuple

from cvn.errors import UserError
from datagen.reading import notes as notes_lib
from datagen.reading.files import Files, find, is_elsewhere

# Folders of pictures beside a model or beside its folder; case does not matter.
PICTURE_FOLDERS = ('textures', 'texture', 'images', 'image', 'maps', 'materials', 'tex')


class Surroundings(NamedTuple):
  """The location of a mesh file, and what was found while reading it."""

  files: Files
  folder: str  # of the mesh file; '' is the topmost
  stem: str  # of its name
  missing: set[str]  # files and materials that are named in vain
  notes: set[str]  # of datagen.reading.notes
  found: dict[tuple[str, str], tuple[str, bytes] | None]  # what was looked for before


def surroundings(files: Files, name: str) -> Surroundings:
  """The surroundings of the mesh file `name`."""
  stem = posixpath.splitext(posixpath.basename(name))[0]
  return Surroundings(files, posixpath.dirname(name), stem, set(), set(), {})


def find_named(
  around: Surroundings, name: str, folder: str | None = None
) -> tuple[str, bytes] | None:
  """Finds a file that is named by the mesh file, or by a file that the mesh file names.

  Args:
    around: the mesh file's surroundings; a file that does not exist is added to `missing`.
    name: as written: a relative path, an absolute path of any system, or a URI.
    folder: folder to search first; None for the mesh file's folder.

  Returns:
    (its name below `around.files`, its content), or None.

  Raises:
    UserError: a relative name leads out, or the file cannot be read.
  """
  plain = name.strip().strip('"\'').strip()
  key = (plain, around.folder if folder is None else folder)
  if key not in around.found:
    around.found[key] = _look(around, plain, key[1]) if plain else None
    if plain and around.found[key] is None:
      around.missing.add(plain)
  return around.found[key]


def _look(around, name, folder):
  # glTF and DAE have URIs, and in MTL a comment may follow.
  variants = (name, urllib.parse.unquote(name), name.split(' #')[0].strip())
  spellings = [spelling for spelling in dict.fromkeys(variants) if spelling]
  folders = list(dict.fromkeys((folder, around.folder)))
  for spelling in spellings:
    if not is_elsewhere(spelling.replace('\\', '/')):
      for where in folders:
        try:
          return find(around.files, where, spelling)
        except FileNotFoundError:
          continue
  for spelling in spellings:
    last = posixpath.basename(spelling.replace('\\', '/').rstrip('/'))
    if last in ('', '.', '..') or is_elsewhere(last):
      continue
    for where in (*folders, *_near(around, folders)):
      try:
        found = find(around.files, where, last)
      except FileNotFoundError:
        continue
      around.notes.add(notes_lib.PICTURE_GUESSED)
      return found
  return None


def _near(around, folders):
  """Folders in which a model's images are kept if they are not where it says."""
  for folder in folders:
    for name in (*PICTURE_FOLDERS, around.stem, f'{around.stem}_textures'):
      yield posixpath.join(folder, name)
  for folder in folders:
    if folder:
      for name in PICTURE_FOLDERS:
        yield posixpath.join(posixpath.dirname(folder), name)


def read_text(content: bytes, notes: set[str]) -> bytes:
  r"""A text decoded from UTF-8, with line ends \n and without a byte-order mark.

  Args:
    content: UTF-8, UTF-16 with its byte-order mark, or anything else, which is read as Latin-1.
    notes: set that gets a note of that guess.

  Raises:
    UserError: it starts like UTF-16 and is not.
  """
  if content[:2] in (b'\xff\xfe', b'\xfe\xff'):
    try:
      content = content.decode('utf-16').encode()
    except UnicodeDecodeError as e:
      raise UserError('it starts like UTF-16 text but is not: save it as UTF-8') from e
  content = content.removeprefix(b'\xef\xbb\xbf')
  if not content.isascii():
    try:
      content.decode()
    except UnicodeDecodeError:
      content = content.decode('latin-1').encode()
      notes.add(notes_lib.TEXT_GUESSED)
  if b'\r' in content:
    content = content.replace(b'\r\n', b'\n').replace(b'\r', b'\n')
  return content
