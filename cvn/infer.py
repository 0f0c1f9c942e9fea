"""From views to coloured voxels (section 3.5): the one way to use trained networks.

Views are [B, H, W, 4 or 3] as in cvn.readouts, or a single one without the batch axis; results then
have none either. Networks run on their running batch statistics.
"""

import functools
import operator
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import linen as nn

from cvn import blending, camera, carving, checkpoint, grid, metrics, readouts
from cvn.errors import UserError
from cvn.grid import ColoredVoxels
from cvn.networks import NETWORKS
from cvn.readouts import COLOR_KINDS, READOUTS, SHAPE_KINDS, THRESHOLDS


class Network(NamedTuple):
  """A trained network."""

  kind: str  # a key of networks.NETWORKS
  module: nn.Module
  variables: Any  # {'params', 'batch_stats'}


class Reconstruction(NamedTuple):
  """The networks' predictions, with or without a batch axis; None where they make none.

  `color` is always blend(sampled, regressed, weight), if there are these three.
  """

  occupancy: Any  # [X, Y, Z] bool: the probability reaches the threshold
  probability: Any  # [X, Y, Z] of being occupied; the lowest channel of the adapted 3D-R2N2
  color: Any  # [X, Y, Z, 3] the result's colours, sRGB in [0, 1]
  regressed: Any  # [X, Y, Z, 3]
  sampled: Any  # [X, Y, Z, 3] from the nearest foreground pixels
  flow: Any  # [X, Y, Z, 2] (u, v) in [0, 1]
  weight: Any  # [X, Y, Z] in [0, 1], of the sampled colour: recalculated with alpha


def load(
  workdir: str,
  *kinds: str,
  image_size: int = camera.IMAGE_SIZE,
  grid_size: int = grid.GRID_SIZE,
) -> Network:
  """A trained network from its folder.

  Args:
    workdir: the run's folder.
    *kinds: the accepted kinds of networks.
    image_size: size of the views, pixels.
    grid_size: size of the volumes.

  Raises:
    UserError: the folder has no such network, no checkpoint yet, or one for another size.
  """
  config, variables = checkpoint.load_network(workdir, *kinds)
  module = NETWORKS[config['network']](image_size, grid_size)
  image = jax.ShapeDtypeStruct((1, image_size, image_size, 3), np.float32)
  try:
    jax.eval_shape(functools.partial(module.apply, train=False), variables, image)
  except Exception as e:  # whichever layer meets the wrong size first
    raise UserError(
      f'{workdir} is not for {image_size}-pixel views and a grid of {grid_size}: train on data of'
      ' this size'
    ) from e
  return Network(config['network'], module, jax.device_put(variables))


def reconstruct(
  views: Any,
  *,
  shape: Network | None = None,
  color: Network | None = None,
  threshold: float | None = None,
  alpha: float = blending.ALPHA,
  flip: bool = False,
  carve: bool = False,
  azimuths: Sequence[float] = camera.AZIMUTHS,
) -> Reconstruction:
  """Shape and colours from views.

  Args:
    views: [H, W, 4 or 3] or [B, H, W, 4 or 3].
    shape: one of `SHAPE_KINDS`, for occupancies.
    color: one of `COLOR_KINDS`, for colours; the same object as `shape` runs only once.
    threshold: probability from which on a voxel is occupied; None for the authors' 0.8, and -0.25
      for the adapted 3D-R2N2.
    alpha: in (0, 1], see `blending.recalculate_weight`.
    flip: test-time augmentation: averages with the predictions for the mirrored views.
    carve: whether shapes are carved by the views' silhouettes, see cvn.carving.
    azimuths: degrees, those that a view may have been taken from; for `carve`.

  Raises:
    ValueError: views have another shape, or there is no network.
    UserError: alpha is outside (0, 1], or a network is not of a suitable kind.
  """
  options = {'threshold': threshold, 'flip': flip, 'carve': carve, 'azimuths': azimuths}
  (found,) = reconstruct_alphas(views, (alpha,), shape=shape, color=color, **options)
  return found


