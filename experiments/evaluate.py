r"""Metrics of trained networks on a split of a data set.

python -m experiments.evaluate --data=DIR --shape=WORKDIR --color=WORKDIR [--split=test]
  [--category=NAME,...] [--source=NAME,...] [--alpha=NUMBER|val] [--threshold=NUMBER|val] [--flip]
  [--carve] [--baselines] [--retrieval] [--pictures] [--reference_data=DIR]
  [--reference_source=NAME,...] [--json=FILE]

Shapes come from a network of kind shape, joint or r2n2, colours from one of kind color, regression,
flow, joint or r2n2.

Shapes have an IoU, F-scores at tolerances from 1/200 to 1/20 of the cube's side, and a Chamfer
distance in sides of the cube (cvn/evaluation/surfaces.py); colours have a surface PSNR. With
--pictures, results are drawn from all azimuths and compared with pictures of the truth by PSNR and
SSIM (cvn/evaluation/pictures.py).

Means are over all views of all models: by view, by category and in total. The last column of the
paper's tables is the mean of the categories' means. With --shape alone there is no PSNR; with
--color alone colours are evaluated on the true shapes. A view without occupied voxels has no PSNR:
it is counted, and left out of the mean. No view counts for more than 58.9 dB, the rounding of the
true colours to 8 bits.

--baselines adds two trivial baselines made from the split train: the mean shape of the model's
category, and its mean surface colour on the same voxels as the networks' colours. --retrieval adds
what a network could reach that only remembers: the training model with the view whose outline, or
whose code in the shape network, is most similar, and, as a bound, the training model that is
nearest to the truth. A looked-up model is evaluated with its own shape and colours.

The splits val and train that thresholds, alpha, baselines and retrieval use are those of --data or,
for a data set that has only a test split, of --reference_data.
"""

import contextlib
import functools
import math
from collections.abc import Iterable
from typing import Any

import numpy as np
from absl import flags, logging
from tqdm import tqdm

from cvn import blending, data, metrics, readouts
from cvn.dataset import Dataset, open_dataset, read_record
from cvn.errors import UserError
from cvn.evaluation import baselines
from cvn.files import atomic_write
from experiments.lib import cli, markdown, scoring, stages
from experiments.lib import memory as memories
from experiments.lib.evaluation import ALPHAS, Settings, define_flags, make_options, read_flags
from experiments.lib.memory import WAYS, Memory
from experiments.lib.scoring import METRICS, Baseline, Network

DETAILED = ('iou', 'psnr_rgb', 'psnr_ycbcr')  # also told by category and view
WHO = {'networks': 'networks', 'baselines': 'mean shape, mean colour', **WAYS}
UNKNOWN_CAMERA = 'im2avatar_release'  # the source of models whose views have another camera


@cli.program(define_flags)
def main(f: flags.FlagValues) -> None:
  # Opened first, so that a file that cannot be written is found before the work.
  with atomic_write(f.json) if f.json else contextlib.nullcontext() as temporary:
    report = evaluate(read_flags(f))
    print_report(report)
    if temporary:
      stages.dump(temporary, {'argv': stages.argv(), **report})


