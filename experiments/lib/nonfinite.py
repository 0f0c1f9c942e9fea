"""What a training leaves where a loss or a gradient is not finite, and how to look at it.

WORKDIR/nonfinite/checkpoints/<step>     the state before that step, as of cvn.checkpoint
WORKDIR/nonfinite/<step>-<process>.npz   the process's part of the batch, as stored
WORKDIR/nonfinite/<step>-<process>.json  {'step', 'names', 'metrics'}: its models and views
"""

import json
import os
import pathlib
from collections.abc import Callable, Sequence
from typing import Any, NoReturn

import jax
import numpy as np

from cvn import checkpoint, data, files
from cvn.errors import UserError

SHOWN = 8  # names in a message


def stop(
  workdir: str, at: int, state: Any, batch: Any, names: Sequence[str], metrics: dict[str, float]
) -> NoReturn:
  """Saves what led to metrics that are not finite, and stops the training.

  Args:
    workdir: the run's folder.
    at: the step that has these metrics.
    state: before that step.
    batch: this process's part of it, as NumPy arrays.
    names: the models and views in it.
    metrics: of the step.

  Raises:
    UserError: always.
  """
  folder = _folder(workdir)
  stem = os.path.join(folder, f'{at}-{jax.process_index()}')
  with files.atomic_write(f'{stem}.npz') as temporary, open(temporary, 'wb') as f:
    np.savez(f, **batch._asdict())
  found = {'step': at, 'names': list(names), 'metrics': {k: str(v) for k, v in metrics.items()}}
  with files.atomic_write(f'{stem}.json') as temporary, open(temporary, 'w') as f:
    json.dump(found, f, indent=1)
  checkpoint.save(folder, state, {})
  bad = ', '.join(f'{k} became {v}' for k, v in metrics.items() if not np.isfinite(v))
  shown = ', '.join(names[:SHOWN]) + (', ...' if len(names) > SHOWN else '')
  raise UserError(
    f'{bad} at step {at}, training stopped. The state before it and its batch ({shown}) are in'
    f' {folder}: --workdir={workdir} --replay computes the step again and says where. The last'
    ' checkpoint is from before; try a smaller --learning_rate in another workdir'
  )


def replay(workdir: str, template: Any, step: Callable, evaluate: Callable) -> None:
  """Computes the newest saved step again, and prints what is not finite in it.

  Args:
    workdir: the run's folder.
    template: a training state.
    step: (state, batch) -> (state, metrics), as in the training.
    evaluate: (state, batch) -> metrics with running statistics.

  Raises:
    UserError: there is no such step, or its files are damaged.
  """
  folder = _folder(workdir)
  restored = checkpoint.restore(folder, template)
  if restored is None:
    raise UserError(f'{folder} holds no step: no loss of this training was ever not finite')
  state, _ = restored
  batch, names = _read_batch(folder, int(state.step) + 1)
  _print_range('parameters', state.params)
  _print_range('batch statistics', state.batch_stats)
  for n, name in enumerate(names):
    found = evaluate(state, jax.tree.map(lambda x, n=n: x[n : n + 1], batch))
    print(f'  {name} alone: {_format(found)}')
  kept = jax.tree.map(lambda x: x.copy(), state)
  print(f'step {int(state.step) + 1}: {_format(step(state, batch)[1])}')
  try:
    with jax.debug_nans(True), jax.debug_infs(True):
      step(kept, batch)
  except FloatingPointError as e:
    print(f'first in: {str(e).splitlines()[0]}')


def _read_batch(folder, at):
  """(the parts of all processes together, their names)."""
  stems = [str(p.with_suffix('')) for p in sorted(pathlib.Path(folder).glob(f'{at}-*.npz'))]
  parts, names = [], []
  try:
    for stem in stems:
      with np.load(f'{stem}.npz') as arrays:
        kind = data.Batch if 'flow' in arrays else data.ShapeBatch
        parts.append(kind(**arrays))
      with open(f'{stem}.json') as f:
        names += json.load(f)['names']
    return jax.tree.map(lambda *x: np.concatenate(x), *parts), names
  except (OSError, ValueError, KeyError, TypeError) as e:
    raise UserError(f'the batch of step {at} in {folder} is damaged: {e}') from e


def _print_range(name, tree):
  leaves = jax.tree_util.tree_leaves_with_path(jax.device_get(tree))
  bad = [jax.tree_util.keystr(path) for path, x in leaves if not np.isfinite(x).all()]
  largest = max((float(np.abs(x).max()), jax.tree_util.keystr(path)) for path, x in leaves)
  print(f'{name}: the largest is {largest[0]:.4g} in {largest[1]}; not finite: {bad or "none"}')


def _format(metrics):
  return ', '.join(f'{k} {float(v):.6g}' for k, v in metrics.items())


def _folder(workdir):
  return os.path.join(workdir, 'nonfinite')
