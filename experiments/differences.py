"""How numbers were made here where the paper's were made otherwise."""

from collections import Counter

from absl import flags

from cvn import data
from cvn.dataset import open_dataset

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
  'seeds': 'not said',
}


def find_differences(f: flags.FlagValues) -> dict[str, str]:
  """What the shared flags of experiments.protocol say that is not the paper's.

  Returns:
    Keys of `PAPER`, and what is done here.
  """
  ours = {
    'models to train on': _count(f, 'train', f.train_source),
    'models to test on': _count(f, 'test', f.source),
    'networks': 'one a category' if f.models == 'category' else 'one for all categories',
    'epochs': str(1 if f.quick else f.epochs),
    'batch': str(f.batch_size),
    'learning rate': PAPER['learning rate'] if f.learning_rate is None else f'{f.learning_rate:g}',
    'arithmetic': f.dtype,
    'BatchNorm at test time': (
      f'statistics of {f.fresh_statistics} fresh batches'
      if f.fresh_statistics
      else PAPER['BatchNorm at test time']
    ),
  }
  return {k: v for k, v in ours.items() if v != PAPER[k]}


def to_text(differences: dict[str, str]) -> str:
  """A line a difference, the paper's in brackets."""
  lines = [f'- {k}: {v} [{PAPER[k]}]' for k, v in differences.items()]
  return '\n'.join(['Made otherwise than in the paper (its way in brackets):', *lines])


def _count(f, split, sources):
  dataset = open_dataset(f.data)
  models = [dataset.manifest.models[r] for r in data.select_rows(dataset, split, f.category)]
  counts = Counter((m.category, m.source) for m in models if not sources or m.source in sources)
  return ', '.join(f'{n:,} {category} ({source})' for (category, source), n in counts.items())
