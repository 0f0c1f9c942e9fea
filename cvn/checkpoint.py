"""A training run's folder: its configuration and its checkpoints.

  WORKDIR/config.json         the kind of network, the recipe and all that a resumed run must share
  WORKDIR/checkpoints/<step>  Orbax checkpoints, the latest KEEP of them:
      variables               {'params', 'batch_stats'}: all that inference needs
      optimizer               {'opt_state', 'step'}
      _CHECKPOINT_METADATA    includes `progress`, JSON values that the run keeps beside the state

A checkpoint gets its number once it is complete. The remains of an interrupted save have another
name, are never read, and are removed by the next save. Saving is synchronous: the state is 80 MB,
and the next step donates the buffers that would be read.
"""

import contextlib
import json
import os
import shutil
from collections.abc import Mapping
from typing import Any

import jax
import numpy as np
from absl import logging
from orbax.checkpoint import v1 as ocp

from cvn import files
from cvn.errors import UserError

FORMAT = 1
KEEP = 2
NOT_COMPARED = ('data', 'categories')  # the data set is identified by its digest


def start(workdir: str, config: dict[str, Any]) -> None:
  """Begins a run, or checks that an existing run is the same.

  Args:
    workdir: the folder; it is created if missing.
    config: 'network', a key of networks.NETWORKS, and every setting that must not change; JSON
      values.

  Raises:
    UserError: the folder holds another run, or cannot be written.
  """
  config = {'format': FORMAT, **config}
  path = os.path.join(workdir, 'config.json')
  if os.path.lexists(path):
    compare(workdir, read_config(workdir), config)
    return
  with files.atomic_write(path) as temporary, open(temporary, 'w') as f:
    f.write(json.dumps(config, indent=1) + '\n')


def compare(place: str, stored: Mapping[str, Any], asked: Mapping[str, Any]) -> None:
  """Compares a stored configuration with the requested one, field by field.

  Args:
    place: the folder or file, for the message.
    stored: the configuration that is stored there; JSON values.
    asked: the requested configuration.

  Raises:
    UserError: a field differs; the message has its name, both values and the way out.
  """
  asked = json.loads(json.dumps(asked))
  for name in {**stored, **asked}:
    if name not in NOT_COMPARED and stored.get(name) != asked.get(name):
      old, new = (_show(name, config) for config in (stored, asked))
      raise UserError(
        f'{place} was made with {name}={old}, not {new}: keep {name} as it was, name another'
        f' --workdir, or delete {place}'
      )


def read_config(workdir: str) -> dict[str, Any]:
  """The settings a run was begun with.

  Raises:
    UserError: the folder holds no run, or one of another version.
  """
  path = os.path.join(workdir, 'config.json')
  try:
    with open(path) as f:
      config = json.load(f)
  except (FileNotFoundError, NotADirectoryError) as e:
    raise UserError(
      f'{workdir} is no training folder: it has no config.json (experiments.train makes one)'
    ) from e
  except OSError as e:
    raise UserError(f'cannot read {path}: {e.strerror}') from e
  except ValueError as e:
    raise UserError(f'{path} is damaged: it is not JSON') from e
  if not isinstance(config, dict) or config.get('format') != FORMAT:
    raise UserError(f'{path} is not of format {FORMAT}: train again with this version')
  return config


def latest_step(workdir: str) -> int | None:
  """The step of the newest checkpoint; None if there is none yet."""
  return max(_steps(workdir), default=None)


def save(workdir: str, state: Any, progress: dict[str, Any]) -> None:
  """Writes a checkpoint under the state's step, and removes all but the latest.

  Args:
    workdir: the run's folder.
    state: cvn.train.TrainState.
    progress: JSON values that the run keeps beside the state, such as the data iterator's state.

  Raises:
    UserError: the checkpoint cannot be written.
  """
  checkpoints = os.path.join(os.path.abspath(workdir), 'checkpoints')
  try:
    with (
      _quiet(),
      ocp.training.Checkpointer(
        checkpoints,
        preservation_policy=ocp.training.preservation_policies.LatestN(KEEP),
        cleanup_tmp_directories=True,
      ) as checkpointer,
    ):
      checkpointer.save_checkpointables(
        int(state.step), _to_checkpointables(state), force=True, custom_metadata=progress
      )
  except Exception as e:  # whatever the storage raised: Orbax has no exception of its own for it
    raise UserError(f'cannot write a checkpoint to {checkpoints}: {_reason(e)}') from e


