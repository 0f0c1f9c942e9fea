r"""Textured meshes -> a data set for training.

python -m datagen.generate --source=procedural --category=chair --limit=200 --output=DIR
python -m datagen.generate --source=meshes --category=chair --input=DIR --output=DIR
python -m datagen.generate --source=sweethome3d --category='chair,sofa=sofa|couch' --input=DIR \
  --output=DIR

The same command again makes what is missing and what has changed: meshes that were written anew,
or are to stand otherwise (--up, --turn). --append adds other models to a data set that is there.
Models that fail are listed, with the reason, in failures.json, and left out. contact_sheet.png
shows some of each category; python -m datagen.inspect tells of all of them.

--scheduler=ADDRESS has a Dask cluster do the work: --input and --output must mean the same to all
its machines, a shared file system or, for --output, a bucket (gs://, s3://).
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
from datagen.placement import COLUMNS, TABLE, UPS, with_owners_word
from datagen.plan import keep_listed, list_models, open_or_create, plan
from datagen.quality.contact_sheet import contact_sheet, rows_to_show
from datagen.reading.notes import from_bits

REASONS_SHOWN = 5
SHEET_MODELS = 8  # on the contact sheet
TIMEOUT = 300  # seconds a model
MEMORY_LIMIT = 4  # GiB a worker
DASK_JOBS = 4096  # in a scheduler's hands at a time


def define_flags(f: flags.FlagValues) -> None:
  """The program's flags. Not at import: there the names of several programs would collide."""
  own = {'flag_values': f}
  flags.DEFINE_enum('source', None, list(sources.SOURCES), 'Where the meshes come from.', **own)
  flags.DEFINE_list(
    'category',
    None,
    "One category, or several separated by commas; for --source=sweethome3d also 'NAME=PATTERN', a"
    ' regular expression of names, without commas. Several categories of --source=meshes are the'
    ' subfolders of these names.',
    **own,
  )
  flags.DEFINE_string('input', None, 'The folder or file that --source reads.', **own)
  flags.DEFINE_string('output', None, 'The folder or URL of the data set.', **own)
  flags.DEFINE_boolean('append', False, 'Add the models to the data set that is there.', **own)
  flags.DEFINE_integer('limit', None, 'The most models of each category.', lower_bound=1, **own)
  flags.DEFINE_integer('seed', 0, 'Of sources that make models up.', lower_bound=0, **own)
  flags.DEFINE_string(
    'splits',
    None,
    'A folder of {train,val,test}_list_<category>.txt, lists of ids: the models that they name are'
    ' made, and no others. Without it the source decides the split, or a hash of the id.',
    **own,
  )
  flags.DEFINE_enum(
    'split',
    None,
    dataset_lib.SPLITS,
    'The split of all models.',
    **own,
  )
  flags.DEFINE_enum('up', 'y', list(UPS), 'The axis of the files that points up.', **own)
  flags.DEFINE_float(
    'turn',
    0.0,
    'Degrees by which models are turned, anticlockwise seen from above, so that they face +z: 180'
    ' for those that face -z, -90 for those that face +x.',
    **own,
  )
  flags.DEFINE_string(
    'table',
    None,
    f'A CSV file with a column id and any of {", ".join(COLUMNS)}: what it says of a model goes'
    f' before the flags. Without it, {TABLE} in the input folder, if it is there.',
    **own,
  )
  flags.DEFINE_string('licence', None, 'Of models whose source states none.', **own)
  flags.DEFINE_string('creator', None, 'Of models whose source states none.', **own)
  flags.DEFINE_enum('shading', 'flat', SHADINGS, 'Albedo as it is, or under soft light.', **own)
  flags.DEFINE_float(
    'tolerance',
    TOLERANCE,
    'Voxels: a voxel this close to the surface that a view shows there is visible in it.',
    lower_bound=0.1,
    **own,
  )
  flags.DEFINE_float(
    'similarity',
    SIMILARITY,
    "RGB distance of colours in [0, 1] up to which a pixel may stand for a hidden voxel's.",
    lower_bound=0.0,
    **own,
  )
  flags.DEFINE_integer('workers', os.cpu_count(), 'Processes, one core each.', lower_bound=1, **own)
  flags.DEFINE_string('scheduler', None, 'A Dask scheduler whose workers do the work.', **own)
  flags.DEFINE_float(
    'timeout',
    TIMEOUT,
    'Seconds of processor time after which a model is given up.',
    lower_bound=0.1,
    **own,
  )
  flags.DEFINE_float(
    'memory_limit',
    MEMORY_LIMIT,
    'GiB that a local worker may have; a model that needs more is given up. Dask workers have a'
    ' --memory-limit of their own.',
    lower_bound=0.5,
    **own,
  )
  flags.mark_flags_as_required(['source', 'category', 'output'], f)


