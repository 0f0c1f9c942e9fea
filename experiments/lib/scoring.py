"""How well networks do on a model of a data set: what experiments.evaluate takes means of."""

import functools
import math
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from cvn import checkpoint, grid, methods, metrics, networks
from cvn.dataset import Dataset, Manifest, Record, read_record
from cvn.errors import UserError
from cvn.grid import ColoredVoxels

METRICS = {'iou': 'IoU', 'psnr_rgb': 'PSNR RGB', 'psnr_ycbcr': 'PSNR YCbCr'}

# The true colours are rounded to 8 bits, a squared error of 1/12. A view that comes closer than it
# (an object of one colour, sampled) would otherwise weigh more than all the others.
PSNR_CEILING = 10 * math.log10(12 * 255**2)  # 58.9 dB

# Thresholds to choose from: probabilities, or the lowest channel of the joint baseline's volume.
PROBABILITIES = np.linspace(0.02, 0.98, 49)
CHANNELS = np.linspace(-0.48, 0.48, 49)


class Network(NamedTuple):
  """A trained network."""

  kind: str  # a key of networks.NETWORKS
  variables: Any


class Baseline(NamedTuple):
  """What a category's training models have in common."""

  occupancy: np.ndarray  # [X, Y, Z] bool
  color: np.ndarray  # [3] in [0, 1]


def load(workdir: str, kinds: Sequence[str], dataset: Dataset) -> Network:
  """A network of one of the kinds.

  Raises:
    UserError: there is none, or it is for data of another size.
  """
  config, variables = checkpoint.load_network(workdir, *kinds)
  m = dataset.manifest
  network = networks.NETWORKS[config['network']](m.image_size, m.grid_size)
  image = jax.ShapeDtypeStruct((1, m.image_size, m.image_size, 3), np.float32)
  try:
    jax.eval_shape(functools.partial(network.apply, train=False), variables, image)
  except Exception as e:  # whichever layer meets the wrong size first
    raise UserError(
      f'{workdir} is not for {m.image_size}-pixel views and a grid of {m.grid_size}, as'
      f' {dataset.root} has them: train on this data set'
    ) from e
  return Network(config['network'], jax.device_put(variables))


def to_voxels(record: Record, grid_size: int) -> ColoredVoxels:
  """A record's surface as a volume."""
  return grid.to_voxels(record.surface_index, record.surface_color / 255, size=grid_size)


def score_views(
  manifest: Manifest, shape: Network, views: np.ndarray, *, flip: bool, carve: bool
) -> np.ndarray:
  """How occupied voxels are [V, X, Y, Z], of views [V, H, W, 4] in [0, 1] of a data set.

  Args:
    manifest: of the data set.
    shape: the network that scores voxels.
    views: [V, H, W, 4].
    flip: whether to take means with the mirrored views, see cvn.methods.
    carve: whether to carve shapes by the views' silhouettes, see cvn.carving.
  """
  azimuths = manifest.azimuths if carve else ()
  options = {'flip': flip, 'carve': azimuths, 'grid_size': manifest.grid_size}
  return methods.score(shape.kind, shape.variables, views, **options)


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
    flip: whether to take means with the mirrored views, see cvn.methods.
    carve: whether to carve shapes by the views' silhouettes, see cvn.carving.

  Returns:
    (thresholds [T], mean IoU [T]).
  """
  candidates = CHANNELS if shape.kind == 'r2n2' else PROBABILITIES
  size = dataset.manifest.grid_size
  curves = []
  for row in rows:
    record = read_record(dataset, row)
    true = to_voxels(record, size).occupancy
    views = record.views.astype(np.float32) / 255
    scores = score_views(dataset.manifest, shape, views, flip=flip, carve=carve)
    curves += [metrics.iou_at(s, true, candidates) for s in scores]
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

  The first one where no view has any occupied voxel. Arguments as of `score_model`.
  """
  size = dataset.manifest.grid_size
  found = {alpha: [] for alpha in alphas}
  for row in rows:
    record = read_record(dataset, row)
    true = to_voxels(record, size)
    views = record.views.astype(np.float32) / 255
    occupied = [true.occupancy] * len(views)
    if shape:
      scores = score_views(dataset.manifest, shape, views, flip=flip, carve=carve)
      occupied = scores >= threshold
    partners = [metrics.aligned_colors(o, true) for o in occupied]
    options = {'flip': flip, 'grid_size': size}
    blends = methods.blends(color.kind, color.variables, views, alphas, **options)
    for alpha, colors in zip(alphas, blends, strict=True):
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
    shape: without it colours are judged on the true shape.
    color: without it there is no PSNR.
    baseline: of the model's category, where it is to be judged, too.
    alpha: of the blend.
    threshold: of the shape network's score.
    flip: whether to take means with the mirrored views, see cvn.methods.
    carve: whether to carve shapes by the views' silhouettes, see cvn.carving.

  Returns:
    {'networks': {metric: [V]}, 'baselines': likewise}.
  """
  record = read_record(dataset, row)
  size = dataset.manifest.grid_size
  true = to_voxels(record, size)
  views = record.views.astype(np.float32) / 255
  scores = colors = None
  if shape:
    scores = score_views(dataset.manifest, shape, views, flip=flip, carve=carve)
  if color:
    options = {'alpha': alpha, 'threshold': threshold, 'flip': flip, 'grid_size': size}
    colors = methods.colors(color.kind, color.variables, views, **options)
  found = {'networks': {k: [] for k in METRICS}}
  if baseline:
    found['baselines'] = {k: [] for k in METRICS}
  for view in range(len(views)):
    occupied = true.occupancy
    if scores is not None:
      # As in the authors' program: > for the IoU, >= for colours.
      occupied = scores[view] >= threshold
      iou = metrics.iou(scores[view] > threshold, true.occupancy)
      found['networks']['iou'].append(float(iou))
      if baseline:
        found['baselines']['iou'].append(float(metrics.iou(baseline.occupancy, true.occupancy)))
    if colors is not None:
      partner = metrics.aligned_colors(occupied, true)
      append_psnr(found['networks'], metrics.psnr(colors[view][occupied], partner))
      if baseline:
        constant = np.broadcast_to(baseline.color, partner.shape)
        append_psnr(found['baselines'], metrics.psnr(constant, partner))
  return found


def append_psnr(found, psnr):
  """Appends a view's PSNRs, none above the ceiling; NaN stays NaN."""
  found['psnr_rgb'].append(float(np.minimum(psnr.rgb, PSNR_CEILING)))
  found['psnr_ycbcr'].append(float(np.minimum(psnr.ycbcr, PSNR_CEILING)))
