"""Stages of a longer work: the project's programs run one after the other, and what they leave."""

import json
import os
import shlex
import subprocess
import sys
import time
from typing import Any

from absl import flags

from cvn.errors import UserError
from cvn.files import atomic_write


def run_program(folder: str, program: str, **named: Any) -> str:
  """Runs one of the project's programs, and adds its seconds to those of earlier runs of it.

  Args:
    folder: where the seconds are noted.
    program: its module.
    **named: its flags.

  Returns:
    The command.

  Raises:
    UserError: it failed; it has said why itself.
  """
  arguments = [program, *(f'--{k}={v}' for k, v in named.items())]
  line = shlex.join(['python', '-m', *arguments])
  print(f'\n$ {line}', flush=True)
  start = time.monotonic()
  process = subprocess.Popen([sys.executable, '-m', *arguments])
  try:
    status = process.wait()
  except KeyboardInterrupt:
    process.wait()  # it got the interrupt too, and may be saving
    raise
  finally:
    path = _seconds_file(folder)
    seconds = read_json(path) if os.path.exists(path) else {}
    seconds[line] = seconds.get(line, 0) + time.monotonic() - start
    with atomic_write(path) as temporary, open(temporary, 'w') as out:
      json.dump(seconds, out, indent=1)
  if status:
    raise UserError(f'{program} ended with status {status}, see above')
  return line


def seconds_of(line: str, folder: str) -> float:
  """How long a command has run there in all."""
  return read_json(_seconds_file(folder))[line]


def argv() -> list[str]:
  """The command of this process, with the contents of flag files in the place of their names.

  Programs store it beside their results.
  """
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


def _seconds_file(folder):
  return os.path.join(folder, 'seconds.json')