def evaluate(s: Settings) -> dict[str, Any]:
  """The report of an evaluation, as JSON values.

  Raises:
    UserError: there is nothing to evaluate, or nothing to choose a threshold or an alpha on.
  """
  if not (s.shape or s.color):
    raise UserError('give --shape=WORKDIR, --color=WORKDIR or both')
  if s.retrieval and not s.shape:
    raise UserError('--retrieval needs --shape=WORKDIR: its encoder compares the views')
  if s.pictures and not (s.shape and s.color):
    raise UserError(
      '--pictures needs --shape=WORKDIR and --color=WORKDIR: it draws coloured shapes'
    )
  dataset = open_dataset(s.data)
  rows = data.select_rows(dataset, s.split, categories=s.category, sources=s.source)
  if len(rows) == 0:
    raise UserError(f'{s.data} has no finished model in the split {s.split}')
  if s.shape == s.color:  # one network for both runs once
    kinds = [kind for kind in readouts.SHAPE_KINDS if kind in readouts.COLOR_KINDS]
    shape = color = scoring.load(s.shape, kinds, dataset)
  else:
    shape = scoring.load(s.shape, readouts.SHAPE_KINDS, dataset) if s.shape else None
    color = scoring.load(s.color, readouts.COLOR_KINDS, dataset) if s.color else None
  models = dataset.manifest.models
  if s.carve and any(models[row].source == UNKNOWN_CAMERA for row in rows):
    logging.warning(
      "--carve assumes this project's camera; the camera of the authors' released views is unknown,"
      ' so shapes may lose voxels that they should keep'
    )
  reference = open_reference(s, dataset)
  means = find_baselines(reference, {models[row].category for row in rows}) if s.baselines else {}
  memory = find_memory(s, reference, shape) if s.retrieval else None
  options = {'flip': s.flip, 'carve': s.carve, 'drawn': s.pictures}
  threshold = find_threshold(s, reference, shape, color)
  alpha = find_alpha(s, reference, shape, color, threshold)
  options |= {'alpha': alpha, 'threshold': threshold}
  found = [
    scoring.score_model(
      dataset, row, shape, color, means.get(models[row].category), memory, **options
    )
    for row in tqdm(rows, desc=f'evaluate {s.split}', unit='model', disable=None)
  ]
  return {
    **{'data': s.data, 'split': s.split, 'shape': s.shape, 'color': s.color},
    **{'options': make_options(s, dataset), 'alpha': alpha, 'threshold': threshold},
    **summarize(dataset, rows, found),
  }


def open_reference(s: Settings, dataset: Dataset) -> Dataset:
  """The data set that thresholds, alpha, baselines and retrieval use.

  Raises:
    UserError: it cannot be read, or it has other sizes.
  """
  if not s.reference_data:
    return dataset
  reference = open_dataset(s.reference_data)
  sizes = [(d.manifest.image_size, d.manifest.grid_size) for d in (dataset, reference)]
  if sizes[0] != sizes[1]:
    raise UserError(
      f'{s.reference_data} has {sizes[1][0]}-pixel views and a grid of {sizes[1][1]}, {s.data}'
      f' {sizes[0][0]} and {sizes[0][1]}: --reference_data must be of the same sizes'
    )
  return reference


def find_threshold(
  s: Settings, dataset: Dataset, shape: Network | None, color: Network | None
) -> float:
  """The threshold of the settings.

  Raises:
    UserError: it has to be chosen, and there is nothing to choose it on.
  """
  if s.threshold not in (None, 'val'):
    return float(s.threshold)
  if shape is None or s.threshold is None:
    return readouts.THRESHOLDS.get((shape or color).kind, metrics.OCCUPIED)
  rows = _validation_rows(s, dataset, 'threshold')
  progress = tqdm(rows, desc='threshold on val', unit='model', disable=None)
  candidates, curve = scoring.threshold_curve(dataset, progress, shape, flip=s.flip, carve=s.carve)
  return float(candidates[np.argmax(curve)])


def find_alpha(
  s: Settings,
  dataset: Dataset,
  shape: Network | None,
  color: Network | None,
  threshold: float,
) -> float:
  """The alpha of the settings; any value if colours do not depend on it.

  Raises:
    UserError: it has to be chosen, and there is nothing to choose it on.
  """
  if s.alpha != 'val':
    return float(s.alpha)
  if color is None or color.kind not in readouts.BLENDING_KINDS:
    return blending.ALPHA
  rows = _validation_rows(s, dataset, 'alpha')
  progress = tqdm(rows, desc='alpha on val', unit='model', disable=None)
  options = {'threshold': threshold, 'flip': s.flip, 'carve': s.carve}
  return scoring.choose_alpha(dataset, progress, shape, color, ALPHAS, **options)