def restore(
  workdir: str, template: Any, *, last_good: bool = False
) -> tuple[Any, dict[str, Any]] | None:
  """The state and the progress of the newest checkpoint; None where there is none yet.

  Args:
    workdir: the run's folder.
    template: a TrainState of the same structure, shapes and shardings as the result's.
    last_good: whether to take an older checkpoint if the newest is damaged. The damaged one is
      moved to WORKDIR/damaged-<step>, and a line says so.

  Raises:
    UserError: the checkpoint is damaged, or of another version.
  """

  def as_abstract(x):
    return jax.ShapeDtypeStruct(x.shape, x.dtype, sharding=x.sharding)

  def load(path):
    stored = ocp.checkpointables_metadata(path)
    progress, loaded = stored.custom_metadata, {}
    for name, x in _to_checkpointables(template).items():
      count = len(jax.tree.leaves(stored.metadata[name]))  # 0 if it is damaged
      if count not in (0, len(jax.tree.leaves(x))):
        raise UserError(
          f'{path} was written by another version: its network can be used, but not trained'
          ' further; name another --workdir'
        )
      # One by one: when one of several fails, Orbax drops the others with a warning.
      loaded |= ocp.load_checkpointables(path, {name: jax.tree.map(as_abstract, x)})[name]
    return template._replace(**loaded), progress

  steps = sorted(_steps(workdir))
  while steps:
    step = steps.pop()
    try:
      return _load(workdir, step, load)
    except UserError as e:
      if not (last_good and steps):
        raise
      logging.warning('%s; training continues from step %d', e, steps[-1])
      if jax.process_index() == 0:
        _move_aside(workdir, step)
  return None


def load_network(workdir: str, *kinds: str) -> tuple[dict[str, Any], dict[str, Any]]:
  """A trained network, for inference.

  Args:
    workdir: the run's folder.
    *kinds: the accepted kinds of networks.

  Returns:
    (config, variables): the run's settings, and {'params', 'batch_stats'} of its newest checkpoint
    as numpy arrays, whatever devices it was trained on.

  Raises:
    UserError: the folder has no such network, no checkpoint yet, or a damaged one.
  """
  config = read_config(workdir)
  if config.get('network') not in kinds:
    needed = ' or '.join(kinds)
    raise UserError(f'{workdir} holds a {config.get("network")} network, a {needed} one is needed')
  step = latest_step(workdir)
  if step is None:
    raise UserError(f'{workdir} has no checkpoint yet: train it first (experiments.train)')

  def load(path):
    saved = ocp.checkpointables_metadata(path).metadata['variables']
    abstract = jax.tree.map(lambda x: np.empty(x.shape, x.dtype), saved)
    return ocp.load_checkpointables(path, {'variables': abstract})['variables']

  return config, _load(workdir, step, load)


def _steps(workdir: str) -> list[int]:
  """The steps of all checkpoints."""
  try:
    names = os.listdir(os.path.join(workdir, 'checkpoints'))
  except OSError:
    return []
  return [int(n) for n in names if n.isdecimal()]


def _move_aside(workdir: str, step: int) -> None:
  """Makes room for a new checkpoint of a step whose old one is damaged."""
  aside = os.path.join(workdir, f'damaged-{step}')
  try:
    shutil.rmtree(aside, ignore_errors=True)  # of a training that came here before
    os.rename(os.path.join(workdir, 'checkpoints', str(step)), aside)
  except OSError as e:
    raise UserError(f'cannot move the damaged checkpoint to {aside}: {e.strerror}') from e


def _show(name: str, config: Mapping[str, Any]) -> Any:
  """A field's value; a data set's digest with the place where the data set lay."""
  value = config.get(name)
  return f'{value} ({config.get("data")})' if name == 'data_digest' else value


def _to_checkpointables(state):
  return {
    'variables': {'params': state.params, 'batch_stats': state.batch_stats},
    'optimizer': {'opt_state': state.opt_state, 'step': state.step},
  }


def _load(workdir, step, load):
  path = os.path.join(os.path.abspath(workdir), 'checkpoints', str(step))
  try:
    with _quiet():
      return load(path)
  except UserError:
    raise
  except Exception as e:  # damage shows in as many ways as there are files
    raise UserError(
      f'the checkpoint {path} is damaged ({_reason(e)}): --restore=last_good trains on from the one'
      ' before'
    ) from e


@contextlib.contextmanager
def _quiet():
  """Silences Orbax, which logs everything and prints tracebacks of errors that it also raises."""
  before = logging.get_verbosity()
  logging.set_verbosity(logging.FATAL)
  try:
    yield
  finally:
    logging.set_verbosity(before)


def _reason(e: BaseException) -> str:
  """The original error in one line; of a long one the end, where storage errors give the reason."""
  while e.__cause__ is not None:
    e = e.__cause__
  line = (str(e).strip() or type(e).__name__).split('\n', 1)[0].split(' [', 1)[0]
  return line if len(line) <= 120 else '...' + line[-120:]