def reconstruct_alphas(
  views: Any,
  alphas: Sequence[float],
  *,
  shape: Network | None = None,
  color: Network | None = None,
  threshold: float | None = None,
  flip: bool = False,
  carve: bool = False,
  azimuths: Sequence[float] = camera.AZIMUTHS,
) -> Iterator[Reconstruction]:
  """`reconstruct` with several values of alpha; the networks run once.

  Args:
    views: see `reconstruct`, also for the other arguments.
    alphas: each in (0, 1].
    shape: network for occupancies.
    color: network for colours.
    threshold: occupancy threshold.
    flip: whether to average with the mirrored views.
    carve: whether to carve shapes.
    azimuths: azimuths for `carve`, degrees.

  Yields:
    A reconstruction for each alpha. Only colours and weights depend on it.

  Raises:
    ValueError: views have another shape, or there is no network.
    UserError: an alpha is outside (0, 1], or a network has an unsuitable kind.
  """
  views = jnp.asarray(views)
  batch = views[None] if views.ndim == 3 else views
  foreground = readouts.foreground_of(batch)
  shape_kind, color_kind = _check_kinds(shape, color, carve)
  if threshold is None:
    threshold = THRESHOLDS.get(shape_kind or color_kind, metrics.OCCUPIED)

  networks = {id(n): n for n in (shape, color) if n is not None}
  passes = {key: _predict(n, batch, flip) for key, n in networks.items()}
  probability = occupancy = None
  if shape is not None:
    probability = _mean([v.probability for v in passes[id(shape)]])
    if carve:
      probability = carving.carve(probability, foreground, azimuths=tuple(azimuths))
    occupancy = probability >= threshold
  # The baseline's colours depend on the threshold of its own shapes (equation 9).
  own = threshold if shape_kind in (None, 'r2n2') else THRESHOLDS['r2n2']
  for alpha in alphas:
    colors = (None,) * 5
    if color is not None:
      colors = _combine(passes[id(color)], float(alpha), float(own))
    found = Reconstruction(occupancy, probability, *colors)
    yield jax.tree.map(operator.itemgetter(0), found) if views.ndim == 3 else found


def split(reconstruction: Reconstruction) -> list[Reconstruction]:
  """The reconstructions of a batch one by one, as numpy arrays."""
  found = jax.device_get(reconstruction)
  count = len(jax.tree.leaves(found)[0])
  return [jax.tree.map(operator.itemgetter(n), found) for n in range(count)]


def to_voxels(reconstruction: Reconstruction) -> ColoredVoxels:
  """The coloured shape of one reconstruction (no batch axis), as numpy arrays."""
  return ColoredVoxels(np.asarray(reconstruction.occupancy), np.asarray(reconstruction.color))


def _check_kinds(shape, color, carve):
  """(kind of the shape network, kind of the colour network)."""
  if shape is None and color is None:
    raise ValueError('give a shape network, a colour network or both')
  for network, kinds, what in ((shape, SHAPE_KINDS, 'shapes'), (color, COLOR_KINDS, 'colours')):
    if network is not None and network.kind not in kinds:
      raise UserError(
        f'a {network.kind} network predicts no {what}: take one of {", ".join(kinds)}'
      )
  if carve and shape is not None and shape.kind == 'r2n2':
    raise UserError(
      'carving needs occupancy probabilities; the adapted 3D-R2N2 does not predict any'
    )
  return shape and shape.kind, color and color.kind


def _predict(network, views, flip):
  """The network's volumes of the views and, if `flip`, of the mirrored views, mirrored back."""
  run = functools.partial(_run, network.kind, network.module, network.variables)
  return [run(views), _mirror(run(views[:, :, ::-1]))] if flip else [run(views)]


@functools.partial(jax.jit, static_argnums=(0, 1))
def _run(kind, module, variables, views):
  image, color, foreground = readouts.prepare(views)
  return READOUTS[kind](module.apply(variables, image, train=False), color, foreground)


@jax.jit
def _mirror(volumes):
  """The volumes of the mirrored object."""
  mirrored = jax.tree.map(lambda x: x[:, ::-1], volumes)
  if mirrored.flow is None:
    return mirrored
  u, v = jnp.split(mirrored.flow, 2, axis=-1)
  return mirrored._replace(flow=jnp.concatenate([1 - u, v], -1))


@functools.partial(jax.jit, static_argnums=(1, 2))
def _combine(passes, alpha, threshold):
  """Colour, regressed, sampled, flow and weight: means over passes.

  The mean of blends is the blend of means if sampled colours are weighted by the blends' weights,
  and regressed ones by the rest.
  """
  first = passes[0]
  if first.joint is not None:
    return _mean([blending.adjust_color(v.joint, threshold)[1] for v in passes]), *[None] * 4
  regressed, sampled, flow = (
    [getattr(v, name) for v in passes] for name in ('regressed', 'sampled', 'flow')
  )
  if first.weight is None:
    color = sampled if first.regressed is None else regressed
    means = (None if x[0] is None else _mean(x) for x in (color, regressed, sampled, flow))
    return *means, None
  weights = [blending.recalculate_weight(v.weight, alpha=alpha) for v in passes]
  color = _mean([blending.blend(*x) for x in zip(sampled, regressed, weights, strict=True)])
  return (
    color,
    _mean(regressed, [1 - w for w in weights]),
    _mean(sampled, weights),
    _mean(flow, weights),
    _mean(weights)[..., 0],
  )


def _mean(values, weights=None):
  """The mean of arrays, weighted where weights have a sum."""
  if len(values) == 1:
    return values[0]
  plain = sum(values) / len(values)
  if weights is None:
    return plain
  total = sum(weights)
  weighted = sum(w * v for w, v in zip(weights, values, strict=True))
  return jnp.where(total > 0, weighted / jnp.where(total > 0, total, 1), plain)
