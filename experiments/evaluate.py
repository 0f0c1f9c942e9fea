r"""Mean IoU and surface PSNR of trained networks on a split of a data set.

python -m experiments.evaluate --data=DIR --shape=WORKDIR --color=WORKDIR [--split=test]
  [--category=NAME,...] [--alpha=0.2] [--baselines] [--json=FILE]

Means are taken over all views of all models: by view, by category and in total. The paper's last
column is the mean of the categories' means.
With --shape alone there is no PSNR; with --color alone colours are judged on the true shapes. A
view where no voxel is occupied has no PSNR: it is counted, and left out of the mean. No view counts
for more than 58.9 dB, the rounding of the true colours to 8 bits.

--baselines puts two trivial ones beside the networks, made of the split train: the mean shape of
the model's category, and its mean surface colour on the very voxels whose colours are judged.
"""

import contextlib
import functools
import json
import math
from typing import Any, NamedTuple

import jax
import numpy as np
from absl import flags
from tqdm import tqdm

from cvn import baselines, blending, checkpoint, data, environment, errors, metrics, reconstruct
from cvn.dataset import SPLITS, Dataset, open_dataset, read_record
from cvn.errors import UserError
from cvn.files import atomic_write
from cvn.grid import ColoredVoxels
from cvn.networks import ColorNetwork, ShapeNetwork

METRICS = {'iou': 'IoU', 'psnr_rgb': 'PSNR RGB', 'psnr_ycbcr': 'PSNR YCbCr'}


# The true colours are rounded to 8 bits, a squared error of 1/12. A view that comes closer than it
# (an object of one colour, sampled) would otherwise weigh more than all the others.
PSNR_CEILING = 10 * math.log10(12 * 255**2)  # 58.9 dB


class Baseline(NamedTuple):
  """What a category's training models have in common."""

  occupancy: np.ndarray  # [X, Y, Z] bool
  color: np.ndarray  # [3] in [0, 1]


def define_flags(f: flags.FlagValues) -> None:
  """The program's flags. Not at import: there the names of several programs would collide."""
  own = {'flag_values': f}
  flags.DEFINE_string('data', None, 'The data set: a folder or URL of datagen.generate.', **own)
  flags.DEFINE_string('shape', None, "The trained shape network's workdir.", **own)
  flags.DEFINE_string('color', None, "The trained colour network's workdir.", **own)
  flags.DEFINE_enum('split', 'test', SPLITS, 'The models to evaluate on.', **own)
  flags.DEFINE_list('category', [], 'Categories to evaluate on; all of them by default.', **own)
  flags.DEFINE_float(
    'alpha',
    blending.ALPHA,
    'In (0, 1]: the smaller, the more the sampled colours count.',
    **own,
  )
  flags.DEFINE_bool('baselines', False, 'Evaluate the trivial baselines, too.', **own)
  flags.DEFINE_string('json', None, 'A file for the numbers.', **own)
  flags.mark_flag_as_required('data', f)
  flags.register_validator('alpha', lambda x: 0 < x <= 1, 'must be in (0, 1]', f)


def main(_) -> int:
  return run(flags.FLAGS)


def run(f: flags.FlagValues) -> int:
  """Evaluates as the flags say; returns the exit status."""
  if not (f.shape or f.color):
    raise UserError('give --shape=WORKDIR, --color=WORKDIR or both')
  dataset = open_dataset(f.data)
  rows = data.select_rows(dataset, f.split, f.category)
  if len(rows) == 0:
    raise UserError(f'{f.data} has no finished model in the split {f.split}')
  networks = {
    kind: load(workdir, kind, dataset)
    for kind, workdir in (('shape', f.shape), ('color', f.color))
    if workdir
  }
  # The file's place is tried before the work, not after it.
  with atomic_write(f.json) if f.json else contextlib.nullcontext() as temporary:
    means = find_baselines(dataset, rows) if f.baselines else None
    found = [
      evaluate_model(dataset, row, networks, means, f.alpha)
      for row in tqdm(rows, desc=f'evaluate {f.split}', unit='model', disable=None)
    ]
    report = {name: f[name].value for name in ('data', 'split', 'shape', 'color', 'alpha')}
    report |= summarize(dataset, rows, found)
    print_report(report)
    if temporary:
      with open(temporary, 'w') as out:
        out.write(json.dumps(report, indent=1, allow_nan=False) + '\n')
  return 0


