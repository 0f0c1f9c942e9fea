r"""Mean IoU and surface PSNR of trained networks on a split of a data set.

python -m experiments.evaluate --data=DIR --shape=WORKDIR --color=WORKDIR [--split=test]
  [--category=NAME,...] [--source=NAME,...] [--alpha=NUMBER|val] [--threshold=NUMBER|val] [--flip]
  [--carve] [--baselines] [--reference_data=DIR] [--reference_source=NAME,...] [--json=FILE]

Shapes come from a network of kind shape, joint or r2n2, colours from one of kind color, regression,
flow, joint or r2n2.

Means are taken over all views of all models: by view, by category and in total. The paper's last
column is the mean of the categories' means.
With --shape alone there is no PSNR; with --color alone colours are judged on the true shapes. A
view where no voxel is occupied has no PSNR: it is counted, and left out of the mean. No view counts
for more than 58.9 dB, the rounding of the true colours to 8 bits.

--baselines puts two trivial ones beside the networks, made of the split train: the mean shape of
the model's category, and its mean surface colour on the very voxels whose colours are judged.

The splits val and train that thresholds, alpha and baselines come from are those of --data, or of
--reference_data: so a data set that has only a test split is evaluated as well.
"""

import contextlib
import functools
import json
import math
from collections.abc import Iterable
from typing import Any

import numpy as np
from absl import flags, logging
from tqdm import tqdm

from cvn import blending, data, environment, errors, metrics, readouts
from cvn.dataset import Dataset, open_dataset, read_record
from cvn.errors import UserError
from cvn.evaluation import baselines
from cvn.files import atomic_write
from experiments.lib import scoring
from experiments.lib.evaluation import ALPHAS, define_flags, make_options
from experiments.lib.scoring import METRICS, Baseline, Network
from experiments.lib.stages import argv

UNKNOWN_CAMERA = 'im2avatar_release'  # the source of models whose views have another camera


def main(_) -> int:
  return run(flags.FLAGS)


def run(f: flags.FlagValues) -> int:
  """Evaluates as the flags say; returns the exit status."""
  if not (f.shape or f.color):
    raise UserError('give --shape=WORKDIR, --color=WORKDIR or both')
  dataset = open_dataset(f.data)
  rows = data.select_rows(dataset, f.split, categories=f.category, sources=f.source)
  if len(rows) == 0:
    raise UserError(f'{f.data} has no finished model in the split {f.split}')
  shape = scoring.load(f.shape, readouts.SHAPE_KINDS, dataset) if f.shape else None
  color = shape  # one network for both runs once
  if f.color != f.shape:
    color = scoring.load(f.color, readouts.COLOR_KINDS, dataset) if f.color else None
  models = dataset.manifest.models
  if f.carve and any(models[row].source == UNKNOWN_CAMERA for row in rows):
    logging.warning(
      "--carve sees the views as this project's camera does; that of the authors' released views is"
      ' not known: shapes may lose what they should keep'
    )
  reference = open_reference(f, dataset)
  # The file's place is tried before the work, not after it.
  with atomic_write(f.json) if f.json else contextlib.nullcontext() as temporary:
    means = find_baselines(reference, {models[row].category for row in rows}) if f.baselines else {}
    threshold = find_threshold(f, reference, shape, color)
    alpha = find_alpha(f, reference, shape, color, threshold)
    found = [
      scoring.score_model(
        dataset,
        row,
        shape,
        color,
        means.get(models[row].category),
        alpha=alpha,
        threshold=threshold,
        flip=f.flip,
        carve=f.carve,
      )
      for row in tqdm(rows, desc=f'evaluate {f.split}', unit='model', disable=None)
    ]
    report = {'argv': argv(), **{n: f[n].value for n in ('data', 'split', 'shape', 'color')}}
    report |= {'options': make_options(f, dataset), 'alpha': alpha, 'threshold': threshold}
    report |= summarize(dataset, rows, found)
    print_report(report)
    if temporary:
      with open(temporary, 'w') as out:
        out.write(json.dumps(report, indent=1, allow_nan=False) + '\n')
  return 0


def open_reference(f: flags.FlagValues, dataset: Dataset) -> Dataset:
  """The data set that thresholds, alpha and baselines come from.

  Raises:
    UserError: it cannot be read, or its grid is another one.
  """
  if not f.reference_data:
    return dataset
  reference = open_dataset(f.reference_data)
  sizes = [(d.manifest.image_size, d.manifest.grid_size) for d in (dataset, reference)]
  if sizes[0] != sizes[1]:
    raise UserError(
      f'{f.reference_data} has {sizes[1][0]}-pixel views and a grid of {sizes[1][1]}, {f.data}'
      f' {sizes[0][0]} and {sizes[0][1]}: --reference_data must be of the same sizes'
    )
  return reference


def find_threshold(
  f: flags.FlagValues, dataset: Dataset, shape: Network | None, color: Network | None
) -> float:
  """The threshold that the flags ask for.

  Raises:
    UserError: it is to be chosen, and there is nothing to choose it on.
  """
  if f.threshold not in (None, 'val'):
    return float(f.threshold)
  if shape is None or f.threshold is None:
    return readouts.THRESHOLDS.get((shape or color).kind, metrics.OCCUPIED)
  progress = tqdm(
    _validation_rows(f, dataset, 'threshold'), desc='threshold on val', unit='model', disable=None
  )
  options = {'flip': f.flip, 'carve': f.carve}
  candidates, curve = scoring.threshold_curve(dataset, progress, shape, **options)
  return float(candidates[np.argmax(curve)])


