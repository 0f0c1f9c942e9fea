r"""Textured meshes -> a data set for training.

python -m datagen.generate --source=procedural --category=chair --limit=200 --output=DIR
python -m datagen.generate --source=meshes --category=chair --input=DIR --output=DIR

The same command again makes only what is missing. Models that fail are listed, with the reason, in
failures.json, and left out. contact_sheet.png shows the first models.
"""

import io
import os
from collections import Counter
from collections.abc import Sequence

import numpy as np
import tensorstore as ts
from absl import flags
from PIL import Image
from tqdm import tqdm

from cvn import dataset as dataset_lib
from cvn import errors
from cvn.camera import AZIMUTHS, IMAGE_SIZE
from cvn.dataset import Dataset, Manifest, Model
from cvn.errors import UserError
from cvn.grid import GRID_SIZE
from datagen import sources
from datagen.contact_sheet import contact_sheet
from datagen.flow import FlowStats
from datagen.pipeline import Job, Outcome, process_executor, run_jobs
from datagen.render import SHADINGS
from datagen.sources import SourceModel
from datagen.splits import read_splits, split_of

VERSION = 1  # of what is generated: the same settings and version give the same bytes
REASONS_SHOWN = 5


def define_flags(f: flags.FlagValues) -> None:
  """The program's flags. Not at import: there the names of several programs would collide."""
  own = {'flag_values': f}
  flags.DEFINE_enum('source', None, list(sources.SOURCES), 'Where the meshes come from.', **own)
  flags.DEFINE_list('category', None, 'One category, or several separated by commas.', **own)
  flags.DEFINE_string('input', None, 'The folder of meshes, for --source=meshes.', **own)
  flags.DEFINE_string('output', None, 'The folder or URL of the data set.', **own)
  flags.DEFINE_integer('limit', None, 'The most models of each category.', lower_bound=1, **own)
  flags.DEFINE_integer('workers', os.cpu_count(), 'Processes, one core each.', lower_bound=1, **own)
  flags.DEFINE_integer('seed', 0, 'Of the procedural source.', lower_bound=0, **own)
  flags.DEFINE_enum('shading', 'flat', SHADINGS, 'Albedo as it is, or under soft light.', **own)
  flags.DEFINE_string(
    'splits',
    None,
    'A folder of {train,val,test}_list_<category>.txt; without it, a hash of the id decides.',
    **own,
  )
  flags.mark_flags_as_required(['source', 'category', 'output'], f)


def main(_) -> None:
  run(flags.FLAGS)


def run(f: flags.FlagValues) -> None:
  """Generates as the flags say, and prints a summary."""
  models = list_models(f.source, f.category, f.input, f.limit, f.seed)
  manifest = plan(
    models,
    splits_folder=f.splits,
    input_dir=f.input,
    settings={'source': f.source, 'seed': f.seed, 'shading': f.shading, 'version': VERSION},
  )
  dataset = open_or_create(f.output, manifest)
  made = dataset_lib.surface_counts(dataset) > 0
  jobs = [
    Job(f.output, row, model, f.source, f.shading)
    for row, model in enumerate(models)
    if not made[row]
  ]
  outcomes: list[Outcome] = []
  try:
    progress = tqdm(total=len(models), initial=int(made.sum()), unit='model', disable=None)
    with progress:
      for outcome in run_jobs(jobs, process_executor, f.workers):
        outcomes.append(outcome)
        progress.update()
  finally:
    done = dataset_lib.surface_counts(dataset) > 0
    failures = dataset_lib.read_json(dataset.root, 'failures.json') or {}
    failures |= {models[o.row].id: o.reason for o in outcomes if o.reason}
    missing = [m.id for m, there in zip(models, done, strict=True) if not there]
    failures = {i: failures[i] for i in missing if i in failures}
    dataset_lib.write_json(dataset.root, 'failures.json', failures)
  if not done.any():
    model_id, reason = next(iter(failures.items()))
    raise UserError(f'not one of {len(models)} models could be made; {model_id}: {reason}')
  write_png(dataset, 'contact_sheet.png', contact_sheet(dataset))
  print(summary(dataset, done, int(made.sum()), outcomes, failures))


def list_models(
  source: str, categories: Sequence[str], input_dir: str | None, limit: int | None, seed: int
) -> list[SourceModel]:
  """All the models to make, category by category.

  Raises:
    UserError: there are none, or two of one id; and what the source itself raises.
  """
  wanted = [c.strip() for c in categories if c.strip()]
  if not wanted:
    raise UserError('--category names no category')
  if len(set(wanted)) < len(wanted):
    raise UserError(f'--category names one twice: {",".join(wanted)}')
  listing = sources.source(source).list_models
  models = [m for c in wanted for m in listing(c, input_dir, limit, seed)]
  if not models:
    raise UserError(f'{input_dir or source} has no model of category {",".join(wanted)}')
  model_id, count = Counter(m.id for m in models).most_common(1)[0]
  if count > 1:
    raise UserError(f'{count} models have the id {model_id}: make one category a data set')
  return models


