r"""Textured meshes -> a data set for training.

python -m datagen.generate --source=procedural --category=chair --limit=200 --output=DIR
python -m datagen.generate --source=meshes --category=chair --input=DIR --output=DIR
python -m datagen.generate --source=sweethome3d --category='chair,sofa=sofa|couch' --input=DIR \
  --output=DIR

Repeat the command to make models that are missing or have changed: meshes with new contents, or
with another --up or --turn. --append adds other models to an existing data set. Models that fail
are left out and listed with the reason in failures.json. contact_sheet.png shows some models of
each category; python -m datagen.inspect checks all of them.

With --scheduler=ADDRESS a Dask cluster does the work. --input and --output must then mean the same
on all its machines: a shared file system or, for --output, a bucket (gs://, s3://).
"""

import contextlib
import functools
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
from cvn.dataset import Dataset, Facts
from cvn.errors import UserError
from datagen import sources
from datagen.executors import dask_client, process_executor
from datagen.geometry.flow import SIMILARITY, TOLERANCE, FlowStats
from datagen.geometry.render import SHADINGS
from datagen.pipeline import Job, Outcome, Settings, run_jobs
from datagen.placement import COLUMNS, TABLE, UPS, with_metadata
from datagen.plan import keep_listed, list_models, open_or_create, plan
from datagen.quality.contact_sheet import contact_sheet, rows_to_show
from datagen.reading.notes import from_bits

REASONS_SHOWN = 5
SHEET_MODELS = 8  # on the contact sheet
TIMEOUT = 300  # seconds a model
MEMORY_LIMIT = 4  # GiB a worker
DASK_JOBS = 4096  # in a scheduler's hands at a time


def define_flags(f: flags.FlagValues) -> None:
  """Defines the program's flags. Not at import: the flags of several programs share names."""
  own = {'flag_values': f}
  flags.DEFINE_enum('source', None, list(sources.SOURCES), 'Source of the meshes.', **own)
  flags.DEFINE_list(
    'category',
    None,
    'One category, or several separated by commas. With --source=meshes, several categories are'
    " subfolders of these names. With --source=sweethome3d, 'NAME=PATTERN' selects models by a"
    ' regular expression (without commas) for their names.',
    **own,
  )
  flags.DEFINE_string('input', None, 'Folder or file that --source reads.', **own)
  flags.DEFINE_string('output', None, 'Folder or URL of the data set.', **own)
  flags.DEFINE_boolean('append', False, 'Add the models to an existing data set.', **own)
  flags.DEFINE_integer('limit', None, 'Maximum models of each category.', lower_bound=1, **own)
  flags.DEFINE_integer('seed', 0, 'Random seed for generated models.', lower_bound=0, **own)
  flags.DEFINE_string(
    'splits',
    None,
    'Folder of {train,val,test}_list_<category>.txt, lists of ids. Only models in these lists are'
    ' made. By default the source decides the split, or a hash of the id.',
    **own,
  )
  flags.DEFINE_enum(
    'split',
    None,
    dataset_lib.SPLITS,
    'Split for all models.',
    **own,
  )
  flags.DEFINE_enum('up', 'y', list(UPS), 'Axis that points up in the files.', **own)
  flags.DEFINE_float(
    'turn',
    0.0,
    'Degrees to turn the models anticlockwise, seen from above, so that they face +z: 180 if they'
    ' face -z, -90 if they face +x.',
    **own,
  )
  flags.DEFINE_string(
    'table',
    None,
    f'CSV file with a column id and any of {", ".join(COLUMNS)}, which override the flags for'
    f' single models. The default is {TABLE} in the input folder, if it exists.',
    **own,
  )
  flags.DEFINE_string('licence', None, 'Licence of models whose source states none.', **own)
  flags.DEFINE_string('creator', None, 'Creator of models whose source states none.', **own)
  flags.DEFINE_enum(
    'shading',
    'flat',
    SHADINGS,
    'Views show the albedo alone (flat) or under soft light (lit).',
    **own,
  )
  flags.DEFINE_float(
    'tolerance',
    TOLERANCE,
    'Maximum distance, in voxels, of a visible voxel from the surface that the view shows there.',
    lower_bound=0.1,
    **own,
  )
  flags.DEFINE_float(
    'similarity',
    SIMILARITY,
    'Maximum RGB distance, for colours in [0, 1], of a pixel that provides the colour of a hidden'
    ' voxel.',
    lower_bound=0.0,
    **own,
  )
  flags.DEFINE_integer(
    'workers', os.cpu_count(), 'Number of processes, one core each.', lower_bound=1, **own
  )
  flags.DEFINE_string('scheduler', None, 'Dask scheduler; its workers do the work.', **own)
  flags.DEFINE_float(
    'timeout',
    TIMEOUT,
    'Maximum processor time for a model, seconds; beyond it the model is skipped.',
    lower_bound=0.1,
    **own,
  )
  flags.DEFINE_float(
    'memory_limit',
    MEMORY_LIMIT,
    'Maximum memory of a local worker, GiB; a model that needs more is skipped. Dask workers have'
    ' their own --memory-limit.',
    lower_bound=0.5,
    **own,
  )
  flags.mark_flags_as_required(['source', 'category', 'output'], f)


