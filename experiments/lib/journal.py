"""The log of a training run: WORKDIR/log.jsonl, and the same for TensorBoard.

A line of log.jsonl is one JSON object, either of two:

  {"step", "epoch", <metric>: its mean over the steps since the line before, ...}
  {"step", "epoch", "validation": {<metric>: mean, ...}}

It has neither times nor speeds, so that an interrupted and resumed run leaves the same bytes as an
uninterrupted one. TensorBoard's files are in WORKDIR/tensorboard. Everything is on disk
when a function returns.
"""

import contextlib
import json
import os
import time
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from tensorboardX import summary
from tensorboardX.event_file_writer import EventsWriter
from tensorboardX.proto import event_pb2

from cvn import files
from cvn.errors import UserError


class Journal(NamedTuple):
  """An open journal."""

  path: str  # of log.jsonl
  # Not tensorboardX's SummaryWriter: its thread loses an error, and then blocks the program.
  events: EventsWriter


@contextlib.contextmanager
def open_journal(workdir: str, step: int) -> Iterator[Journal]:
  """Opens the journal of a run at `step`, and drops the lines of later steps.

  Raises:
    UserError: the files cannot be read or written.
  """
  path = os.path.join(workdir, 'log.jsonl')
  kept = [line for line in _read_lines(path) if _step_of(line) <= step]
  with files.atomic_write(path) as temporary, open(temporary, 'w') as f:
    f.writelines(kept)
  folder = os.path.join(workdir, 'tensorboard')
  with _user_errors(folder):
    os.makedirs(folder, exist_ok=True)
    # tensorboardX counts in seconds, and writes over a file of the same second.
    events = EventsWriter(os.path.join(folder, 'events'), f'.{time.time_ns()}')
    restart = event_pb2.SessionLog(status=event_pb2.SessionLog.START)
    _write_event(events, event_pb2.Event(step=step + 1, session_log=restart))
  try:
    yield Journal(path, events)
  finally:
    with contextlib.suppress(OSError):  # the write that met a full disk has reported it
      events.close()


def write_line(journal: Journal, step: int, epoch: float, values: dict[str, Any]) -> None:
  """Appends a line to log.jsonl, and its numbers to TensorBoard.

  Raises:
    UserError: the files cannot be written.
  """
  with _user_errors(journal.path), open(journal.path, 'a') as f:
    f.write(json.dumps({'step': step, 'epoch': epoch, **values}) + '\n')
  for name, value in values.items():
    for key, number in value.items() if isinstance(value, dict) else [(None, value)]:
      write_scalar(journal, step, f'{name}/{key}' if key else f'train/{name}', number)


def write_scalar(journal: Journal, step: int, name: str, value: float) -> None:
  """Writes a number for TensorBoard only.

  Raises:
    UserError: the file cannot be written.
  """
  _write_summary(journal, step, summary.scalar(name, value))


def write_picture(journal: Journal, step: int, name: str, image: np.ndarray) -> None:
  """Writes a uint8 image [H, W, 3] for TensorBoard.

  Raises:
    UserError: the file cannot be written.
  """
  _write_summary(journal, step, summary.image(name, image, dataformats='HWC'))


def _write_summary(journal, step, value):
  with _user_errors('the TensorBoard file'):
    _write_event(journal.events, event_pb2.Event(step=step, summary=value))


def _write_event(events, event):
  event.wall_time = time.time()
  events.write_event(event)
  events.flush()


@contextlib.contextmanager
def _user_errors(path):
  try:
    yield
  except OSError as e:
    raise UserError(f'cannot write {path}: {e.strerror or e}') from e


def _read_lines(path):
  try:
    with open(path, errors='replace') as f:
      return f.readlines()
  except FileNotFoundError:
    return []
  except OSError as e:
    raise UserError(f'cannot read {path}: {e.strerror}') from e


def _step_of(line):
  """The step of a line; infinite if the line was cut off by a sudden end."""
  try:
    return json.loads(line)['step'] if line.endswith('\n') else float('inf')
  except (ValueError, KeyError, TypeError):
    return float('inf')
