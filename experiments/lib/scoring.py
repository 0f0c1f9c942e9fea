"""The metrics of networks on a model of a data set; experiments.evaluate averages them."""

import functools
import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from cvn import grid, infer, metrics
from cvn.dataset import Dataset, Record, read_record
from cvn.evaluation import pictures, surfaces
from cvn.evaluation.pictures import Pictures
from cvn.grid import ColoredVoxels
from cvn.infer import Network
from experiments.lib import memory as memories
from experiments.lib.memory import Memory

# F-scores by their tolerance in sides of the cube; Chamfer distances in sides of the cube, too.
F_SCORES = {f'f_{round(1 / t)}': f'F 1/{round(1 / t)}' for t in surfaces.TOLERANCES}
METRICS = {
  'iou': 'IoU',
  'psnr_rgb': 'PSNR RGB',
  'psnr_ycbcr': 'PSNR YCbCr',
  **F_SCORES,
  'chamfer': 'Chamfer',
  'picture_psnr': 'picture PSNR',
  'picture_ssim': 'picture SSIM',
}

# The true colours are rounded to 8 bits, a squared error of 1/12. A view with a smaller error (an
# object of one colour, sampled) would otherwise outweigh all the others.
PSNR_CEILING = 10 * math.log10(12 * 255**2)  # 58.9 dB

# Candidates for thresholds: probabilities, or the lowest channel of the adapted 3D-R2N2's volume.
PROBABILITIES = np.linspace(0.02, 0.98, 49)
CHANNELS = np.linspace(-0.48, 0.48, 49)


class Baseline(NamedTuple):
  """The trivial baselines of a category, made from its training models."""

  occupancy: np.ndarray  # [X, Y, Z] bool
  color: np.ndarray  # [3] in [0, 1]


def load(workdir: str, kinds: Sequence[str], dataset: Dataset) -> Network:
  """A network of one of the kinds, for the data set's sizes.

  Raises:
    UserError: the folder has none, or it is for data of another size.
  """
  m = dataset.manifest
  return infer.load(workdir, *kinds, image_size=m.image_size, grid_size=m.grid_size)


def to_voxels(record: Record, grid_size: int) -> ColoredVoxels:
  """A record's surface as a volume."""
  return grid.to_voxels(record.surface_index, record.surface_color / 255, size=grid_size)


def threshold_curve(
  dataset: Dataset,
  rows: Iterable[int],
  shape: Network,
  *,
  flip: bool = False,
  carve: bool = False,
) -> tuple[np.ndarray, np.ndarray]:
  """The mean IoU over all views of the rows' models for many thresholds.

  Args:
    dataset: the open data set.
    rows: of at least one model.
    shape: the network that scores voxels.
    flip: whether to average with the mirrored views, see cvn.infer.
    carve: whether to carve shapes by the views' silhouettes, see cvn.carving.

  Returns:
    (thresholds [T], mean IoU [T]).
  """
  candidates = CHANNELS if shape.kind == 'r2n2' else PROBABILITIES
  size = dataset.manifest.grid_size
  options = {'flip': flip, 'carve': carve, 'azimuths': dataset.manifest.azimuths}
  curves = []
  for row in rows:
    record = read_record(dataset, row)
    true = to_voxels(record, size).occupancy
    found = infer.reconstruct(record.views, shape=shape, **options)
    curves += [metrics.iou_at(p, true, candidates) for p in np.asarray(found.probability)]
  return candidates, np.mean(curves, axis=0)


def choose_alpha(
  dataset: Dataset,
  rows: Iterable[int],
  shape: Network | None,
  color: Network,
  alphas: Sequence[float],
  *,
  threshold: float,
  flip: bool = False,
  carve: bool = False,
) -> float:
  """The alpha of the best mean surface PSNR in RGB over all views of the rows' models.

  The first alpha if no view has an occupied voxel. Arguments as of `score_model`.
  """
  size = dataset.manifest.grid_size
  options = {'flip': flip, 'carve': carve, 'azimuths': dataset.manifest.azimuths}
  options['threshold'] = threshold
  found = {alpha: [] for alpha in alphas}
  for row in rows:
    record = read_record(dataset, row)
    true = to_voxels(record, size)
    results = infer.reconstruct_alphas(record.views, alphas, shape=shape, color=color, **options)
    partners = None
    for alpha, result in zip(alphas, results, strict=True):
      if partners is None:  # the same for every alpha
        occupied = [true.occupancy] * len(record.views)
        if shape:
          occupied = np.asarray(result.occupancy)
        partners = [metrics.aligned_colors(o, true) for o in occupied]
      colors = np.asarray(result.color)
      psnrs = [
        metrics.psnr(c[o], p).rgb for c, o, p in zip(colors, occupied, partners, strict=True)
      ]
      found[alpha] += [min(x, PSNR_CEILING) for x in psnrs if not math.isnan(x)]
  return max(alphas, key=lambda alpha: np.mean(found[alpha]) if found[alpha] else -math.inf)


