"""The colour network's heads, computed only where the colour losses look: at surface voxels.

A cell is a block of 2^3 voxels of the grid, one for each voxel of the trunk's features. A cell is
near if it holds a surface voxel or one of its 26 neighbours, as about an eighth of all cells do.
The heads' deconvolutions are computed in near cells, the convolutions after them at surface voxels.
Surface voxels come as in cvn.data: [B, S, 3], padded with PADDING_INDEX.

In training this network differs from `networks.ColorNetwork` in its batch statistics, which are
taken over the voxels that are computed: near cells in hidden layers, surface voxels in the three
results. With equal statistics its values are equal, so a trained one is used as a `ColorNetwork`.
"""

import functools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from cvn.networks import ColorVolumes
from cvn.ops import matmul
from cvn.ops.normalization import (
  ELU,
  SIGMOID,
  activated,
  coefficients,
  moments,
  sum_channels,
)

# A list of near cells has room for one of these shares of all cells: the smallest that suffices.
SHARES = (1 / 10, 1 / 8, 5 / 32, 1 / 5, 1 / 4, 1 / 3, 1 / 2, 1)
_CORNERS = [(i, j, k) for i in (0, 1) for j in (0, 1) for k in (0, 1)]


class Places(NamedTuple):
  """Where the heads are computed: N cells, some of them padding, and S voxels a sample."""

  cells: jax.Array  # [] how many of the N are near cells; the others give zeros before a norm
  read: jax.Array  # [N, 8] rows of the features that a cell reads
  own: jax.Array  # [B, S, 1] rows of [N * 8]: the surface voxels
  reaching: jax.Array  # [B, S, 8] rows of [N * 64]: what cells give to the voxels that they reach
  mask: jax.Array  # [B, S] False where padded


def near_cells(index: jax.Array, grid_size: int) -> jax.Array:
  """The near cells: [B, S, 3] -> [B, n, n, n] bool, n half the grid's size."""
  near = jax.vmap(
    lambda i: jnp.zeros((grid_size,) * 3, bool).at[tuple(i.T)].set(True, mode='drop')
  )(index)
  for axis in (1, 2, 3):  # a cell and one voxel on both sides of it

    def along(value, others, axis=axis):
      return tuple(value if n == axis else others for n in range(4))

    window, strides, padding = along(4, 1), along(2, 1), along((1, 1), (0, 0))
    near = jax.lax.reduce_window(near, False, jnp.logical_or, window, strides, padding)
  return near


def find_places(near: jax.Array, index: jax.Array, capacity: int) -> Places:
  """Lists the near cells, and finds what belongs to each surface voxel.

  Args:
    near: [B, n, n, n], of `near_cells`.
    index: [B, S, 3].
    capacity: N, no less than there are near cells.
  """
  b, n = near.shape[:2]
  cell = jnp.nonzero(near.reshape(-1), size=capacity, fill_value=near.size)[0]
  sample, x, y, z = cell // n**3, cell // n**2 % n, cell // n % n, cell % n
  # A cell reads its own feature and those before it; padding, and what is outside, reads none.
  read = [
    jnp.where((sample < b) & (x >= i) & (y >= j) & (z >= k), cell - (i * n + j) * n - k, near.size)
    for i, j, k in _CORNERS
  ]

  # Which of the list a cell is; one that is not in it, or outside the grid, is past its end.
  number = jnp.full((b, n + 2, n + 2, n + 2), capacity, jnp.int32)
  number = number.at[sample, x + 1, y + 1, z + 1].set(
    jnp.arange(capacity, dtype=jnp.int32), mode='drop'
  )

  def number_of(x, y, z):
    return number[jnp.arange(b)[:, None], x + 1, y + 1, z + 1]

  mask = jnp.all(index < 2 * n, axis=-1)
  voxel = jnp.moveaxis(jnp.where(mask[..., None], index, 0), -1, 0)
  odd = voxel % 2
  # Along an axis a cell reaches four voxels, the middle two are its own. An even voxel is also
  # reached by the cell before its own, as that one's last; an odd one by the cell behind.
  cells = voxel // 2, voxel // 2 - 1 + 2 * odd
  positions = odd + 1, 3 - 3 * odd
  reaching = []
  for corner in _CORNERS:
    chosen = [cells[side][axis] for axis, side in enumerate(corner)]
    px, py, pz = (positions[side][axis] for axis, side in enumerate(corner))
    reaching.append(number_of(*chosen) * 64 + (px * 4 + py) * 4 + pz)
  own = number_of(*cells[0]) * 8 + (odd[0] * 2 + odd[1]) * 2 + odd[2]
  return Places(jnp.sum(near), jnp.stack(read, -1), own[..., None], jnp.stack(reaching, -1), mask)


