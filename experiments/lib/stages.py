"""Programs that run other programs, and the files that programs leave for each other."""

import contextlib
import json
import math
import os
import shlex
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from typing import Any

from absl import flags

from cvn.errors import UserError
from cvn.files import atomic_write


def run_program(folder: str, program: str, **named: Any) -> str:
  """Runs one of the project's programs and adds its seconds to those of earlier runs.

  Args:
    folder: where the seconds are kept, in seconds.json.
    program: its module.
    **named: its flags.

  Returns:
    The command.

  Raises:
    UserError: the program failed; it has printed the reason itself.
  """
  arguments = [program, *(f'--{k}={v}' for k, v in named.items())]
  line = shlex.join(['python', '-m', *arguments])
  print(f'\n$ {line}', flush=True)
  start = time.monotonic()
  process = subprocess.Popen([sys.executable, '-m', *arguments])
  try:
    status = process.wait()
  except KeyboardInterrupt:
    process.wait()  # it was interrupted too, and may be saving
    raise
  finally:
    seconds = read_seconds(folder)
    seconds[line] = seconds.get(line, 0) + time.monotonic() - start
    write_json(os.path.join(folder, 'seconds.json'), seconds)
  if status:
    raise UserError(f'{program} ended with status {status}, see above')
  return line


def read_seconds(folder: str) -> dict[str, float]:
  """The commands that `run_program` has run for a folder, in order, and their seconds."""
  path = os.path.join(folder, 'seconds.json')
  if not os.path.exists(path):
    return {}
  with damage(path):
    return {str(line): float(seconds) for line, seconds in read_json(path).items()}


def argv() -> list[str]:
  """The command of this process, with the contents of flag files in place of their names."""
  spec = sys.modules['__main__'].__spec__
  name = spec.name.removesuffix('.__main__') if spec else ''
  program = ['python', '-m', name] if name else [os.path.basename(sys.argv[0])]
  return [*program, *flags.FLAGS.read_flags_from_files(sys.argv[1:])]


def read_bytes(path: str) -> bytes:
  try:
    with open(path, 'rb') as f:
      return f.read()
  except OSError as e:
    raise UserError(f'cannot read {path}: {e.strerror}') from e


def read_json(path: str) -> Any:
  try:
    return json.loads(read_bytes(path))
  except ValueError as e:
    raise UserError(f'{path} is damaged: remove it and run this again') from e


def write_json(path: str, value: Any) -> None:
  """Writes a file that appears whole; named tuples become objects, NaN becomes null."""
  with atomic_write(path) as temporary:
    dump(temporary, value)


def dump(path: str, value: Any) -> None:
  """Writes into a file of `cvn.files.atomic_write`."""
  with open(path, 'w') as out:
    out.write(json.dumps(plain(value), indent=1, allow_nan=False) + '\n')


def write_results(path: str, results: Mapping[str, Any]) -> None:
  """Writes results as JSON, with the command of this process."""
  write_json(path, {'argv': argv(), **results})


def plain(value: Any) -> Any:
  """A value as JSON has it: named tuples as dictionaries, NaN as None."""
  if hasattr(value, '_asdict'):
    value = value._asdict()
  if isinstance(value, Mapping):
    return {k: plain(v) for k, v in value.items()}
  if isinstance(value, list | tuple):
    return [plain(v) for v in value]
  return None if isinstance(value, float) and math.isnan(value) else value


@contextlib.contextmanager
def damage(path: str) -> Iterator[None]:
  """Turns the exceptions of reading a file of another form into a `UserError` that names it."""
  try:
    yield
  except (AttributeError, IndexError, KeyError, OSError, TypeError, ValueError) as e:
    raise UserError(f'{path} is damaged or of another version: remove it and make it again') from e
