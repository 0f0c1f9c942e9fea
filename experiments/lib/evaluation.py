"""The settings of experiments.evaluate: its flags and the stored options.

The options identify an evaluation: it is reused only if all of them are the same.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from absl import flags

from cvn import blending, checkpoint, data, metrics, readouts
from cvn.dataset import SPLITS, Dataset, digest, open_dataset
from experiments.lib import cli

ALPHAS = (0.2, 0.4, 0.6, 0.8, 1.0)  # of the paper's tables
STORED = (
  *('split', 'category', 'source', 'alpha', 'threshold', 'flip', 'carve'),
  *('baselines', 'retrieval', 'pictures'),
)


class Settings(NamedTuple):
  """An evaluation; see the flags of the same names."""

  data: str
  shape: str | None
  color: str | None
  split: str
  category: list[str]
  source: list[str]
  threshold: str | None
  alpha: str
  flip: bool
  carve: bool
  baselines: bool
  retrieval: bool
  pictures: bool
  reference_data: str | None = None
  reference_source: Sequence[str] = ()


def define_flags(f: flags.FlagValues) -> None:
  own = {'flag_values': f}
  flags.DEFINE_string('data', None, 'Data set: a folder or URL of datagen.generate.', **own)
  flags.DEFINE_string('shape', None, 'Workdir of the network for shapes.', **own)
  flags.DEFINE_string('color', None, 'Workdir of the network for colours.', **own)
  flags.DEFINE_enum('split', 'test', SPLITS, 'Split to evaluate on.', **own)
  flags.DEFINE_list('category', [], 'Categories to evaluate on; all by default.', **own)
  flags.DEFINE_list('source', [], 'Sources of models to evaluate on; all by default.', **own)
  flags.DEFINE_string(
    'threshold',
    None,
    "Occupancy threshold; 'val' chooses it on the split val. The default is"
    f' {metrics.OCCUPIED}, for r2n2 {readouts.THRESHOLDS["r2n2"]}.',
    **own,
  )
  flags.DEFINE_string(
    'alpha',
    str(blending.ALPHA),
    "Blend factor in (0, 1]: the smaller, the more weight the sampled colours get; 'val' chooses it"
    f' on the split val from {", ".join(map(str, ALPHAS))}.',
    **own,
  )
  flags.DEFINE_bool('flip', False, 'Test-time augmentation: average with the mirrored view.', **own)
  flags.DEFINE_bool(
    'carve',
    False,
    "Carve shapes by the views' silhouettes; the azimuth is estimated from the shape.",
    **own,
  )
  flags.DEFINE_bool('baselines', False, 'Evaluate the trivial baselines as well.', **own)
  flags.DEFINE_bool(
    'retrieval',
    False,
    'Evaluate training models that are looked up as well; needs --shape.',
    **own,
  )
  flags.DEFINE_bool(
    'pictures',
    False,
    'Compare pictures of the results from all azimuths; needs --shape and --color.',
    **own,
  )
  flags.DEFINE_string(
    'reference_data',
    None,
    'Data set whose splits val and train provide thresholds, alpha, baselines and retrieval; --data'
    ' itself by default.',
    **own,
  )
  flags.DEFINE_list(
    'reference_source',
    [],
    'Sources of the models of its split val; all of --reference_data by default, or --source.',
    **own,
  )
  flags.DEFINE_string('json', None, 'File for the numbers.', **own)
  flags.mark_flag_as_required('data', f)
  flags.register_validator('alpha', is_alpha, "must be in (0, 1], or 'val'", f)
  flags.register_validator('threshold', is_threshold, "must be a number or 'val'", f)


def read_flags(f: flags.FlagValues) -> Settings:
  """The settings that the flags describe."""
  return Settings(*(f[name].value for name in Settings._fields))


def options(**named: Any) -> dict[str, Any]:
  """The options that the program stores when it is started with some flags."""
  s = read_flags(cli.parse(define_flags, **named))
  return make_options(s, open_dataset(s.data))


def make_options(s: Settings, dataset: Dataset) -> dict[str, Any]:
  """Everything that the numbers depend on, as JSON values.

  `runs` has the configuration of each network and the step of its checkpoint. The digest covers the
  models of all splits: thresholds are chosen on val, baselines are made from train.
  """
  rows = [
    row for split in SPLITS for row in data.select_rows(dataset, split, categories=s.category)
  ]
  networks = {'shape': s.shape, 'color': s.color}
  reference = {}
  if s.reference_data:
    other = open_dataset(s.reference_data)
    used = [row for split in ('train', 'val') for row in data.select_rows(other, split)]
    reference = {'reference_data': other.root, 'reference_digest': digest(other, used)}
  if s.reference_source:
    reference['reference_source'] = list(s.reference_source)
  return {
    'data': dataset.root,
    'data_digest': digest(dataset, rows),
    **reference,
    **{name: getattr(s, name) for name in STORED},
    'runs': {kind: describe_run(workdir) for kind, workdir in networks.items() if workdir},
  }


def describe_run(workdir: str) -> dict[str, Any]:
  """A network's identity, without the place of its data: configuration and step of its run."""
  config = checkpoint.read_config(workdir)
  config = {k: v for k, v in config.items() if k not in checkpoint.NOT_COMPARED}
  return {'step': checkpoint.latest_step(workdir), 'config': config}


def is_threshold(text: str | None) -> bool:
  """Whether the text is a value of --threshold."""
  if text in (None, 'val'):
    return True
  try:
    return math.isfinite(float(text))
  except ValueError:
    return False


def is_alpha(text: str) -> bool:
  """Whether the text is a value of --alpha."""
  try:
    return text == 'val' or 0 < float(text) <= 1
  except ValueError:
    return False
