"""The stride-2 3x3x3 transposed convolution and the 3x3x3 convolution after it, as matrix products.

deconv.py uses them on a CPU without compiled kernels: XLA runs a convolution with dilated input in
naive loops there, two hundred times slower than a matrix product. Along one axis,
output 2j reads (x[j], w[0]) and (x[j-1], w[2]), output 2j+1 reads (x[j], w[1]): SAME padding of the
authors' framework. The eight parities of an output voxel are its phases; in phase layout, a map
is [B, X, Y, Z, 2, 2, 2, C], where entry (x, y, z, p, q, r) is voxel (2x + p, 2y + q, 2z + r).
Kernels are [3, 3, 3, in, out].
"""

import jax
import jax.numpy as jnp
import numpy as np

# [shift, parity, tap]: the output of that parity reads the input that many blocks back by that tap.
_DECONV_TAPS = np.zeros((2, 2, 3), np.float32)
_DECONV_TAPS[[0, 0, 1], [0, 1, 0], [0, 1, 2]] = 1

# [parity, reach, tap]: a block's voxel of that parity gives to voxel reach - 1, counted from the
# block's first, by that tap; a block reaches one voxel past itself on both sides.
_CONV_TAPS = np.zeros((2, 4, 3), np.float32)
for _parity in range(2):
  for _tap in range(3):
    _CONV_TAPS[_parity, _parity - _tap + 2, _tap] = 1


def deconv(x: jax.Array, kernel: jax.Array) -> jax.Array:
  """[B, X, Y, Z, in], [3, 3, 3, in, out] -> [B, 2X, 2Y, 2Z, out].

  One product of the input's eight shifted copies with a matrix that holds the taps, and zeros where
  a phase does not read a shift: 27 of its 64 blocks are filled, yet it beats eight exact products.
  """
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
  y = jnp.concatenate(shifted, axis=-1).reshape(-1, 8 * cin) @ deconv_matrix(kernel)
  return _interleave(y.reshape(b, sx, sy, sz, 2, 2, 2, cout))


def conv(x: jax.Array, kernel: jax.Array) -> jax.Array:
  """3x3x3 SAME convolution: [B, X, Y, Z, in], [3, 3, 3, in, out] -> [B, X, Y, Z, out].

  One product makes what every block of 2^3 voxels gives to the 4^3 voxels it reaches, and the
  overlaps are added.
  """
  sizes = x.shape[1:4]
  x = jnp.pad(x, ((0, 0), *((0, s % 2) for s in sizes), (0, 0)))
  b, sx, sy, sz, cin = x.shape
  blocks = x.reshape(b, sx // 2, 2, sy // 2, 2, sz // 2, 2, cin).transpose(0, 1, 3, 5, 2, 4, 6, 7)
  y = blocks.reshape(-1, 8 * cin) @ conv_matrix(kernel)
  y = y.reshape(b, sx // 2, sy // 2, sz // 2, 4, 4, 4, kernel.shape[-1])
  for axis in (1, 2, 3):
    y = _add_overlaps(y, axis, axis + 3)
  return _interleave(y)[:, : sizes[0], : sizes[1], : sizes[2]]


def deconv_matrix(kernel: jax.Array) -> jax.Array:
  """[8 * in, 8 * out]: from an input and the seven before it to the eight voxels of its block."""
  return _matrix(_DECONV_TAPS, kernel)


def conv_matrix(kernel: jax.Array) -> jax.Array:
  """[8 * in, 64 * out]: from a block's eight voxels to the 4^3 they reach."""
  return _matrix(_CONV_TAPS, kernel)


def _interleave(phases: jax.Array) -> jax.Array:
  """Phase layout [B, X, Y, Z, 2, 2, 2, C] -> plain layout [B, 2X, 2Y, 2Z, C]."""
  b, sx, sy, sz, *_, c = phases.shape
  return phases.transpose(0, 1, 4, 2, 5, 3, 6, 7).reshape(b, 2 * sx, 2 * sy, 2 * sz, c)


def _matrix(taps: np.ndarray, kernel: jax.Array) -> jax.Array:
  """[from, to, tap] and [3, 3, 3, in, out] -> [from^3 * in, to^3 * out]."""
  n, m, _ = taps.shape
  cin, cout = kernel.shape[-2:]
  for _ in range(3):  # one spatial axis of the kernel after another: x, y, z
    kernel = jnp.tensordot(kernel, taps, ((0,), (2,)))
  # now [in, out, from, to, from, to, from, to]
  return kernel.transpose(2, 4, 6, 0, 3, 5, 7, 1).reshape(n**3 * cin, m**3 * cout)


def _add_overlaps(y: jax.Array, axis: int, reach: int) -> jax.Array:
  """Folds the four voxels that a block reaches along an axis into the block's own two."""
  before, first, second, after = (
    jax.lax.index_in_dim(y, i, reach, keepdims=True) for i in range(4)
  )
  last = y.shape[axis] - 1

  def shifted(v, low):
    edge = [(0, 0)] * v.ndim
    edge[axis] = (1, 0) if low else (0, 1)
    start = 0 if low else 1
    return jnp.pad(jax.lax.slice_in_dim(v, start, start + last, axis=axis), edge)

  return jnp.concatenate([first + shifted(after, True), second + shifted(before, False)], reach)
