r"""Inspects a data set: its contents, its quality, and models that look wrong.

python -m datagen.inspect --data=DIR
python -m datagen.inspect --data=DIR --id=ID
"""

from collections import Counter
from collections.abc import Sequence

import numpy as np
from absl import flags
from PIL import Image
from tqdm import tqdm

from cvn import errors
from cvn.dataset import SPLITS, Dataset, Model, open_dataset, read_json, read_record, surface_counts
from cvn.errors import UserError
from cvn.files import atomic_write
from datagen.geometry.flow import FIDELITY
from datagen.quality.contact_sheet import contact_sheet
from datagen.quality.examine import Examined, examine, suspicions
from datagen.reading.notes import from_bits

BINS = 10  # of the histogram
BAR = 40  # characters
SHOWN = 20  # suspicious models, and reasons of failures
NOTED = 5  # models shown of each note
SHEET_MODELS = 12


def define_flags(f: flags.FlagValues) -> None:
  """Defines the program's flags. Not at import: the flags of several programs share names."""
  own = {'flag_values': f}
  flags.DEFINE_string('data', None, 'Folder or URL of the data set.', **own)
  flags.DEFINE_string('id', None, 'Id of a model, to describe it alone.', **own)
  flags.DEFINE_string(
    'sheet',
    'inspect.png',
    'File for a contact sheet, suspicious models first; empty for none.',
    **own,
  )
  flags.mark_flag_as_required('data', f)


def main(_) -> None:
  run(flags.FLAGS)


def run(f: flags.FlagValues) -> None:
  """Reads the data set and prints a description."""
  dataset = open_dataset(f.data)
  models, counts = dataset.manifest.models, surface_counts(dataset)
  rows = np.flatnonzero(counts)
  if f.id is not None:
    rows = [row for row, m in enumerate(models) if m.id == f.id]
    if not rows:
      raise UserError(f'{f.data} has no model {f.id}')
  if not len(rows):
    raise UserError(f'{f.data} holds no finished model: make them with datagen.generate')
  examined = [examine(read_record(dataset, row)) for row in tqdm(rows, unit='model', disable=None)]
  found = suspicions(examined, [models[row].category for row in rows])
  if f.id is not None:
    print(describe(models[rows[0]], examined[0], found[0]))
  else:
    print(overview(dataset, rows, examined, found))
  if f.sheet:
    order = np.argsort([not reasons for reasons in found], kind='stable')[:SHEET_MODELS]
    with atomic_write(f.sheet) as path:
      Image.fromarray(contact_sheet(dataset, [rows[i] for i in order])).save(path, 'PNG')
    print(f'look at {f.sheet}')


def describe(model: Model, examined: Examined, reasons: Sequence[str]) -> str:
  """A description of one model."""
  lines = [f'{k:10} {v}' for k, v in model._asdict().items() if v]
  lines += [
    f'{"voxels":10} {examined.voxels}',
    f'{"visible":10} {examined.visible:.1%} of the voxels in a view',
    f'{"colour":10} {_quality([examined])}',
    f'{"volume":10} {examined.volume:.3f} of its bounding box, signed',
  ]
  lines += [f'{"note":10} {note}' for note in from_bits(examined.notes)]
  return '\n'.join(lines + [f'suspicious {r}' for r in reasons])


def overview(
  dataset: Dataset,
  rows: Sequence[int],
  examined: Sequence[Examined],
  found: Sequence[Sequence[str]],
) -> str:
  """A description of a data set.

  Args:
    dataset: the data set.
    rows: rows of its finished models.
    examined: the measurements of these models.
    found: the suspicions about each model.
  """
  models = [dataset.manifest.models[row] for row in rows]
  planned = Counter(m.category for m in dataset.manifest.models)
  failures = read_json(dataset.root, 'failures.json') or {}
  lines = [f'{dataset.root}: {len(models)} of {planned.total()} models are made']
  header = f'{"category":16}{"planned":>9}{"made":>9}' + ''.join(f'{s:>9}' for s in SPLITS)
  lines += ['', header + f'{"visible":>9}{"within":>9}{"error":>9}']
  for category in sorted(planned):
    mine = [i for i, m in enumerate(models) if m.category == category]
    split = Counter(models[i].split for i in mine)
    line = f'{category:16}{planned[category]:9}{len(mine):9}'
    line += ''.join(f'{split[s]:9}' for s in SPLITS)
    told = [examined[i] for i in mine if examined[i].visible]  # the authors' records do not say
    if told:
      mean = np.mean(told, axis=0)
      line += f'{mean[1]:9.1%}{mean[3]:9.1%}{mean[2]:9.3f}'
    lines.append(line)
  lines.append(
    f'(visible: share of the voxels in a view; within: share of these with a colour error up to'
    f' {FIDELITY} where the flow points; error: mean colour error)'
  )
  lines += ['', f'colours of all models: {_quality(examined)}']
  lines += ['', 'licence']
  licences = Counter(m.licence or 'not stated' for m in models)
  lines += [f'{count:9}  {licence}' for licence, count in licences.most_common()]
  lines += ['', 'surface voxels', *_histogram([e.voxels for e in examined])]
  lines += ['', f'{len(failures)} failed']
  reasons = Counter(failures.values()).most_common(SHOWN)
  lines += [f'{count:9}  {reason}' for reason, count in reasons]
  lines += ['', 'ignored or guessed by the readers', *_noted(models, examined)]
  suspicious = [(m.id, r) for m, r in zip(models, found, strict=True) if r]
  lines += ['', f'{len(suspicious)} suspicious']
  lines += [f'  {model_id}: {"; ".join(r)}' for model_id, r in suspicious[:SHOWN]]
  if len(suspicious) > SHOWN:
    lines.append(f'  and {len(suspicious) - SHOWN} more; look at one with --id=ID')
  return '\n'.join(lines)


def _noted(models: Sequence[Model], examined: Sequence[Examined]) -> list[str]:
  """Each note and the models that have it."""
  having: dict[str, list[str]] = {}
  for model, e in zip(models, examined, strict=True):
    for note in from_bits(e.notes):
      having.setdefault(note, []).append(model.id)
  lines = []
  for note, ids in sorted(having.items(), key=lambda item: -len(item[1])):
    more = f' and {len(ids) - NOTED} more' if len(ids) > NOTED else ''
    lines.append(f'{len(ids):9}  {note}: {", ".join(ids[:NOTED])}{more}')
  return lines or ['        0']


def _quality(examined: Sequence[Examined]) -> str:
  error = np.mean([e.error for e in examined])
  told = [e for e in examined if e.visible]
  if not told:
    return f'mean error of the flows {error:.3f} for all voxels; none is marked as visible'
  mean = Examined(*np.mean(told, axis=0))
  return (
    f'mean error of the flows {mean.visible_error:.3f} for visible voxels'
    f' ({mean.visible_faithful:.1%} within {FIDELITY}), {error:.3f} for all'
  )


def _histogram(values: Sequence[int]) -> list[str]:
  count, edges = np.histogram(values, BINS)
  bars = np.ceil(count / count.max() * BAR).astype(int)
  return [
    f'{low:9.0f}  {"#" * bar} {n}' for low, bar, n in zip(edges[:-1], bars, count, strict=True)
  ]


if __name__ == '__main__':
  define_flags(flags.FLAGS)
  errors.run(main)