def plan(
  models: Sequence[SourceModel],
  *,
  settings: dict,
  splits_folder: str | None = None,
  input_dir: str | None = None,
  image_size: int = IMAGE_SIZE,
  grid_size: int = GRID_SIZE,
) -> Manifest:
  """The data set's manifest.

  Args:
    models: in the order of its rows.
    settings: what else decides the records' bytes.
    splits_folder: where lists of ids are; None to split by a hash of the id.
    input_dir: paths are kept relative to it, so that the folder may move.
    image_size: of the views, in pixels.
    grid_size: voxels along one side of the grid.

  Raises:
    UserError: the lists are missing, or leave a model out.
  """
  lists = {}
  if splits_folder is not None:
    lists = {c: read_splits(splits_folder, c) for c in {m.category for m in models}}

  def split(m):
    if splits_folder is None:
      return split_of(m.id)
    if m.id not in lists[m.category]:
      raise UserError(f'{splits_folder} has no list for category {m.category} that names {m.id}')
    return lists[m.category][m.id]

  rows = tuple(
    Model(
      id=m.id,
      category=m.category,
      split=split(m),
      source=os.path.relpath(m.path, input_dir) if m.path else settings['source'],
      licence=m.licence,
      creator=m.creator,
    )
    for m in models
  )
  capacity = dataset_lib.SURFACE_CAPACITY
  return Manifest(rows, AZIMUTHS, image_size, grid_size, capacity, settings)


def open_or_create(root: str, manifest: Manifest) -> Dataset:
  """Makes the data set, or opens the one that is there when it was planned the same way.

  Raises:
    UserError: another data set is there.
  """
  if dataset_lib.read_json(root, 'manifest.json') is None:
    return dataset_lib.create(root, manifest)
  dataset = dataset_lib.open_dataset(root)
  old = dataset.manifest
  way_out = 'choose another --output, or delete it'
  for name in sorted(manifest.settings | old.settings):
    was, now = old.settings.get(name), manifest.settings.get(name)
    if was != now:
      raise UserError(f'{root} holds a data set with {name} {was}, not {now}: {way_out}')
  if old.models != manifest.models:
    theirs, ours = ({m.id: m for m in x.models} for x in (old, manifest))
    apart = next((i for i in (theirs | ours) if theirs.get(i) != ours.get(i)), 'another order')
    raise UserError(
      f'{root} holds a data set of {len(theirs)} models, and other ones than these {len(ours)}'
      f' (first difference: {apart}; the category, limit, files or splits changed): {way_out}'
    )
  if old != manifest:
    raise UserError(f'{root} holds a data set with other sizes or views: {way_out}')
  return dataset


def write_png(dataset: Dataset, name: str, image: np.ndarray) -> None:
  """Writes a picture beside the arrays, whole or not at all."""
  png = io.BytesIO()
  Image.fromarray(image).save(png, 'PNG')
  try:
    ts.KvStore.open(dataset.root).result().write(name, png.getvalue()).result()
  except ValueError as e:
    raise UserError(f'cannot write {dataset.root}{name}: {e}') from e


def summary(
  dataset: Dataset,
  done: np.ndarray,
  skipped: int,
  outcomes: Sequence[Outcome],
  failures: dict[str, str],
) -> str:
  """What the run did, for a person.

  Args:
    dataset: the data set.
    done: [N] bool, the models it holds now.
    skipped: models that were there already.
    outcomes: of this run.
    failures: id -> reason.
  """
  manifest = dataset.manifest
  splits = Counter(m.split for m, there in zip(manifest.models, done, strict=True) if there)
  made = [o for o in outcomes if not o.reason]
  lines = [
    f'{dataset.root}: {done.sum()} models ('
    + ', '.join(f'{splits[s]} {s}' for s in dataset_lib.SPLITS)
    + f'); made {len(made)}, already there {skipped}, failed {len(failures)}'
  ]
  if made:
    seconds = np.mean([o.seconds for o in made])
    s = FlowStats(*np.mean([o.stats for o in made], axis=0))
    lines += [
      f'{seconds:.2f} s a model and worker',
      f'voxels of a view: {s.visible:.1%} visible, {s.matched:.1%} hidden and matched by colour,'
      f' {s.fallback:.1%} hidden with no similar colour in view',
      f'colour where the flow points: off by {s.visible_error:.3f} for visible voxels'
      f' ({s.visible_faithful:.1%} of them by less than 0.1), by {s.error:.3f} for all',
    ]
  shown = list(failures.items())[:REASONS_SHOWN]
  lines += [f'failed: {model_id}: {reason}' for model_id, reason in shown]
  if len(failures) > REASONS_SHOWN:
    lines.append(f'and {len(failures) - REASONS_SHOWN} more, in failures.json')
  lines.append(f'look at contact_sheet.png in {dataset.root}')
  return '\n'.join(lines)


if __name__ == '__main__':
  define_flags(flags.FLAGS)
  errors.run(main)
