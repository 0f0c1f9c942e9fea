"""The settings of experiments.evaluate: its flags, and what is stored of them.

What is stored identifies an evaluation: it is reused only where all of it is the same.
"""

import math
from typing import Any

from absl import flags

from cvn import blending, checkpoint, data, metrics, readouts
from cvn.dataset import SPLITS, Dataset, digest, open_dataset

ALPHAS = (0.2, 0.4, 0.6, 0.8, 1.0)  # of the paper's tables


def define_flags(f: flags.FlagValues) -> None:
  """The program's flags. Not at import: there the names of several programs would collide."""
  own = {'flag_values': f}
  flags.DEFINE_string('data', None, 'The data set: a folder or URL of datagen.generate.', **own)
  flags.DEFINE_string('shape', None, 'The workdir of the network for shapes.', **own)
  flags.DEFINE_string('color', None, 'The workdir of the network for colours.', **own)
  flags.DEFINE_enum('split', 'test', SPLITS, 'The models to evaluate on.', **own)
  flags.DEFINE_list('category', [], 'Categories to evaluate on; all of them by default.', **own)
  flags.DEFINE_list('source', [], 'Sources of models to evaluate on; all by default.', **own)
  flags.DEFINE_string(
    'threshold',
    None,
    "From which score on a voxel is occupied; 'val' chooses it on the split val. By default"
    f' {metrics.OCCUPIED}, of r2n2 {readouts.THRESHOLDS["r2n2"]}.',
    **own,
  )
  flags.DEFINE_string(
    'alpha',
    str(blending.ALPHA),
    "In (0, 1]: the smaller, the more the sampled colours count; 'val' chooses it on the split val,"
    f' of {", ".join(map(str, ALPHAS))}.',
    **own,
  )
  flags.DEFINE_bool(
    'flip', False, 'Take means with what the networks say of the mirrored views.', **own
  )
  flags.DEFINE_bool(
    'carve',
    False,
    "Carve shapes by the views' silhouettes; the azimuth is told from the estimated shape.",
    **own,
  )
  flags.DEFINE_bool('baselines', False, 'Evaluate the trivial baselines, too.', **own)
  flags.DEFINE_string(
    'reference_data',
    None,
    'The data set whose splits val and train thresholds, alpha and baselines come from; --data'
    ' itself by default.',
    **own,
  )
  flags.DEFINE_list(
    'reference_source',
    [],
    "Sources of its models of the split val; by default all of --reference_data's, or --source.",
    **own,
  )
  flags.DEFINE_string('json', None, 'A file for the numbers.', **own)
  flags.mark_flag_as_required('data', f)
  flags.register_validator('alpha', is_alpha, "must be in (0, 1], or 'val'", f)
  flags.register_validator('threshold', is_threshold, "must be a number or 'val'", f)


def options(**named: Any) -> dict[str, Any]:
  """What the program stores as its options when it is started with some flags."""
  f = flags.FlagValues()
  define_flags(f)
  f(['evaluate', *(f'--{k}={v}' for k, v in named.items())])
  return make_options(f, open_dataset(f.data))


def make_options(f: flags.FlagValues, dataset: Dataset) -> dict[str, Any]:
  """All that the numbers depend on, as JSON values.

  `runs` tells of each network the configuration and the step of its checkpoint. The digest is of
  the models of all splits: thresholds are chosen on val, baselines are made of train.
  """
  rows = [row for s in SPLITS for row in data.select_rows(dataset, s, categories=f.category)]
  names = ('split', 'category', 'source', 'alpha', 'threshold', 'flip', 'carve', 'baselines')
  reference = {}
  if f.reference_data:
    other = open_dataset(f.reference_data)
    used = [row for s in ('train', 'val') for row in data.select_rows(other, s)]
    reference = {'reference_data': other.root, 'reference_digest': digest(other, used)}
  if f.reference_source:
    reference['reference_source'] = f.reference_source
  return {
    'data': dataset.root,
    'data_digest': digest(dataset, rows),
    **reference,
    **{n: f[n].value for n in names},
    'runs': {k: describe_run(f[k].value) for k in ('shape', 'color') if f[k].value},
  }


def describe_run(workdir: str) -> dict[str, Any]:
  """What identifies a network, wherever its data lay: configuration and step of its run."""
  config = checkpoint.read_config(workdir)
  config = {k: v for k, v in config.items() if k not in checkpoint.NOT_COMPARED}
  return {'step': checkpoint.latest_step(workdir), 'config': config}


def is_threshold(text: str | None) -> bool:
  """Whether the flag says something that can be done."""
  if text in (None, 'val'):
    return True
  try:
    return math.isfinite(float(text))
  except ValueError:
    return False


def is_alpha(text: str) -> bool:
  """Likewise."""
  try:
    return text == 'val' or 0 < float(text) <= 1
  except ValueError:
    return False