def _validation_rows(s, dataset, name):
  sources = s.reference_source or (() if s.reference_data else s.source)
  rows = data.select_rows(dataset, 'val', categories=s.category, sources=sources)
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


def find_memory(s: Settings, dataset: Dataset, shape: Network) -> Memory:
  """The training models of the settings' categories.

  Raises:
    UserError: there is none.
  """
  rows = data.select_rows(dataset, 'train', categories=s.category)
  if len(rows) == 0:
    raise UserError(f'{dataset.root} has no finished model in the split train: no --retrieval')
  progress = tqdm(rows, desc='training models', unit='model', disable=None)
  return memories.remember(dataset, progress, shape)


def summarize(dataset: Dataset, rows, found) -> dict[str, Any]:
  """The means as JSON values; None if there is nothing to average."""
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
      'error': {k: error(v) for k, v in table.items()},
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
  """The mean without NaN; None if there is no number, or if the mean is infinite."""
  values = values[~np.isnan(values)]
  result = float(np.mean(values)) if values.size else math.nan
  return result if math.isfinite(result) else None


def error(table: np.ndarray) -> float | None:
  """The standard error over models of their means over views [models, V]; None for one."""
  by_model = np.array([np.mean(v[~np.isnan(v)]) for v in table if not np.isnan(v).all()])
  result = np.std(by_model, ddof=1) / np.sqrt(len(by_model)) if len(by_model) > 1 else math.nan
  return float(result) if math.isfinite(result) else None


def print_report(report: dict[str, Any]) -> None:
  """Prints the means."""
  print(f'{report["models"]} models of the split {report["split"]}, {report["views"]} views each')
  if report['shape']:
    print(f'occupied: above {report["threshold"]:g}')
  if not report['shape']:
    print('no --shape: colours are evaluated on the true shapes')
  if report['color']:
    print(f'alpha: {report["alpha"]:g}')
  print(f'\n{measures_table(report)}\n')
  whose = [w for w in ('networks', 'baselines') if w in report]
  used = [k for k in DETAILED if report['networks']['total'][k] is not None]
  head = {'networks': '{}', 'baselines': '({})'}
  titles = [head[w].format(METRICS[k]) for k in used for w in whose]

  def row(label, *place):
    values = [functools.reduce(dict.get, place, report[w])[k] for k in used for w in whose]
    return [label, *(markdown.NONE if x is None else f'{x:.3f}' for x in values)]

  rows = [row('all', 'total')]
  if len(report['networks']['by_category']) > 1:
    rows.append(row('mean of categories', 'mean_of_categories'))
  rows += [row(markdown.escape(c), 'by_category', c) for c in report['networks']['by_category']]
  rows += [row(f'{a}°', 'by_view', a) for a in report['networks']['by_view']]
  print(f'\n{markdown.numbers(["", *titles], rows)}\n')
  if 'baselines' in report:
    print('in brackets: the mean training shape, the mean training colour on the same voxels')
  empty = report['networks']['views_without_voxels']
  if empty:
    print(f'{empty} views have no occupied voxel and no PSNR')


def measures_table(report: dict[str, Any]) -> str:
  """All metrics of the networks and of what they are compared with, ± the standard error."""
  used = [k for k in METRICS if report['networks']['total'][k] is not None]

  def cell(who, metric):
    value, spread = (report[who][kind][metric] for kind in ('total', 'error'))
    if value is None:
      return markdown.NONE
    return f'{value:.3f}' if spread is None else f'{value:.3f} {markdown.detail(f"± {spread:.3f}")}'

  rows = [[title, *(cell(who, k) for k in used)] for who, title in WHO.items() if who in report]
  caption = 'Means over all views of all models, ± one standard error over models'
  return markdown.numbers(['', *(METRICS[k] for k in used)], rows, caption=caption)


if __name__ == '__main__':
  main()
