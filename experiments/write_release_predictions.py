r"""What networks predict of a split -> the layout of the authors' programs, for their evaluation.

python -m experiments.write_release_predictions --data=DIR --shape=WORKDIR --color=WORKDIR \
  --output=DIR [--split=test] [--category=NAME,...] [--alpha=0.2]

writes, for every model and view, into folders that the authors' programs read when they are started
in DIR, where `python -m datagen.write_release --data=DIR --output=DIR` puts the truth:

  output_shape/<synset>/<id>/<view>.h5    [64, 64, 64, 1] probability of being occupied
  output_color/<synset>/<id>/<view>.h5    [64, 64, 64, 9] regressed colour 3, confidence of it 1,
                                          flow (u, v) 2, blended colour 3

and for people output_shape_human/<clothes>/<mesh>/<view>.h5, output_color_human/... alike. The
confidence is the networks' own, 1 - w; the blended colour is ours, with the weight that --alpha
recalculates: the authors' evaluation does not read it, but blends by itself with an alpha of 0.2.
Models that are there are kept: the same command again writes only what is missing.
"""

import os

import numpy as np
from absl import flags
from tqdm import tqdm

from cvn import blending, checkpoint, data, environment, errors, infer
from cvn.dataset import SPLITS, Dataset, open_dataset, read_record
from cvn.errors import UserError
from cvn.infer import Network
from datagen import release
from experiments.lib import scoring


def define_flags(f: flags.FlagValues) -> None:
  """The program's flags. Not at import: there the names of several programs would collide."""
  own = {'flag_values': f}
  flags.DEFINE_string('data', None, 'The data set: a folder or URL of datagen.generate.', **own)
  flags.DEFINE_string('shape', None, "The trained shape network's workdir.", **own)
  flags.DEFINE_string('color', None, "The trained colour network's workdir.", **own)
  flags.DEFINE_string('output', None, 'The folder that is written.', **own)
  flags.DEFINE_enum('split', 'test', SPLITS, 'The models to predict.', **own)
  flags.DEFINE_list('category', [], 'Categories to predict; all of them by default.', **own)
  flags.DEFINE_float(
    'alpha',
    blending.ALPHA,
    'In (0, 1]: the smaller, the more the sampled colours count in the blended ones.',
    **own,
  )
  flags.mark_flags_as_required(['data', 'output'], f)
  flags.register_validator('alpha', lambda x: 0 < x <= 1, 'must be in (0, 1]', f)


def main(_) -> None:
  run(flags.FLAGS)


def run(f: flags.FlagValues) -> None:
  """Writes as the flags say, and prints what it did."""
  release.h5py()
  workdirs = {kind: f[kind].value for kind in ('shape', 'color') if f[kind].value}
  if not workdirs:
    raise UserError('give --shape=WORKDIR, --color=WORKDIR or both')
  dataset = open_dataset(f.data)
  rows = data.select_rows(dataset, f.split, categories=f.category)
  if len(rows) == 0:
    raise UserError(f'{f.data} has no finished model in the split {f.split}')
  steps = {kind: checkpoint.latest_step(workdir) for kind, workdir in workdirs.items()}
  networks = {kind: scoring.load(workdir, (kind,), dataset) for kind, workdir in workdirs.items()}
  for kind, workdir in workdirs.items():
    # Their programs score whatever they find: other networks' or splits' files must not mix in.
    source = {'data': dataset.root, 'split': f.split}
    source |= {'network': os.path.abspath(workdir), 'step': steps[kind]}
    if kind == 'color':
      source['alpha'] = f.alpha
    release.claim(f.output, f'predicted_{kind}.json', source)
  written = dict.fromkeys(networks, 0)
  for row in tqdm(rows, desc=f'predict {f.split}', unit='model', disable=None):
    for kind, network in networks.items():
      written[kind] += write_model(dataset, row, network, f.output, alpha=f.alpha)
  for kind, count in written.items():
    print(
      f'{f.output}: {kind} of {len(rows)} models; written {count}, already there'
      f' {len(rows) - count}'
    )


def write_model(dataset: Dataset, row: int, network: Network, output: str, *, alpha: float) -> bool:
  """Writes what a network says of a model's views, unless all of it is there.

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
  environment.prepare()
  define_flags(flags.FLAGS)
  errors.run(main)