def main(_) -> None:
  run(flags.FLAGS)


def run(f: flags.FlagValues) -> None:
  """Generates the data set and prints a summary."""
  settings = Settings(
    shading=f.shading,
    tolerance=f.tolerance,
    similarity=f.similarity,
  )
  found = list_models(f.source, f.category, f.input, None if f.splits else f.limit, f.seed)
  if f.splits:
    found, note = keep_listed(found, f.splits, f.limit)
    print(note)
  found = with_metadata(
    found,
    table=f.table,
    input_dir=f.input,
    up=f.up,
    turn=f.turn,
    split=f.split,
    licence=f.licence,
    creator=f.creator,
  )
  turned = any(m.up != 'y' or m.turn for m in found)
  if turned and hasattr(sources.source(f.source), 'read_record'):
    raise UserError(
      f'--up and --turn do not apply to --source={f.source}: it holds records, not meshes'
    )
  planned = plan(found, f.source, input_dir=f.input)
  with contextlib.ExitStack() as stack:
    memory, in_hand = int(f.memory_limit * 2**30), None
    make_executor = functools.partial(process_executor, memory=memory)
    if f.scheduler:
      client = stack.enter_context(dask_client(f.scheduler))
      make_executor, in_hand = lambda _: client.get_executor(pure=False), DASK_JOBS
    dataset, rows = open_or_create(f.output, planned, settings, append=f.append)
    counts = dataset_lib.surface_counts(dataset)
    models = {m.id: m for m in found}
    jobs = [
      Job(f.output, row, models[m.id], f.source, settings, f.timeout)
      for m, row in zip(planned, rows, strict=True)
      if not counts[row]
    ]
    outcomes: list[Outcome] = []
    try:
      progress = tqdm(
        total=len(planned), initial=len(planned) - len(jobs), unit='model', disable=None
      )
      with progress:
        for outcome in run_jobs(jobs, make_executor, f.workers, in_hand=in_hand):
          outcomes.append(outcome)
          progress.update()
    finally:
      failures = _note_failures(dataset, outcomes)
  done = dataset_lib.surface_counts(dataset) > 0
  if not done.any():
    model_id, reason = next(iter(failures.items()))
    raise UserError(f'none of {len(planned)} models could be made; {model_id}: {reason}')
  made = [o.row for o in outcomes if not o.reason]
  sheet = contact_sheet(dataset, rows_to_show(dataset, done, made, SHEET_MODELS))
  write_png(dataset, 'contact_sheet.png', sheet)
  print(summary(dataset, done, outcomes, failures, len(planned) - len(jobs)))


