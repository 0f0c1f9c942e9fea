"""Trainings and evaluations, made where they are missing and reused where they are those asked for.

A run is reused where its stored configuration is the one that experiments.train would store, field
by field, and it has as many epochs as are asked for; with fewer it goes on. A file of scores is
reused where its stored options are those that experiments.evaluate would store; where its networks
have been trained further since, or anew, it is made anew. Everything else is an error that names
the field, both values, and the way out. So what is said of numbers can be read from what is stored.
"""

import os
from collections.abc import Iterable
from typing import Any, NamedTuple

from cvn import checkpoint
from cvn.errors import UserError
from experiments.lib import evaluation, training
from experiments.lib.stages import read_json, run_program


class Run(NamedTuple):
  """A training as its folder tells it."""

  workdir: str
  config: dict[str, Any]  # see training.make_config
  step: int  # of the newest checkpoint; 0 without one


def read(workdir: str) -> Run:
  """What is stored of a run.

  Raises:
    UserError: there is none, or it is damaged.
  """
  return Run(workdir, checkpoint.read_config(workdir), checkpoint.latest_step(workdir) or 0)


def epochs_of(run: Run) -> float:
  """How often a run has seen each of its models."""
  return run.step / steps_per_epoch(run.config)


def steps_per_epoch(config: dict[str, Any]) -> int:
  """Training steps in an epoch: whole batches only."""
  return config['models'] // config['batch_size']


def of_report(report: dict[str, Any]) -> list[Run]:
  """The runs of the networks that a report of experiments.evaluate is about, as it tells them."""
  found = report['options']['runs']
  return [Run(report[kind], run['config'], run['step']) for kind, run in found.items()]


def to_json(used: Iterable[Run]) -> dict[str, dict[str, Any]]:
  """What is stored of runs, by the names of their folders, as JSON values."""
  return {
    os.path.basename(run.workdir): {'step': run.step, 'epochs': epochs_of(run), **run.config}
    for run in used
  }


def train(folder: str, **named: Any) -> Run:
  """A training with these flags of experiments.train, or what is missing of it.

  Args:
    folder: where the seconds are noted.
    **named: the flags.

  Raises:
    UserError: the workdir holds another training, or the program failed.
  """
  workdir = named['workdir']
  if not _is_finished(workdir, training.configuration(**named), named['epochs']):
    run_program(folder, 'experiments.train', **named)
  return read(workdir)


def evaluate(folder: str, **named: Any) -> dict[str, Any]:
  """The report of experiments.evaluate with these flags, from its file --json where it is there.

  Args:
    folder: where the seconds are noted.
    **named: the flags.

  Raises:
    UserError: the file is of another evaluation, or the program failed.
  """
  path = named['json']
  if os.path.exists(path):
    report, asked = read_json(path), evaluation.options(**named)
    stored = report.get('options') if isinstance(report, dict) else None
    if not isinstance(stored, dict):
      raise UserError(f'{path} does not tell how it was made: delete it and run this again')
    if stored.get('runs') == asked['runs']:
      checkpoint.compare(path, stored, asked)
      return report
  run_program(folder, 'experiments.evaluate', **named)
  return read_json(path)


def _is_finished(workdir, asked, epochs):
  """Whether the run is there with all its epochs; raises where another one is."""
  if not os.path.lexists(os.path.join(workdir, 'config.json')):
    return False
  checkpoint.start(workdir, asked)
  step = checkpoint.latest_step(workdir) or 0
  return training.is_finished(workdir, step, steps_per_epoch(asked), epochs)
