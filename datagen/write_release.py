r"""A data set -> the layout of the authors' released folders, for their programs.

python -m datagen.write_release --data=DIR --output=DIR [--split=test] [--category=NAME,...]

Start the authors' programs in the output folder:

  data/ShapeNetCore_im2avatar/<synset>/<id>/...   data/human_im2avatar/<clothes>/<mesh>/...
  data_list/{train,val,test}_list_<synset>.txt    data_list/{train,test}_list_human.txt

datagen/release.py documents the layout; a category without a synset uses its own name. Existing
files are kept: the same command writes only what is missing.
"""

import itertools
import os
from collections import defaultdict
from collections.abc import Sequence

import numpy as np
from absl import flags
from tqdm import tqdm

from cvn import dataset as dataset_lib
from cvn import errors
from cvn.dataset import SPLITS, Dataset
from cvn.errors import UserError
from cvn.files import atomic_write
from datagen import release


def define_flags(f: flags.FlagValues) -> None:
  """Defines the program's flags. Not at import: the flags of several programs share names."""
  own = {'flag_values': f}
  flags.DEFINE_string('data', None, 'Folder or URL of the data set.', **own)
  flags.DEFINE_string('output', None, 'Folder to write.', **own)
  flags.DEFINE_enum('split', None, SPLITS, 'Split to write; all by default.', **own)
  flags.DEFINE_list('category', [], 'Categories to write; all by default.', **own)
  flags.mark_flags_as_required(['data', 'output'], f)


def main(_) -> None:
  run(flags.FLAGS)


def run(f: flags.FlagValues) -> None:
  """Writes the files and prints a summary."""
  release.h5py()
  dataset = dataset_lib.open_dataset(f.data)
  counts = dataset_lib.surface_counts(dataset)
  rows = [
    row
    for row, m in enumerate(dataset.manifest.models)
    if counts[row] and f.split in (None, m.split) and (not f.category or m.category in f.category)
  ]
  if not rows:
    raise UserError(f'{f.data} has no finished model of this split and category')
  release.claim(
    f.output, 'written_data.json', {'data': dataset.root, 'settings': dataset.manifest.settings}
  )
  progress = tqdm(rows, desc='write', unit='model', disable=None)
  written = sum(write_model(dataset, row, f.output) for row in progress)
  write_lists(dataset, rows, f.output)
  print(f'{f.output}: {len(rows)} models; written {written}, already there {len(rows) - written}')


def write_model(dataset: Dataset, row: int, output: str) -> bool:
  """Writes the missing files of a model; returns whether there were any.

  Raises:
    UserError: a file cannot be written.
  """
  m, size = dataset.manifest.models[row], dataset.manifest.grid_size
  folder = os.path.join(
    output, 'data', release.collection(m.category), release.model_folder(m.category, m.id)
  )
  names = [release.view_name(a) for a in dataset.manifest.azimuths]
  pictures = [os.path.join(folder, release.view_path(n)) for n in names]
  flows = [os.path.join(folder, release.flow_path(m.category, n, size)) for n in names]
  volume = os.path.join(folder, release.volume_path(m.category, folder, size))
  missing = {p for p in (*pictures, *flows, volume) if not os.path.exists(p)}
  if not missing:
    return False
  record = dataset_lib.read_record(dataset, row)

  def dense(values):
    result = np.full((size, size, size, values.shape[-1]), release.EMPTY, np.float32)
    result[tuple(record.surface_index.T)] = values
    return result

  if volume in missing:
    release.write_array(volume, dense(record.surface_color / 255))
  for path, rgba in zip(pictures, record.views, strict=True):
    if path in missing:
      release.write_view(path, rgba)
  for path, flow in zip(flows, record.flow, strict=True):
    if path in missing:
      release.write_array(path, dense(flow))
  return True


def write_lists(dataset: Dataset, rows: Sequence[int], output: str) -> None:
  """Writes the lists of ids: three for each category, as the authors' programs expect.

  People have a validation list only if there are models for it.

  Raises:
    UserError: a file cannot be written.
  """
  lists = defaultdict(list)
  for row in rows:
    m = dataset.manifest.models[row]
    lists[m.category, m.split].append(release.model_folder(m.category, m.id))
  for category, split in itertools.product({c for c, _ in lists}, SPLITS):
    folders = lists[category, split]
    if category == release.HUMAN:
      if split == 'val' and not folders:
        continue
      name, lines = category, [folder.replace(os.sep, ' ') for folder in folders]
    else:
      name = release.category_folder(category)
      lines = [os.path.basename(folder) for folder in folders]
    path = os.path.join(output, 'data_list', f'{split}_list_{name}.txt')
    with atomic_write(path) as temporary, open(temporary, 'w') as file:
      file.writelines(f'{line}\n' for line in lines)


if __name__ == '__main__':
  define_flags(flags.FLAGS)
  errors.run(main)
