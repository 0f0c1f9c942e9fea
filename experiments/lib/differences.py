"""Deviations from the paper's protocol, read from the stored configurations of runs."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from experiments.lib import runs
from experiments.lib.runs import Run

PAPER_VIEWS = (220_500, 1_186_000)  # 500 epochs of 441 guitars, of 2372 cars
PAPER = {
  'data': 'ShapeNet: 3,389 cars, 2,199 chairs, 2,539 tables, 631 guitars; people: 367 meshes',
  'networks': 'one a category',
  'models to train on': '441 (guitars) to 2,372 (cars) a network',
  'models to test on': '678 cars, 440 chairs, 508 tables, 127 guitars',
  'epochs': '500',
  'batch': '60',
  'learning rate': '0.0003',
  'views seen by a network': f'{PAPER_VIEWS[0]:,} to {PAPER_VIEWS[1]:,}',
  'arithmetic': 'float32',
  'BatchNorm at test time': 'running averages',
  'seeds': 'not stated',
}


def find_differences(
  used: Iterable[Run], tested: Mapping[str, Mapping[str, Any]]
) -> dict[str, str]:
  """The deviations of runs and test models from the paper's.

  Args:
    used: the runs of all networks.
    tested: `category` and `source` of each test model, by id.

  Returns:
    Our values by the keys of `PAPER`.
  """
  found = describe(list(used)) | {'models to test on': count_models(tested)}
  return {k: v for k, v in found.items() if v != PAPER[k]}


def describe(used: Sequence[Run]) -> dict[str, str]:
  """The values of runs by the keys of `PAPER`; different values are separated by commas."""
  counts: dict[str, None] = {}
  for run in used:
    counts |= dict.fromkeys(f'{n:,} {name}' for name, n in run.config['counts'].items())
  return {
    'models to train on': ', '.join(counts),
    'networks': say_scope(used),
    'epochs': _distinct(f'{runs.epochs_of(run):.4g}' for run in used),
    'batch': _distinct(str(run.config['batch_size']) for run in used),
    'learning rate': _distinct(f'{run.config["learning_rate"]:g}' for run in used),
    'arithmetic': _distinct(run.config['dtype'] for run in used),
    'BatchNorm at test time': _distinct(_say_statistics(run.config) for run in used),
  }


def say_scope(used: Iterable[Run]) -> str:
  """Whether networks were trained on one category or on all, in words."""
  single = {len(run.config['category']) == 1 for run in used}
  return _distinct('one a category' if s else 'one for all categories' for s in sorted(single))


def say_training(used: Iterable[Run]) -> str:
  """The scope, the epochs and the seeds of networks, for a caption."""
  used = list(used)
  epochs = _distinct(f'{runs.epochs_of(run):.4g}' for run in used)
  seeds = _distinct(str(run.config['seed']) for run in used)
  return f'Networks: {say_scope(used)}, epochs: {epochs}, seed {seeds}.'


def count_models(models: Mapping[str, Mapping[str, Any]]) -> str:
  """The number of models of each category and source, in words."""
  counts: dict[str, int] = {}
  for m in models.values():
    name = f'{m["category"]} ({m["source"]})'
    counts[name] = counts.get(name, 0) + 1
  return ', '.join(f'{n:,} {name}' for name, n in counts.items())


def to_text(differences: Mapping[str, str]) -> str:
  """A line for each difference, with the paper's value in brackets."""
  lines = [f'- {k}: {v} [{PAPER[k]}]' for k, v in differences.items()]
  return '\n'.join(["Deviations from the paper's protocol (its values in brackets):", *lines])


def _say_statistics(config):
  count = config['fresh_statistics']
  return f'statistics of {count} fresh batches' if count else PAPER['BatchNorm at test time']


def _distinct(values):
  return ', '.join(dict.fromkeys(values))