def _note_failures(dataset: Dataset, outcomes: Sequence[Outcome]) -> dict[str, str]:
  """Updates failures.json and returns it: id -> reason, in the order of the rows."""
  models, done = dataset.manifest.models, dataset_lib.surface_counts(dataset) > 0
  failures = dataset_lib.read_json(dataset.root, 'failures.json') or {}
  failures |= {models[o.row].id: o.reason for o in outcomes if o.reason}
  missing = [m.id for m, there in zip(models, done, strict=True) if not there]
  failures = {i: failures[i] for i in missing if i in failures}
  dataset_lib.write_json(dataset.root, 'failures.json', failures)
  return failures


def write_png(dataset: Dataset, name: str, image: np.ndarray) -> None:
  """Writes an image beside the arrays, atomically."""
  png = io.BytesIO()
  Image.fromarray(image).save(png, 'PNG')
  try:
    ts.KvStore.open(dataset.root).result().write(name, png.getvalue()).result()
  except ValueError as e:
    raise UserError(f'cannot write {dataset.root}{name}: {e}') from e


def summary(
  dataset: Dataset,
  done: np.ndarray,
  outcomes: Sequence[Outcome],
  failures: dict[str, str],
  there: int,
) -> str:
  """A readable summary of the run.

  Args:
    dataset: the data set.
    done: [N] bool, the models that it holds now.
    outcomes: the outcomes of this run.
    failures: id -> reason.
    there: number of requested models that existed before.
  """
  manifest = dataset.manifest
  splits = Counter(m.split for m, there in zip(manifest.models, done, strict=True) if there)
  made = [o for o in outcomes if not o.reason]
  lines = [
    f'{dataset.root}: {done.sum()} models ('
    + ', '.join(f'{splits[s]} {s}' for s in dataset_lib.SPLITS)
    + f'); made {len(made)}, already there {there}, failed {len(failures)}'
  ]
  rated = [o.stats for o in made if o.stats is not None]
  if made:
    lines.append(f'{np.mean([o.seconds for o in made]):.2f} s for a model in one worker')
  if rated:
    lines += _flow_lines(FlowStats(*np.mean(rated, axis=0)))
  lines += _note_lines([o.facts for o in made if o.facts is not None])
  shown = list(failures.items())[:REASONS_SHOWN]
  lines += [f'failed: {model_id}: {reason}' for model_id, reason in shown]
  if len(failures) > REASONS_SHOWN:
    lines.append(f'and {len(failures) - REASONS_SHOWN} more, in failures.json')
  lines.append(f'look at contact_sheet.png in {dataset.root}')
  return '\n'.join(lines)


def _note_lines(facts: Sequence[Facts]) -> list[str]:
  """How many models have files that readers missed, ignored or guessed."""
  lacking = sum(f.missing > 0 for f in facts)
  lines = [f'{lacking} models name files or materials that do not exist'] if lacking else []
  counts = Counter(note for f in facts for note in from_bits(f.notes))
  lines += [f'{count} models: {note}' for note, count in counts.most_common()]
  return [*lines, 'datagen.inspect lists these models'] if lines else []


def _flow_lines(s: FlowStats) -> list[str]:
  if not s.visible:  # records that were made elsewhere
    return [
      f'no voxel is marked as visible; {s.matched:.1%} of the flows fetch a similar colour',
      f'mean colour error of the flows: {s.error:.3f}',
    ]
  return [
    f'voxels in a view: {s.visible:.1%} visible, {s.matched:.1%} hidden and matched by colour,'
    f' {s.fallback:.1%} hidden without a similar colour in the view',
    f'mean colour error of the flows: {s.visible_error:.3f} for visible voxels'
    f' ({s.visible_faithful:.1%} of them below 0.1), {s.error:.3f} for all',
  ]


if __name__ == '__main__':
  define_flags(flags.FLAGS)
  errors.run(main)