def score_model(
  dataset: Dataset,
  row: int,
  shape: Network | None,
  color: Network | None,
  baseline: Baseline | None,
  memory: Memory | None = None,
  *,
  alpha: float,
  threshold: float,
  flip: bool = False,
  carve: bool = False,
  drawn: bool = False,
) -> dict[str, dict[str, list[float]]]:
  """The metrics of all views of a model.

  Args:
    dataset: the open data set.
    row: of the model.
    shape: None to evaluate colours on the true shape.
    color: None for no PSNR.
    baseline: of the model's category; None to leave it out.
    memory: training models to look up, which needs `shape`; None to leave them out.
    alpha: of the blend.
    threshold: of occupancy.
    flip: whether to average with the mirrored views, see cvn.infer.
    carve: whether to carve shapes by the views' silhouettes, see cvn.carving.
    drawn: whether pictures of the results are compared; needs both networks.

  Returns:
    {metric: [V]} of 'networks', 'baselines' and each of memory.WAYS.
  """
  record = read_record(dataset, row)
  size = dataset.manifest.grid_size
  true = to_voxels(record, size)
  options = {'flip': flip, 'carve': carve, 'azimuths': dataset.manifest.azimuths}
  options |= {'alpha': alpha, 'threshold': threshold}
  results = infer.split(infer.reconstruct(record.views, shape=shape, color=color, **options))
  found: dict[str, dict[str, list[float]]] = {'networks': {k: [] for k in METRICS}}
  as_drawn = pictures.draw_all(true, azimuths=dataset.manifest.azimuths) if drawn else None

  for result in results:
    own = found['networks']
    occupied = true.occupancy
    if shape:
      # As in the authors' program: > for the IoU, >= for everything else.
      occupied = result.occupancy
      own['iou'].append(float(metrics.iou(result.probability > threshold, true.occupancy)))
      append_distances(own, occupied, true)
    if color:
      partner = metrics.aligned_colors(occupied, true)
      append_psnr(own, metrics.psnr(result.color[occupied], partner))
      if baseline:
        trivial = found.setdefault('baselines', {k: [] for k in METRICS})
        constant = np.broadcast_to(baseline.color, partner.shape)
        append_psnr(trivial, metrics.psnr(constant, partner))
    if drawn:
      append_pictures(own, ColoredVoxels(occupied, result.color), as_drawn)

  if baseline and shape:
    constant = ColoredVoxels(
      baseline.occupancy, np.broadcast_to(baseline.color, (size,) * 3 + (3,))
    )
    repeat(found, 'baselines', score_voxels(constant, true, as_drawn, colors=False), len(results))
  if memory:
    score_row = functools.cache(
      lambda n: score_voxels(
        to_voxels(read_record(dataset, n), size), true, as_drawn, colors=color is not None
      )
    )
    chosen = memories.look_up(memory, record.views, true.occupancy, shape)
    for way, numbers in chosen.items():
      for n in numbers:
        repeat(found, way, score_row(int(n)), 1)
  return found


def score_voxels(
  predicted: ColoredVoxels, true: ColoredVoxels, as_drawn: Pictures | None, *, colors: bool
) -> dict[str, list[float]]:
  """The metrics of one coloured shape, one number each.

  Args:
    predicted: the shape.
    true: likewise.
    as_drawn: the true shape's pictures, if pictures are compared.
    colors: whether there are PSNRs of surface colours.
  """
  found = {k: [] for k in METRICS}
  found['iou'].append(float(metrics.iou(predicted.occupancy, true.occupancy)))
  append_distances(found, predicted.occupancy, true)
  if colors:
    append_psnr(found, metrics.surface_psnr(predicted, true))
  if as_drawn is not None:
    append_pictures(found, predicted, as_drawn)
  return found


def repeat(found, who: str, values: dict[str, list[float]], times: int) -> None:
  """Appends the same numbers for several views."""
  own = found.setdefault(who, {k: [] for k in METRICS})
  for metric, numbers in values.items():
    own[metric] += numbers * times


def append_distances(found, occupied: np.ndarray, true: ColoredVoxels) -> None:
  """Appends a view's F-scores and Chamfer distance."""
  distances = surfaces.measure(occupied, true.occupancy)
  for name, value in zip(F_SCORES, surfaces.f_scores(distances), strict=True):
    found[name].append(float(value))
  found['chamfer'].append(surfaces.chamfer(distances))


def append_pictures(found, predicted: ColoredVoxels, as_drawn: Pictures) -> None:
  """Appends a view's PSNR and SSIM of pictures."""
  likeness = pictures.compare(predicted, as_drawn)
  found['picture_psnr'].append(likeness.psnr)
  found['picture_ssim'].append(likeness.ssim)


def append_psnr(found, psnr):
  """Appends a view's PSNRs, none above the ceiling; NaN stays NaN."""
  found['psnr_rgb'].append(float(np.minimum(psnr.rgb, PSNR_CEILING)))
  found['psnr_ycbcr'].append(float(np.minimum(psnr.ycbcr, PSNR_CEILING)))