def color_heads(
  params: Any, features: jax.Array, places: Places, *, mixed: bool
) -> tuple[ColorVolumes, Any]:
  """The three heads of a `ColorNetwork` in training, at the surface voxels.

  Args:
    params: the heads', as the `ColorNetwork` names them.
    features: [B, n, n, n, C] of the trunk.
    places: of the batch.
    mixed: whether products are of bfloat16.

  Returns:
    (values [B, S, channels], batch statistics, as the `ColorNetwork` names them).
  """
  channels = features.shape[-1]
  # Read as float32, for gradients are added where they are read.
  rows = features.astype(jnp.float32).reshape(-1, channels)
  read = rows.at[places.read].get(mode='fill', fill_value=0).reshape(-1, 8 * channels)
  product = _mixed_product if mixed else jnp.matmul
  voxels = jnp.sum(places.mask)

  def at_surface(values, rows):
    """[.., C] by [B, S, R] -> the sums [B, S, C] of R rows; a cell outside the grid gives 0."""
    found = values.at[rows].get(mode='fill', fill_value=0).sum(2)
    return jnp.where(places.mask[..., None], found, 0)

  def deconv(p):
    kernel = p['kernel']
    return product(read, matmul.deconv_matrix(kernel)).reshape(-1, kernel.shape[-1])

  def head(p):
    hidden, hidden_statistics = _normalized(deconv(p['deconv']), 8 * places.cells, p['deconv'], ELU)
    kernel = p['conv']['kernel']
    given = product(hidden.reshape(len(read), -1), matmul.conv_matrix(kernel))
    out = at_surface(given.reshape(-1, kernel.shape[-1]), places.reaching)
    out, statistics = _normalized(out, voxels, p['conv'], SIGMOID)
    return out, {'deconv': hidden_statistics, 'conv': statistics}

  regressed, of_regressed = head(params['regressed'])
  p = params['flow']['deconv']
  flow, of_flow = _normalized(at_surface(deconv(p), places.own), voxels, p, SIGMOID)
  weight, of_weight = head(params['weight'])
  statistics = {'regressed': of_regressed, 'flow': {'deconv': of_flow}, 'weight': of_weight}
  return ColorVolumes(regressed, flow, 1 - weight), statistics


def by_capacity(function: Callable, near: jax.Array, *arrays: Any) -> tuple[jax.Array, Any]:
  """`function(capacity, *arrays)` with the smallest capacity that holds the near cells.

  Args:
    function: returns (scalar, other results); it is differentiated by the first two arrays.
    near: [B, n, n, n], of `near_cells`.
    *arrays: trees of arrays.
  """
  capacities = [math.ceil(share * near.size) for share in SHARES]
  choice = jnp.searchsorted(jnp.array(capacities), jnp.sum(near))
  branches = [functools.partial(function, c) for c in capacities]

  # Derivatives are made together with the value. Otherwise `lax.switch` keeps what is needed for
  # them of every branch, with zeros in place of what the others have not made.
  @jax.custom_vjp
  def chosen(*arrays):
    return jax.lax.switch(choice, branches, *arrays)

  def forward(*arrays):
    derived = [jax.value_and_grad(f, (0, 1), has_aux=True) for f in branches]
    return jax.lax.switch(choice, derived, *arrays)

  def backward(gradient, cotangents):
    scaled = jax.tree.map(lambda g: g * cotangents[0].astype(g.dtype), gradient)
    return (*scaled, *[None] * (len(arrays) - 2))

  chosen.defvjp(forward, backward)
  return chosen(*arrays)


def _normalized(x, count, params, activation):
  """Bias, normalisation and activation of `count` rows (others are 0): (y, the statistics)."""
  mean, variance = moments(sum_channels(x), jnp.maximum(count, 1).astype(jnp.float32))
  scale, shift = coefficients(mean, variance, params['norm']['scale'], params['norm']['bias'])
  y = activated(x, scale, shift, activation)
  return y, {'norm': {'mean': mean + params['bias'], 'var': variance}}


@jax.custom_vjp
def _mixed_product(a, b):
  """a b in float32, the factors rounded to bfloat16; so are those of its derivatives."""
  return _bfloat16_product(a, b)


def _bfloat16_product(a, b):
  a, b = a.astype(jnp.bfloat16), b.astype(jnp.bfloat16)
  return jnp.matmul(a, b, preferred_element_type=jnp.float32)


def _mixed_forward(a, b):
  return _mixed_product(a, b), (a, b)


def _mixed_backward(residuals, dy):
  a, b = residuals
  return _bfloat16_product(dy, b.T).astype(a.dtype), _bfloat16_product(a.T, dy)


_mixed_product.defvjp(_mixed_forward, _mixed_backward)
