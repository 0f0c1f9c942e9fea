"""Files written atomically, and locks."""

import contextlib
import os
import socket
import tempfile
import time
from collections.abc import Iterator

from cvn.errors import UserError

try:
  import fcntl
except ImportError:  # not a POSIX system
  fcntl = None


@contextlib.contextmanager
def atomic_write(path: str) -> Iterator[str]:
  """Yields a temporary name beside `path`, with its suffix, and renames it to `path` at the end.

  The folder is created if missing. If the body raises, nothing is left behind.

  Raises:
    UserError: the file cannot be written (permission, space, or a file in the place of a folder).
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
def locked(path: str | os.PathLike, *, seconds: float = 60) -> Iterator[None]:
  """Lets one process at a time run the body, if possible.

  The body runs without the lock if the file cannot be created, the system has no locks, or another
  process (maybe a stopped one) holds the lock for too long.

  Args:
    path: the lock, an empty file that stays.
    seconds: maximum time to wait for another process.
  """
  with contextlib.ExitStack() as stack:
    with contextlib.suppress(OSError, AttributeError):
      os.makedirs(os.path.dirname(path), exist_ok=True)
      file = stack.enter_context(open(path, 'w'))
      deadline = time.monotonic() + seconds
      while True:
        try:
          fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
          break
        except BlockingIOError:
          if time.monotonic() > deadline:
            break
          time.sleep(0.1)
    yield


@contextlib.contextmanager
def exclusive(folder: str) -> Iterator[None]:
  """Keeps other processes out of a folder while the body runs.

  The lock ends with the process, however that ends. File systems without locks do not lock.

  Args:
    folder: an existing folder; `.lock` in it names the process that holds the lock, and stays.

  Raises:
    UserError: another process holds the lock.
  """
  path = os.path.join(folder, '.lock')
  with contextlib.ExitStack() as stack:
    with contextlib.suppress(OSError, AttributeError):
      file = stack.enter_context(open(path, 'a+'))
      try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
      except BlockingIOError as e:
        file.seek(0)
        holder = file.read(200).strip() or 'another process'
        raise UserError(
          f'{folder} is in use by {holder}: wait for its end, or name another folder'
        ) from e
      file.truncate(0)
      file.write(f'process {os.getpid()} on {socket.gethostname()}\n')
      file.flush()
    yield