def main(_) -> None:
  run(flags.FLAGS)


def run(f: flags.FlagValues) -> None:
  """Generates as the flags say, and prints a summary."""
  settings = Settings(
    shading=f.shading,
    tolerance=f.tolerance,
    similarity=f.similarity,
  )
  found = list_models(f.source, f.category, f.input, None if f.splits else f.limit, f.seed)
  if f.splits:
    found, note = keep_listed(found, f.splits, f.limit)
    print(note)
  found = with_owners_word(
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
    raise UserError(f'--source={f.source} holds records, which cannot be turned by --up or --turn')
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
    raise UserError(f'not one of {len(planned)} models could be made; {model_id}: {reason}')
  made = [o.row for o in outcomes if not o.reason]
  sheet = contact_sheet(dataset, rows_to_show(dataset, done, made, SHEET_MODELS))
  write_png(dataset, 'contact_sheet.png', sheet)
  print(summary(dataset, done, outcomes, failures, len(planned) - len(jobs)))


def _note_failures(dataset: Dataset, outcomes: Sequence[Outcome]) -> dict[str, str]:
  """Brings failures.json up to date and returns it: id -> reason, in the order of the rows."""
  models, done = dataset.manifest.models, dataset_lib.surface_counts(dataset) > 0
  failures = dataset_lib.read_json(dataset.root, 'failures.json') or {}
  failures |= {models[o.row].id: o.reason for o in outcomes if o.reason}
  missing = [m.id for m, there in zip(models, done, strict=True) if not there]
  failures = {i: failures[i] for i in missing if i in failures}
  dataset_lib.write_json(dataset.root, 'failures.json', failures)
  return failures


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
  outcomes: Sequence[Outcome],
  failures: dict[str, str],
  there: int,
) -> str:
  """What the run did, for a person.

  Args:
    dataset: the data set.
    done: [N] bool, the models it holds now.
    outcomes: of this run.
    failures: id -> reason.
    there: how many of the models that were asked for had been made before.
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
    lines.append(f'{np.mean([o.seconds for o in made]):.2f} s a model and worker')
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
  """What readers missed, ignored or guessed, and of how many models."""
  lacking = sum(f.missing > 0 for f in facts)
  lines = [f'{lacking} models name files or materials that are not there'] if lacking else []
  counts = Counter(note for f in facts for note in from_bits(f.notes))
  lines += [f'{count} models: {note}' for note, count in counts.most_common()]
  return [*lines, 'which models they are: datagen.inspect'] if lines else []


def _flow_lines(s: FlowStats) -> list[str]:
  if not s.visible:  # records that were made elsewhere
    return [
      f'no voxel is marked as visible; the flow of {s.matched:.1%} fetches a similar colour',
      f'colour where the flow points: off by {s.error:.3f} for all',
    ]
  return [
    f'voxels of a view: {s.visible:.1%} visible, {s.matched:.1%} hidden and matched by colour,'
    f' {s.fallback:.1%} hidden with no similar colour in view',
    f'colour where the flow points: off by {s.visible_error:.3f} for visible voxels'
    f' ({s.visible_faithful:.1%} of them by less than 0.1), by {s.error:.3f} for all',
  ]


if __name__ == '__main__':
  define_flags(flags.FLAGS)
  errors.run(main)
