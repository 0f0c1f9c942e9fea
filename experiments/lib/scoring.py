"""The metrics of networks on a model of a data set; experiments.evaluate averages them."""

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from cvn import grid, infer, metrics
from cvn.dataset import Dataset, Record, read_record
from cvn.grid import ColoredVoxels
from cvn.infer import Network

METRICS = {'iou': 'IoU', 'psnr_rgb': 'PSNR RGB', 'psnr_ycbcr': 'PSNR YCbCr'}

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
  *,
  alpha: float,
  threshold: float,
  flip: bool = False,
  carve: bool = False,
) -> dict[str, dict[str, list[float]]]:
  """The metrics of all views of a model.

  Args:
    dataset: the open data set.
    row: of the model.
    shape: None to evaluate colours on the true shape.
    color: None for no PSNR.
    baseline: of the model's category; None to leave it out.
    alpha: of the blend.
    threshold: of occupancy.
    flip: whether to average with the mirrored views, see cvn.infer.
    carve: whether to carve shapes by the views' silhouettes, see cvn.carving.

  Returns:
    {'networks': {metric: [V]}, 'baselines': {metric: [V]}}.
  """
  record = read_record(dataset, row)
  size = dataset.manifest.grid_size
  true = to_voxels(record, size)
  options = {'flip': flip, 'carve': carve, 'azimuths': dataset.manifest.azimuths}
  options |= {'alpha': alpha, 'threshold': threshold}
  results = infer.split(infer.reconstruct(record.views, shape=shape, color=color, **options))
  found = {'networks': {k: [] for k in METRICS}}
  if baseline:
    found['baselines'] = {k: [] for k in METRICS}
  for result in results:
    occupied = true.occupancy
    if shape:
      # As in the authors' program: > for the IoU, >= for colours.
      occupied = result.occupancy
      iou = metrics.iou(result.probability > threshold, true.occupancy)
      found['networks']['iou'].append(float(iou))
      if baseline:
        found['baselines']['iou'].append(float(metrics.iou(baseline.occupancy, true.occupancy)))
    if color:
      partner = metrics.aligned_colors(occupied, true)
      append_psnr(found['networks'], metrics.psnr(result.color[occupied], partner))
      if baseline:
        constant = np.broadcast_to(baseline.color, partner.shape)
        append_psnr(found['baselines'], metrics.psnr(constant, partner))
  return found


def append_psnr(found, psnr):
  """Appends a view's PSNRs, none above the ceiling; NaN stays NaN."""
  found['psnr_rgb'].append(float(np.minimum(psnr.rgb, PSNR_CEILING)))
  found['psnr_ycbcr'].append(float(np.minimum(psnr.ycbcr, PSNR_CEILING)))
