"""Trainings and evaluations: made if they are missing, reused if they are the ones asked for.

A run is reused if its stored configuration equals the one that experiments.train would store, field
by field, and it has the epochs asked for; with fewer epochs it continues. A file of scores is
reused if its stored options equal those that experiments.evaluate would store; if its networks have
changed since, it is made again. Everything else is an error that names the field, both values, and
the way out. So captions and headers can be written from the stored configuration.
"""

import os
from collections.abc import Iterable
from typing import Any, NamedTuple

from cvn import checkpoint
from cvn.errors import UserError
from experiments.lib import evaluation, training
from experiments.lib.stages import read_json, run_program


class Run(NamedTuple):
  """A training as stored in its folder."""

  workdir: str
  config: dict[str, Any]  # see training.make_config
  step: int  # of the newest checkpoint; 0 without one


def read(workdir: str) -> Run:
  """Reads a run from its folder.

  Raises:
    UserError: the folder has none, or it is damaged.
  """
  return Run(workdir, checkpoint.read_config(workdir), checkpoint.latest_step(workdir) or 0)


def epochs_of(run: Run) -> float:
  """The number of times that a run has seen each of its models."""
  return run.step / steps_per_epoch(run.config)


def steps_per_epoch(config: dict[str, Any]) -> int:
  """Training steps in an epoch: whole batches only."""
  return config['models'] // config['batch_size']


def of_report(report: dict[str, Any]) -> list[Run]:
  """The runs of the networks in a report of experiments.evaluate."""
  found = report['options']['runs']
  return [Run(report[kind], run['config'], run['step']) for kind, run in found.items()]


def to_json(used: Iterable[Run]) -> dict[str, dict[str, Any]]:
  """Runs by the names of their folders, as JSON values."""
  return {
    os.path.basename(run.workdir): {'step': run.step, 'epochs': epochs_of(run), **run.config}
    for run in used
  }


def train(folder: str, **named: Any) -> Run:
  """Trains with these flags of experiments.train, unless that is done.

  Args:
    folder: where the seconds are kept.
    **named: the flags.

  Raises:
    UserError: the workdir holds another training, or the program failed.
  """
  workdir = named['workdir']
  if not _is_finished(workdir, training.configuration(**named), named['epochs']):
    run_program(folder, 'experiments.train', **named)
  return read(workdir)


def evaluate(folder: str, **named: Any) -> dict[str, Any]:
  """The report of experiments.evaluate with these flags, from its file --json if it exists.

  Args:
    folder: where the seconds are kept.
    **named: the flags.

  Raises:
    UserError: the file is of another evaluation, or the program failed.
  """
  path = named['json']
  if os.path.exists(path):
    report, asked = read_json(path), evaluation.options(**named)
    stored = report.get('options') if isinstance(report, dict) else None
    if not isinstance(stored, dict):
      raise UserError(f'{path} does not say how it was made: delete it and run this again')
    if stored.get('runs') == asked['runs']:
      checkpoint.compare(path, stored, asked)
      return report
  run_program(folder, 'experiments.evaluate', **named)
  return read_json(path)


def _is_finished(workdir, asked, epochs):
  """Whether the run exists with all its epochs; raises if another run is in its place."""
  if not os.path.lexists(os.path.join(workdir, 'config.json')):
    return False
  checkpoint.start(workdir, asked)
  step = checkpoint.latest_step(workdir) or 0
  return training.is_finished(workdir, step, steps_per_epoch(asked), epochs)