def load(workdir: str, kind: str, dataset: Dataset) -> dict[str, Any]:
  """A network's variables.

  Raises:
    UserError: there is none, or it is for data of another size.
  """
  _, variables = checkpoint.load_network(workdir, kind)
  m = dataset.manifest
  network = {'shape': ShapeNetwork, 'color': ColorNetwork}[kind](m.image_size, m.grid_size)
  image = jax.ShapeDtypeStruct((1, m.image_size, m.image_size, 3), np.float32)
  try:
    jax.eval_shape(functools.partial(network.apply, train=False), variables, image)
  except Exception as e:  # whichever layer meets the wrong size first
    raise UserError(
      f'{workdir} is not for {m.image_size}-pixel views and a grid of {m.grid_size}, as'
      f' {dataset.root} has them: train on this data set'
    ) from e
  return jax.device_put(variables)


def find_baselines(dataset: Dataset, rows) -> dict[str, Baseline]:
  """The baselines of the rows' categories.

  Raises:
    UserError: a category has no training model.
  """
  models = dataset.manifest.models
  wanted = sorted({models[row].category for row in rows})
  surfaces, colors = {c: [] for c in wanted}, {c: [] for c in wanted}
  for row in tqdm(data.select_rows(dataset, 'train', wanted), desc='baselines', disable=None):
    record = read_record(dataset, row)
    surfaces[models[row].category].append(record.surface_index)
    colors[models[row].category].append(record.surface_color / 255)
  for c in wanted:
    if not surfaces[c]:
      raise UserError(f'{dataset.root} has no finished {c} in the split train: no --baselines')
  size = dataset.manifest.grid_size
  return {
    c: Baseline(baselines.mean_shape(surfaces[c], size), baselines.mean_color(colors[c]))
    for c in wanted
  }


def evaluate_model(dataset: Dataset, row: int, networks, means, alpha: float) -> dict[str, Any]:
  """The metrics of all views of a model: {'networks': {metric: [V]}, 'baselines': likewise}."""
  record = read_record(dataset, row)
  size = dataset.manifest.grid_size
  true = ColoredVoxels(np.zeros((size,) * 3, bool), np.zeros((size,) * 3 + (3,)))
  at = tuple(record.surface_index.T)
  true.occupancy[at] = True
  true.color[at] = record.surface_color / 255
  views = record.views.astype(np.float32) / 255
  probability = colors = None
  if 'shape' in networks:
    probability = reconstruct.estimate_shape(networks['shape'], views, grid_size=size)
  if 'color' in networks:
    options = {'alpha': alpha, 'grid_size': size}
    colors = np.asarray(reconstruct.estimate_color(networks['color'], views, **options).blended)
  baseline = means[dataset.manifest.models[row].category] if means else None
  found = {'networks': {k: [] for k in METRICS}}
  if baseline:
    found['baselines'] = {k: [] for k in METRICS}
  for view in range(len(views)):
    occupied = true.occupancy
    if probability is not None:
      p = np.asarray(probability[view])
      occupied = p >= reconstruct.OCCUPIED
      found['networks']['iou'].append(float(metrics.iou(p > reconstruct.OCCUPIED, true.occupancy)))
      if baseline:
        found['baselines']['iou'].append(float(metrics.iou(baseline.occupancy, true.occupancy)))
    if colors is not None:
      partner = metrics.aligned_colors(occupied, true)
      append_psnr(found['networks'], metrics.psnr(colors[view][occupied], partner))
      if baseline:
        constant = np.broadcast_to(baseline.color, partner.shape)
        append_psnr(found['baselines'], metrics.psnr(constant, partner))
  return found


def append_psnr(found: dict[str, list[float]], psnr: metrics.SurfacePsnr) -> None:
  """Appends a view's PSNRs, none above the ceiling; NaN stays NaN."""
  found['psnr_rgb'].append(float(np.minimum(psnr.rgb, PSNR_CEILING)))
  found['psnr_ycbcr'].append(float(np.minimum(psnr.ycbcr, PSNR_CEILING)))


def summarize(dataset: Dataset, rows, found) -> dict[str, Any]:
  """The means, as they go to the JSON file; None where there is nothing to take a mean of."""
  azimuths = dataset.manifest.azimuths
  categories = [dataset.manifest.models[row].category for row in rows]
  report = {'models': len(rows), 'views': len(azimuths)}
  for who in found[0]:
    table = {k: np.array([x[who][k] for x in found]) for k in METRICS}  # [models, V]

    def means(table, models=slice(None), views=slice(None)):
      return {k: mean(v[models, views] if v.size else v) for k, v in table.items()}

    chosen = {
      c: [n for n, own in enumerate(categories) if own == c] for c in sorted(set(categories))
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
  if not report['shape']:
    print('no --shape: colours are judged on the true shapes')
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
