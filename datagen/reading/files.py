"""The files of a folder or a zip archive, read one by one into memory; nothing is unpacked.

Names have `/` as separator. Files from strangers cannot reach other files: a name that leaves the
folder, by `..`, an absolute path, a URL or a symbolic link, is refused, and so is a file that is,
or unpacks to, more than `MAX_FILE` bytes.
"""

import contextlib
import functools
import os
import posixpath
import re
import unicodedata
import zipfile
import zlib
from collections.abc import Callable, Iterator
from typing import NamedTuple

from cvn.errors import UserError

MAX_FILE = 1 << 29  # bytes: an OBJ file of some million faces
MAX_MEMBERS = 1_000_000  # of an archive
METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # others make room for all they may unpack to


class Files(NamedTuple):
  """A folder or archive: its names, and how to read a file."""

  path: str  # of the folder or archive
  names: Callable[..., list[str]]  # (folder='') -> all of them below it, sorted
  read: Callable[[str], bytes]  # FileNotFoundError where there is no such file; UserError
  alike: Callable[
    [str], str | None
  ]  # a file whose name differs in case or in how accents are written


def folder_files(path: str) -> Files:
  """The files of a folder and its subfolders, except hidden ones.

  The folder itself may be a symbolic link; a link inside must not lead out of it.
  """
  root = os.path.realpath(path)

  def names(folder=''):
    found = []
    top = os.path.join(root, *_inside(path, folder).split('/'))
    for here, folders, files in os.walk(top):
      folders[:] = [name for name in folders if not name.startswith('.')]
      below = os.path.relpath(here, root)
      found += [os.path.normpath(os.path.join(below, n)) for n in files if not n.startswith('.')]
    return sorted(name.replace(os.sep, '/') for name in found)

  def read(name):
    plain = _inside(path, name)
    file = os.path.realpath(os.path.join(root, *plain.split('/')))
    if os.path.commonpath([root, file]) != root:
      raise UserError(f'{name!r} leads out of {path}: all files must be inside')
    if not os.path.isfile(file):  # a device or a pipe could be read forever
      raise FileNotFoundError(f'{path} has no file {name}')
    try:
      with open(file, 'rb') as f:
        size = os.fstat(f.fileno()).st_size
        _check_size(path, name, size)
        return f.read(size)
    except OSError as e:
      raise UserError(f'{name} in {path} cannot be read: {e.strerror}') from e

  def alike(name):
    found = ''
    for part in _inside(path, name).split('/'):
      folder = os.path.join(root, found)
      # A name as it is goes first: of `a/B` and `A/b` either may hold what is wanted.
      others = sorted(os.listdir(folder)) if os.path.isdir(folder) else []
      same = [n for n in others if _folded(n) == _folded(part)]
      if not same:
        return None
      found = posixpath.join(found, part if part in same else same[0])
    return found

  return Files(path, names, read, alike)


@contextlib.contextmanager
def archive_files(path: str) -> Iterator[Files]:
  """The files of a zip archive, which stays open as long as the context.

  A member whose name leads out of the archive does not exist.

  Raises:
    UserError: it is not a zip archive, or has too many members.
  """
  with contextlib.ExitStack() as stack:
    try:
      archive = stack.enter_context(zipfile.ZipFile(path))
    except (OSError, zipfile.BadZipFile, NotImplementedError, ValueError) as e:
      raise UserError(
        f'{path} cannot be read as a zip archive: {getattr(e, "strerror", e) or e}'
      ) from e
    members = {}
    for info in archive.infolist():
      name = info.filename.replace('\\', '/')  # as some programs for Windows write them
      plain = _plain(name)
      if plain and name and not name.endswith('/'):
        members[plain] = info
    if len(members) > MAX_MEMBERS:
      raise UserError(f'{path} has more than {MAX_MEMBERS} members')

    def names(folder=''):
      start = posixpath.join(folder, '')
      return sorted(name for name in members if name.startswith(start))

    def read(name):
      info = members.get(_inside(path, name))
      if info is None:
        raise FileNotFoundError(f'{path} has no file {name}')
      _check_size(path, name, info.file_size)  # no more than this is unpacked, even if it is a lie
      if info.compress_type not in METHODS:
        raise UserError(f'{name} in {path} is not compressed by deflate: make the archive again')
      try:
        with archive.open(info) as f:
          return f.read(info.file_size)
      except (zipfile.BadZipFile, zlib.error, EOFError, OSError) as e:
        raise UserError(f'{name} in {path} is damaged: {e}') from e
      except (NotImplementedError, RuntimeError) as e:  # it needs a password, or a newer zipfile
        raise UserError(f'{name} in {path} cannot be unpacked: {e}') from e

    @functools.cache
    def by_folded_name():
      return {_folded(name): name for name in sorted(members, reverse=True)}

    def alike(name):
      return by_folded_name().get(_folded(_inside(path, name)))

    yield Files(path, names, read, alike)


def find(files: Files, folder: str, name: str) -> tuple[str, bytes]:
  """The file that another file in `folder` calls `name`, with Windows' habits allowed.

  Separators may be backslashes. If no name agrees exactly, case and the encoding of accents may
  differ.

  Args:
    files: the files to search.
    folder: folder of the file that names it; '' is the top.
    name: relative to that folder.

  Returns:
    (its name in `files`, its content).

  Raises:
    FileNotFoundError: it does not exist.
    UserError: it is outside, too large, or unreadable.
  """
  name = name.strip().replace('\\', '/')
  wanted = name if is_elsewhere(name) else posixpath.normpath(posixpath.join(folder, name))
  try:
    return wanted, files.read(wanted)
  except FileNotFoundError:
    alike = files.alike(wanted)
    if alike is None:
      raise
    return alike, files.read(alike)


def is_elsewhere(name: str) -> bool:
  """Whether a name is an absolute path, also of Windows, or a URL."""
  return name.startswith('/') or re.match(r'[A-Za-z]:|[A-Za-z][\w+.-]+:/', name) is not None


def _folded(name):
  """A form that is the same for names that differ in case or in the encoding of accents."""
  return unicodedata.normalize('NFC', name).lower()


def _plain(name):
  """The normalised name; None if it leads out."""
  plain = posixpath.normpath(name)
  leaves = '\0' in name or is_elsewhere(name) or plain.split('/')[0] == '..'
  return None if leaves else plain


def _inside(path, name):
  plain = _plain(name)
  if plain is None:
    raise UserError(f'{name!r} leads out of {path}: all files must be inside')
  return plain


def _check_size(path, name, size):
  if size > MAX_FILE:
    raise UserError(f'{name} in {path} is larger than {MAX_FILE >> 20} MiB')
