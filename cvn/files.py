"""Files that appear whole or not at all."""

import contextlib
import os
import tempfile
from collections.abc import Iterator

from cvn.errors import UserError

try:
  import fcntl
except ImportError:  # not a POSIX system
  fcntl = None


@contextlib.contextmanager
def atomic_write(path: str) -> Iterator[str]:
  """Yields a temporary name beside `path`, with its suffix, and renames it to `path` at the end.

  The folder is made where it is missing. When the body raises, nothing is left behind.

  Raises:
    UserError: the place cannot be written (no permission, no space, a file where a folder is due).
  """
  folder, name = os.path.split(os.path.abspath(path))
  try:
    os.makedirs(folder, exist_ok=True)
    handle, temporary = tempfile.mkstemp(prefix='.', suffix=os.path.splitext(name)[1], dir=folder)
    os.close(handle)
    os.chmod(temporary, 0o644)
  except OSError as e:
    raise UserError(f'cannot write {path}: {e.strerror}') from e
  try:
    yield temporary
    os.replace(temporary, path)
  except OSError as e:
    raise UserError(f'cannot write {path}: {e.strerror or e}') from e
  finally:
    with contextlib.suppress(FileNotFoundError):
      os.unlink(temporary)


@contextlib.contextmanager
def locked(path: str | os.PathLike) -> Iterator[None]:
  """Lets one process at a time run the body, if the file can be made and its system has locks."""
  with contextlib.ExitStack() as stack:
    with contextlib.suppress(OSError, AttributeError):
      os.makedirs(os.path.dirname(path), exist_ok=True)
      file = stack.enter_context(open(path, 'w'))
      fcntl.flock(file, fcntl.LOCK_EX)
    yield
