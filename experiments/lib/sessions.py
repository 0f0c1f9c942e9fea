"""WORKDIR/sessions.jsonl: how a training was started, each time.

A line is {"settings", "command", "step", "versions", "revision", "processes", "devices"}: all that
it takes to do the same again. The settings of the last one are the defaults of the next.
"""

import importlib.metadata
import json
import os
import pathlib
import platform
import subprocess
import sys
from collections.abc import Mapping
from typing import Any

import jax

from cvn.errors import UserError

NAME = 'sessions.jsonl'
PACKAGES = 'jax jaxlib flax optax orbax-checkpoint grain tensorstore numpy'.split()


def write(workdir: str, settings: Mapping[str, Any], step: int) -> None:
  """Appends a line for this start of the program.

  Args:
    workdir: the run's folder.
    settings: JSON values.
    step: of the checkpoint that the session continues, 0 for none.

  Raises:
    UserError: the file cannot be written.
  """
  line = {
    'settings': dict(settings),
    'command': sys.argv,
    'step': step,
    'versions': {'Python': platform.python_version(), **_versions()},
    'revision': revision(),
    'processes': jax.process_count(),
    'devices': f'{jax.device_count()} x {jax.devices()[0].device_kind}',
  }
  path = os.path.join(workdir, NAME)
  try:
    with open(path, 'a') as f:
      f.write(json.dumps(line) + '\n')
  except OSError as e:
    raise UserError(f'cannot write {path}: {e.strerror}') from e


def last_settings(workdir: str) -> dict[str, Any]:
  """The settings of the last session of a run, {} if there was none.

  A line that was cut off by a sudden end is passed over.

  Raises:
    UserError: the file is damaged, or cannot be read.
  """
  path = os.path.join(workdir, NAME)
  try:
    with open(path) as f:
      lines = f.read().split('\n')[:-1]
    return json.loads(lines[-1])['settings'] if lines else {}
  except (FileNotFoundError, NotADirectoryError):
    return {}
  except OSError as e:
    raise UserError(f'cannot read {path}: {e.strerror}') from e
  except (ValueError, KeyError, TypeError) as e:
    raise UserError(f'{path} is damaged: give all flags of the run, or remove it') from e


def revision() -> str | None:
  """The git revision of this source, with a + if files differ from it; None outside of git."""
  here = pathlib.Path(__file__).parent
  try:
    commands = ('rev-parse', 'HEAD'), ('status', '--porcelain', '--untracked-files=no')
    found = [
      subprocess.run(
        ['git', '-C', str(here), *c], capture_output=True, text=True, check=True, timeout=10
      ).stdout.strip()
      for c in commands
    ]
  except (OSError, subprocess.SubprocessError):
    return None
  return found[0] + ('+' if found[1] else '')


def _versions():
  found = {}
  for name in PACKAGES:
    try:
      found[name] = importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:  # installed otherwise
      found[name] = None
  return found
