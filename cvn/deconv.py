"""The stride-2 3x3x3 transposed convolution and the 3x3x3 convolution after it, as matrix products.

Along one axis, output 2j reads (x[j], w[0]) and (x[j-1], w[2]), output 2j+1 reads (x[j], w[1]):
SAME padding of the authors' framework. The eight parities of an output voxel are its phases, and a
map of twice the size is kept in phase layout, [B, X, Y, Z, 2, 2, 2, C], where entry
(x, y, z, p, q, r) is voxel (2x + p, 2y + q, 2z + r). Kernels are [3, 3, 3, in, out].
"""

import jax
import jax.numpy as jnp


def deconv(x: jax.Array, kernel: jax.Array) -> jax.Array:
  """[B, X, Y, Z, in], [3, 3, 3, in, out] -> phases [B, X, Y, Z, 2, 2, 2, out]."""
  b, *size, cin = x.shape
  cout = kernel.shape[-1]
  padded = jnp.pad(x, ((0, 0), (1, 0), (1, 0), (1, 0), (0, 0)))
  sx, sy, sz = size
  shifted = [
    padded[:, 1 - i : 1 - i + sx, 1 - j : 1 - j + sy, 1 - k : 1 - k + sz]
    for i in (0, 1)
    for j in (0, 1)
    for k in (0, 1)
  ]
  # tap of (shift, parity): shift 0 at parity 0 is w[0], at parity 1 w[1]; shift 1 at parity 0 w[2].
  zero = jnp.zeros((cin, cout), kernel.dtype)
  tap = {(0, 0): 0, (0, 1): 1, (1, 0): 2}
  matrix = jnp.concatenate(
    [
      jnp.concatenate(
        [
          kernel[tap[i, p], tap[j, q], tap[k, r]]
          if (i, p) in tap and (j, q) in tap and (k, r) in tap
          else zero
          for p in (0, 1)
          for q in (0, 1)
          for r in (0, 1)
        ],
        axis=1,
      )
      for i in (0, 1)
      for j in (0, 1)
      for k in (0, 1)
    ],
    axis=0,
  )
  y = jnp.concatenate(shifted, axis=-1).reshape(-1, 8 * cin) @ matrix
  return y.reshape(b, sx, sy, sz, 2, 2, 2, cout)


def conv(phases: jax.Array, kernel: jax.Array) -> jax.Array:
  """3x3x3 SAME convolution of a map in phase layout: [B,X,Y,Z,2,2,2,in] -> [B,X,Y,Z,2,2,2,out].

  Each block of 2^3 voxels reaches the 4^3 voxels around it: one matrix product makes what every
  block gives to its 4^3, and the overlaps are added.
  """
  b, sx, sy, sz, *_, cin = phases.shape
  cout = kernel.shape[-1]
  # reach[o, p] = the tap by which parity p of a block reaches voxel o - 1 of its 4^3, if any.
  rows = []
  zero = jnp.zeros((cin, cout), kernel.dtype)
  for p in (0, 1):
    for q in (0, 1):
      for r in (0, 1):
        columns = []
        for i in range(4):
          for j in range(4):
            for k in range(4):
              t = (p - i + 2, q - j + 2, r - k + 2)
              columns.append(kernel[t] if all(0 <= v <= 2 for v in t) else zero)
        rows.append(jnp.concatenate(columns, axis=1))
  y = phases.reshape(-1, 8 * cin) @ jnp.concatenate(rows, axis=0)
  y = y.reshape(b, sx, sy, sz, 4, 4, 4, cout)
  for space, reach in ((1, 4), (2, 5), (3, 6)):
    y = _add_overlaps(y, space, reach)
  return y


def _add_overlaps(y, space, reach):
  """Folds the four voxels a block reaches along one axis into its own two."""

  def take(i):
    return jax.lax.index_in_dim(y, i, reach, keepdims=True)

  def shift(v, by):
    pad = [(0, 0)] * v.ndim
    pad[space] = (1, 0) if by == 1 else (0, 1)
    n = v.shape[space]
    start = 0 if by == 1 else 1
    return jax.lax.slice_in_dim(jnp.pad(v, pad), start, start + n, axis=space)

  return jnp.concatenate([take(1) + shift(take(3), 1), take(2) + shift(take(0), -1)], axis=reach)


def interleave(phases: jax.Array) -> jax.Array:
  """Phase layout [B, X, Y, Z, 2, 2, 2, C] -> plain layout [B, 2X, 2Y, 2Z, C]."""
  b, sx, sy, sz, *_, c = phases.shape
  return phases.transpose(0, 1, 4, 2, 5, 3, 6, 7).reshape(b, 2 * sx, 2 * sy, 2 * sz, c)
