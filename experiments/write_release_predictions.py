r"""Writes the networks' predictions for a split in the layout of the authors' evaluation.

python -m experiments.write_release_predictions --data=DIR --shape=WORKDIR --color=WORKDIR \
  --output=DIR [--split=test] [--category=NAME,...] [--alpha=0.2]

writes a file for every model and view, into folders that the authors' programs read if they are
started in DIR. `python -m datagen.write_release --data=DIR --output=DIR` writes the true models
there.

  output_shape/<synset>/<id>/<view>.h5    [64, 64, 64, 1] probability of being occupied
  output_color/<synset>/<id>/<view>.h5    [64, 64, 64, 9] regressed colour 3, confidence of it 1,
                                          flow (u, v) 2, blended colour 3

People go to output_shape_human/<clothes>/<mesh>/<view>.h5 and output_color_human/... The confidence
is the network's, 1 - w. The blended colour uses the weight recalculated with --alpha; the authors'
evaluation does not read it, but blends with an alpha of 0.2. Existing files are kept: the same
command writes only what is missing.
"""

import os
from collections.abc import Mapping, Sequence

import numpy as np
from absl import flags
from tqdm import tqdm

from cvn import blending, checkpoint, data, infer
from cvn.dataset import SPLITS, Dataset, open_dataset, read_record
from cvn.errors import UserError
from cvn.infer import Network
from datagen import release
from experiments.lib import cli, scoring


def define_flags(f: flags.FlagValues) -> None:
  own = {'flag_values': f}
  flags.DEFINE_string('data', None, 'Data set: a folder or URL of datagen.generate.', **own)
  flags.DEFINE_string('shape', None, 'Workdir of the shape network.', **own)
  flags.DEFINE_string('color', None, 'Workdir of the colour network.', **own)
  flags.DEFINE_string('output', None, 'Folder for the predictions.', **own)
  flags.DEFINE_enum('split', 'test', SPLITS, 'Split to predict.', **own)
  flags.DEFINE_list('category', [], 'Categories to predict; all by default.', **own)
  flags.DEFINE_float(
    'alpha',
    blending.ALPHA,
    'Blend factor in (0, 1]: the smaller, the more weight the sampled colours get.',
    **own,
  )
  flags.mark_flags_as_required(['data', 'output'], f)
  flags.register_validator('alpha', lambda x: 0 < x <= 1, 'must be in (0, 1]', f)


@cli.program(define_flags)
def main(f: flags.FlagValues) -> None:
  workdirs = {kind: f[kind].value for kind in ('shape', 'color') if f[kind].value}
  write(f.data, workdirs, f.output, split=f.split, category=f.category, alpha=f.alpha)


def write(
  data_url: str,
  workdirs: Mapping[str, str],
  output: str,
  *,
  split: str,
  category: Sequence[str],
  alpha: float,
) -> None:
  """Writes the predictions that are missing, and prints how many.

  Args:
    data_url: the data set.
    workdirs: runs of networks by kind, 'shape' or 'color'.
    output: the folder.
    split: of the models.
    category: of the models; empty for all.
    alpha: of the blended colours.

  Raises:
    UserError: there is nothing to predict, or the folder holds other predictions.
  """
  release.h5py()
  if not workdirs:
    raise UserError('give --shape=WORKDIR, --color=WORKDIR or both')
  dataset = open_dataset(data_url)
  rows = data.select_rows(dataset, split, categories=category)
  if len(rows) == 0:
    raise UserError(f'{data_url} has no finished model in the split {split}')
  steps = {kind: checkpoint.latest_step(workdir) for kind, workdir in workdirs.items()}
  networks = {kind: scoring.load(workdir, (kind,), dataset) for kind, workdir in workdirs.items()}
  for kind, workdir in workdirs.items():
    # The authors' programs evaluate all files that they find, so no others may be among them.
    source = {'data': dataset.root, 'split': split}
    source |= {'network': os.path.abspath(workdir), 'step': steps[kind]}
    if kind == 'color':
      source['alpha'] = alpha
    release.claim(output, f'predicted_{kind}.json', source)
  written = dict.fromkeys(networks, 0)
  for row in tqdm(rows, desc=f'predict {split}', unit='model', disable=None):
    for kind, network in networks.items():
      written[kind] += write_model(dataset, row, network, output, alpha=alpha)
  for kind, count in written.items():
    print(
      f'{output}: {kind} of {len(rows)} models; written {count}, already there {len(rows) - count}'
    )


def write_model(dataset: Dataset, row: int, network: Network, output: str, *, alpha: float) -> bool:
  """Writes a network's predictions for a model's views, unless all files exist.

  Returns:
    Whether it was written.

  Raises:
    UserError: the model's record cannot be read, or the place cannot be written.
  """
  m, kind = dataset.manifest.models[row], network.kind
  people = '_human' if m.category == release.HUMAN else ''
  folder = os.path.join(output, f'output_{kind}{people}', release.model_folder(m.category, m.id))
  paths = [os.path.join(folder, f'{release.view_name(a)}.h5') for a in dataset.manifest.azimuths]
  if all(map(os.path.exists, paths)):
    return False
  views = read_record(dataset, row).views
  if kind == 'shape':
    volumes = infer.reconstruct(views, shape=network).probability[..., None]
  else:
    # An alpha of 1 leaves the networks' own weight as it is.
    found, own = infer.reconstruct_alphas(views, (alpha, 1), color=network)
    confidence = 1 - own.weight[..., None]
    volumes = np.concatenate([found.regressed, confidence, found.flow, found.color], -1)
  for path, volume in zip(paths, np.asarray(volumes), strict=True):
    if not os.path.exists(path):
      release.write_array(path, volume)
  return True


if __name__ == '__main__':
  main()
