"""The files of a folder or of a zip archive, read one by one into memory; nothing is unpacked.

Names have `/` between their parts. What strangers send stays where it is: a name that leaves the
folder, by `..`, an absolute path or a symbolic link, is refused, and so is a file that is, or
unpacks to, more than `MAX_FILE` bytes.
"""

import contextlib
import lzma
import os
import posixpath
import zipfile
import zlib
from collections.abc import Callable, Iterator
from typing import NamedTuple

from cvn.errors import UserError

MAX_FILE = 1 << 29  # bytes: an OBJ file of some million faces
MAX_MEMBERS = 1_000_000  # of an archive


class Files(NamedTuple):
  """Where they are, their names, and how to read one."""

  path: str  # of the folder or archive
  names: Callable[..., list[str]]  # (folder='') -> all of them below it, sorted
  read: Callable[[str], bytes]  # FileNotFoundError where there is no such file; UserError


def folder_files(path: str) -> Files:
  """The files of a folder and its subfolders, hidden ones left out."""
  root = os.path.realpath(path)

  def names(folder=''):
    found = []
    for folder, folders, files in os.walk(os.path.join(root, *_inside(path, folder).split('/'))):
      folders[:] = [name for name in folders if not name.startswith('.')]
      below = os.path.relpath(folder, root)
      found += [os.path.normpath(os.path.join(below, n)) for n in files if not n.startswith('.')]
    return sorted(name.replace(os.sep, '/') for name in found)

  def read(name):
    plain = _inside(path, name)
    file = os.path.realpath(os.path.join(root, *plain.split('/')))
    if os.path.commonpath([root, file]) != root:
      raise UserError(f'{path}: {name} leads out of the folder')
    if not os.path.isfile(file):  # a device or a pipe could be read forever
      raise FileNotFoundError(f'{path} has no file {name}')
    with open(file, 'rb') as f:
      return _bounded(path, name, f)

  return Files(path, names, read)


@contextlib.contextmanager
def archive_files(path: str) -> Iterator[Files]:
  """The files of a zip archive, open as long as the context is.

  Raises:
    UserError: it is no zip archive, or has too many members.
  """
  with contextlib.ExitStack() as stack:
    try:
      archive = stack.enter_context(zipfile.ZipFile(path))
    except (OSError, zipfile.BadZipFile, NotImplementedError, ValueError) as e:
      raise UserError(
        f'{path} cannot be read as a zip archive: {getattr(e, "strerror", e) or e}'
      ) from e
    if len(archive.infolist()) > MAX_MEMBERS:
      raise UserError(f'{path} has more than {MAX_MEMBERS} members')

    def names(folder=''):
      start = posixpath.join(folder, '')
      found = (i.filename for i in archive.infolist() if not i.is_dir())
      return sorted(name for name in found if name.startswith(start))

    def read(name):
      plain = _inside(path, name)
      try:
        with archive.open(plain) as f:
          return _bounded(path, name, f)
      except KeyError as e:
        raise FileNotFoundError(f'{path} has no file {name}') from e
      except (zipfile.BadZipFile, zlib.error, lzma.LZMAError, EOFError, OSError) as e:
        raise UserError(f'{path}: {name} is damaged: {e}') from e
      except (NotImplementedError, RuntimeError) as e:  # a method of packing, or a password
        raise UserError(f'{path}: {name} cannot be unpacked: {e}') from e

    yield Files(path, names, read)


def find(files: Files, folder: str, name: str) -> tuple[str, bytes]:
  """The file that another one in `folder` calls `name`, with Windows' habits forgiven.

  Separators may be backslashes, and case may differ where no name agrees exactly.

  Args:
    files: where to look.
    folder: of the file that names it; '' is the topmost.
    name: relative to that folder.

  Returns:
    (its name in `files`, its content).

  Raises:
    FileNotFoundError: there is none.
    UserError: it lies outside, is too large, or cannot be read.
  """
  wanted = posixpath.normpath(posixpath.join(folder, name.strip().replace('\\', '/')))
  try:
    return wanted, files.read(wanted)
  except FileNotFoundError:
    alike = [n for n in files.names(folder) if n.lower() == wanted.lower()]
    if not alike:
      raise
    return alike[0], files.read(alike[0])


def _inside(path, name):
  """The name in its plain form."""
  plain = posixpath.normpath(name)
  if '\0' in name or plain.startswith(('/', '../')) or plain == '..' or plain[1:2] == ':':
    raise UserError(f'{path}: {name!r} leads out of it')
  return plain


def _bounded(path, name, stream):
  """All that a stream holds, unless it is too much."""
  content = stream.read(MAX_FILE + 1)
  if len(content) > MAX_FILE:
    raise UserError(f'{path}: {name} is larger than {MAX_FILE >> 20} MiB')
  return content