def find_alpha(
  f: flags.FlagValues,
  dataset: Dataset,
  shape: Network | None,
  color: Network | None,
  threshold: float,
) -> float:
  """The alpha that the flags ask for; any where colours do not depend on it.

  Raises:
    UserError: it is to be chosen, and there is nothing to choose it on.
  """
  if f.alpha != 'val':
    return float(f.alpha)
  if color is None or color.kind not in readouts.BLENDING_KINDS:
    return blending.ALPHA
  progress = tqdm(
    _validation_rows(f, dataset, 'alpha'), desc='alpha on val', unit='model', disable=None
  )
  options = {'threshold': threshold, 'flip': f.flip, 'carve': f.carve}
  return scoring.choose_alpha(dataset, progress, shape, color, ALPHAS, **options)


def _validation_rows(f, dataset, name):
  sources = f.reference_source or (() if f.reference_data else f.source)
  rows = data.select_rows(dataset, 'val', categories=f.category, sources=sources)
  if len(rows) == 0:
    raise UserError(
      f'{dataset.root} has no finished model in the split val: give a --{name}, or another data set'
      ' as --reference_data'
    )
  return rows


def find_baselines(dataset: Dataset, categories: Iterable[str]) -> dict[str, Baseline]:
  """The baselines of some categories, from the data set's split train.

  Raises:
    UserError: a category has no training model.
  """
  models = dataset.manifest.models
  wanted = sorted(categories)
  known = [c for c in wanted if any(m.category == c for m in models)] or wanted
  surfaces, colors = {c: [] for c in wanted}, {c: [] for c in wanted}
  for row in tqdm(
    data.select_rows(dataset, 'train', categories=known), desc='baselines', disable=None
  ):
    record = read_record(dataset, row)
    surfaces[models[row].category].append(record.surface_index)
    colors[models[row].category].append(record.surface_color / 255)
  for c in wanted:
    if not surfaces[c]:
      raise UserError(
        f'{dataset.root} has no finished {c} in the split train: give another data set as'
        ' --reference_data, or no --baselines'
      )
  size = dataset.manifest.grid_size
  return {
    c: Baseline(baselines.mean_shape(surfaces[c], size), baselines.mean_color(colors[c]))
    for c in wanted
  }


def summarize(dataset: Dataset, rows, found) -> dict[str, Any]:
  """The means, as they go to the JSON file; None where there is nothing to take a mean of."""
  azimuths = dataset.manifest.azimuths
  models = [dataset.manifest.models[row] for row in rows]
  report = {'models': len(rows), 'views': len(azimuths)}
  for who in found[0]:
    table = {k: np.array([x[who][k] for x in found]) for k in METRICS}  # [models, V]

    def means(table, models=slice(None), views=slice(None)):
      return {k: mean(v[models, views] if v.size else v) for k, v in table.items()}

    chosen = {
      c: [n for n, m in enumerate(models) if m.category == c]
      for c in sorted({m.category for m in models})
    }
    by_category = {c: means(table, models=n) for c, n in chosen.items()}
    report[who] = {
      'total': means(table),
      'mean_of_categories': {
        k: mean(np.array([m[k] for m in by_category.values()], float)) for k in METRICS
      },
      'by_category': by_category,
      'by_view': {f'{a:g}': means(table, views=v) for v, a in enumerate(azimuths)},
      'views_without_voxels': int(np.isnan(table['psnr_rgb']).sum()),
      'by_model': {
        m.id: {
          'category': m.category,
          'source': m.source,
          **{k: [None if np.isnan(x) else x for x in v[n]] for k, v in table.items()},
        }
        for n, m in enumerate(models)
      },
    }
  return report


def mean(values: np.ndarray) -> float | None:
  """The mean of all that is a number; None where nothing is, or where it is infinite."""
  values = values[~np.isnan(values)]
  result = float(np.mean(values)) if values.size else math.nan
  return result if math.isfinite(result) else None


def print_report(report: dict[str, Any]) -> None:
  """The tables."""
  print(f'{report["models"]} models of the split {report["split"]}, {report["views"]} views each')
  if report['shape']:
    print(f'occupied: what scores above {report["threshold"]:g}')
  if not report['shape']:
    print('no --shape: colours are judged on the true shapes')
  if report['color']:
    print(f'alpha: {report["alpha"]:g}')
  whose = [w for w in ('networks', 'baselines') if w in report]
  used = [k for k in METRICS if report['networks']['total'][k] is not None]
  head = {'networks': '{}', 'baselines': '({})'}
  titles = [head[w].format(METRICS[k]) for k in used for w in whose]

  def numbers(*place):
    return [functools.reduce(dict.get, place, report[w])[k] for k in used for w in whose]

  lines = [('', titles), ('all', numbers('total'))]
  if len(report['networks']['by_category']) > 1:
    lines.append(('by category', numbers('mean_of_categories')))
  for group, form in (('by_category', '{}'), ('by_view', '{}°')):
    for name in report['networks'][group]:
      lines.append((form.format(name), numbers(group, name)))
  for label, cells in lines:
    text = [c if isinstance(c, str) else '-' if c is None else f'{c:.3f}' for c in cells]
    print(f'{label:<12}' + ''.join(f'{t:>14}' for t in text))
  if 'baselines' in report:
    print('in brackets: the mean training shape, the mean training colour on the same voxels')
  empty = report['networks']['views_without_voxels']
  if empty:
    print(f'{empty} views have no occupied voxel and no PSNR')


if __name__ == '__main__':
  environment.prepare()
  define_flags(flags.FLAGS)
  errors.run(main)
