"""The 3x3x3 transposed convolution of stride 2 and the 3x3x3 convolution, as matrix products.

deconv.py uses them on a CPU without compiled kernels: XLA runs a convolution with dilated input in
naive loops there, two hundred times slower than a matrix product. deconv.py defines the operations,
their results and gradients; `kernel` comes rounded to the digits of `x`, and is float32.

A loop goes over slabs of the volume x [B, X, Y, Z, in]. So everything between the volumes that are
read and the volume that is written stays in the cache: the shifted copies that the products read
have 8 to 27 times as many numbers as the volume. A slab [n, S, Y, Z, in] is a few planes of one
sample (n = 1), or n whole samples (S = X). Where a batch is spread over several devices, each of
them runs the whole loop.
"""

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from cvn.ops.normalization import Activation, activated, sum_channels

_DECONV_ROWS, _CONV_ROWS = 4096, 8192  # voxels of x in a slab, at most
_BLOCK = 4  # voxels along z that conv takes together, at most
_TAPS = [(i, j, k) for i in range(3) for j in range(3) for k in range(3)]

# [shift, parity, tap]: the output of that parity reads the input that many blocks back by that tap.
_DECONV_TAPS = np.zeros((2, 2, 3), np.float32)
_DECONV_TAPS[[0, 0, 1], [0, 1, 0], [0, 1, 2]] = 1


def deconv(
  x: jax.Array,
  scale: jax.Array,
  shift: jax.Array,
  kernel: jax.Array,
  activation: Activation,
  dtype: Any,
) -> tuple[jax.Array, jax.Array]:
  """The deconvolution: (y, sums), see deconv.py.

  Along an axis, output 2j reads (a[j], w[0]) and (a[j-1], w[2]), output 2j+1 reads (a[j], w[1]). So
  an even plane of y is a product of eight shifted copies of a, an odd plane one of four; 27 of 48
  blocks of the two matrices are filled.

  Args:
    x: [B, X, Y, Z, in].
    scale, shift: [in].
    kernel: [3, 3, 3, in, out].
    activation: before the product.
    dtype: of y.
  """
  b, *size, cin = x.shape
  slabs, cout = _slabs(x.shape, _DECONV_ROWS), kernel.shape[-1]
  matrix = deconv_matrix(kernel).reshape(2, 4 * cin, 2, 4 * cout)
  even, odd = matrix[:, :, 0].reshape(8 * cin, -1), matrix[0, :, 1]
  last = activated(x[:, slabs[2] - 1 : -1 : slabs[2]], scale, shift, activation)
  before = _pad(last, 1, (1, 0))  # the plane before each slab

  def slab(_, arrays):
    x, before = arrays
    n, s, sy, sz, _ = x.shape
    a = jnp.concatenate([before, activated(x, scale, shift, activation)], 1)
    a = _pad(_pad(a.astype(jnp.float32), 2, (1, 0)), 3, (1, 0))
    copies = [
      a[:, 1 - i : 1 - i + s, 1 - j : 1 - j + sy, 1 - k : 1 - k + sz]
      for i in (0, 1)
      for j in (0, 1)
      for k in (0, 1)
    ]

    def planes(copies, weights):
      y = jnp.concatenate(copies, -1).reshape(-1, len(weights)) @ weights
      y = y.reshape(n, s, sy, sz, 2, 2 * cout).swapaxes(3, 4)  # [.., y, 2, z, (2, out)]
      return y.reshape(n, s, 2 * sy, 2 * sz, cout)

    y = jnp.stack([planes(copies, even), planes(copies[:4], odd)], 2).astype(dtype)
    return None, (y, sum_channels(y))

  _, (y, sums) = _scan(slab, _split(x, slabs), _split(before, slabs))
  return y.reshape(b, *(2 * s for s in size), cout), jnp.sum(sums, 0)


def deconv_gradient(
  x: jax.Array,
  scale: jax.Array,
  shift: jax.Array,
  kernel: jax.Array,
  activation: Activation,
  y: jax.Array,
  dy: jax.Array,
  dsums: jax.Array,
) -> tuple[jax.Array, ...]:
  """Gradients of x, scale, shift and kernel.

  Output 2j + t reads a[j] by tap t, so that row j of the copies holds the 27 outputs behind 2j.

  Args:
    x, scale, shift, kernel, activation: as of `deconv`.
    y: its result.
    dy, dsums: cotangents of its results.
  """
  slabs, (cin, cout) = _slabs(x.shape, _DECONV_ROWS), kernel.shape[-2:]
  step = 2 * slabs[2]
  first = _total(y[:, step::step], dy[:, step::step], dsums, x.dtype)
  behind = _pad(first, 1, (0, 1))  # the plane behind each slab of y

  def gather(y, dy, behind):
    g = jnp.concatenate([_total(y, dy, dsums, x.dtype), behind], 1)
    g = _pad(_pad(g, 2, (0, 1)), 3, (0, 1))
    ends = [s - 2 for s in g.shape[1:4]]
    return [
      g[:, i : i + ends[0] : 2, j : j + ends[1] : 2, k : k + ends[2] : 2] for i, j, k in _TAPS
    ]

  weights = kernel.swapaxes(3, 4).reshape(27 * cout, cin)
  arrays = _split(y, slabs), _split(dy, slabs), _split(behind, slabs)
  *gradients, dweights = _gradients((x, scale, shift), activation, weights, slabs, gather, arrays)
  return *gradients, dweights.reshape(3, 3, 3, cout, cin).swapaxes(3, 4)


def conv(
  x: jax.Array,
  scale: jax.Array,
  shift: jax.Array,
  kernel: jax.Array,
  activation: Activation,
  dtype: Any,
) -> tuple[jax.Array, jax.Array]:
  """The convolution: (y, sums), see deconv.py.

  One product makes what each block of voxels along z gives to the voxels that it reaches: 3 x 3
  rows, each of the block's length and 2 more. The loop sums the rows over y. The sums over x come
  after it, since a slab also gives to planes of its neighbours, and then the overlaps along z.

  Args:
    x: [B, X, Y, Z, in].
    scale, shift: [in].
    kernel: [3, 3, 3, in, out].
    activation: before the product.
    dtype: of y.
  """
  b, sx, sy, sz, cin = x.shape
  slabs, cout, block = _slabs(x.shape, _CONV_ROWS), kernel.shape[-1], math.gcd(sz, _BLOCK)
  matrix = _window_matrix(kernel, block)

  def add(given, axis):
    """Sums the three rows that a row gives to along an axis; [3, ...] by tap."""
    low, high = (
      jax.lax.slice_in_dim(v, start, start + v.shape[axis] - 1, axis=axis)
      for v, start in ((given[0], 0), (given[2], 1))
    )
    return given[1] + _pad(low, axis, (1, 0)) + _pad(high, axis, (0, 1))

  def slab(_, arrays):
    (x,) = arrays
    a = activated(x, scale, shift, activation).astype(jnp.float32)
    given = (a.reshape(-1, block * cin) @ matrix).reshape(*x.shape[:3], sz // block, 3, 3, -1)
    return None, add([given[..., j, :] for j in range(3)], 2)

  _, given = _scan(slab, _split(x, slabs))
  given = given.reshape(b, sx, sy, sz // block, 3, block + 2, cout)
  given = add([given[..., i, :, :] for i in range(3)], 1)
  y, end = given[..., 1:-1, :], block - 1
  y += _pad(_pad(given[:, :, :, 1:, :1], 3, (0, 1)), 4, (end, 0))  # the next block's first
  y += _pad(_pad(given[:, :, :, :-1, -1:], 3, (1, 0)), 4, (0, end))  # the last one's last
  y = y.reshape(b, sx, sy, sz, cout).astype(dtype)
  return y, sum_channels(y)


def conv_gradient(
  x: jax.Array,
  scale: jax.Array,
  shift: jax.Array,
  kernel: jax.Array,
  activation: Activation,
  y: jax.Array,
  dy: jax.Array,
  dsums: jax.Array,
) -> tuple[jax.Array, ...]:
  """Gradients of x, scale, shift and kernel.

  The copies hold the cotangents of the 3 x 3 rows that a block gives to.

  Args:
    x, scale, shift, kernel, activation: as of `conv`.
    y: its result.
    dy, dsums: cotangents of its results.
  """
  sx, sy, sz = x.shape[1:4]
  slabs, block = _slabs(x.shape, _CONV_ROWS), math.gcd(sz, _BLOCK)
  total = _total(y, dy, dsums, x.dtype)
  for axis in (1, 2, 3):
    total = _pad(total, axis, (1, 1))
  rows = [total[:, :, :, e : e + sz - block + 1 : block] for e in range(block + 2)]
  planes = np.arange(0, sx, slabs[2])[:, None] + np.arange(slabs[2] + 2)
  windows = jnp.concatenate(rows, -1)[:, planes]  # a slab's planes and one on both sides
  windows = windows.reshape(*slabs[:2], slabs[2] + 2, *windows.shape[3:])

  def gather(g):
    n = g.shape[1] - 2
    return [g[:, 2 - i : 2 - i + n, 2 - j : 2 - j + sy] for i in range(3) for j in range(3)]

  matrix, pull = jax.vjp(lambda k: _window_matrix(k, block).T, kernel)
  *gradients, dmatrix = _gradients((x, scale, shift), activation, matrix, slabs, gather, (windows,))
  return *gradients, *pull(dmatrix)


def deconv_matrix(kernel: jax.Array) -> jax.Array:
  """[8 * in, 8 * out]: from an input and the seven before it to the eight voxels of its block."""
  return _matrix(_DECONV_TAPS, kernel)


def conv_matrix(kernel: jax.Array) -> jax.Array:
  """[8 * in, 64 * out]: from a block's eight voxels to the 4^3 they reach."""
  return _matrix(_conv_taps(2), kernel)


def _window_matrix(kernel: jax.Array, block: int) -> jax.Array:
  """[block * in, 3 * 3 * (block + 2) * out]: what a block along z gives, by the taps of x and y."""
  taps = _conv_taps(block)
  return jnp.einsum('ijtco,zet->zcijeo', kernel, taps).reshape(block * kernel.shape[3], -1)


def _conv_taps(block: int) -> np.ndarray:
  """[voxel, reach, tap]: a block's voxel gives to voxel reach - 1 of the block by that tap.

  A block reaches one voxel past itself on both sides.
  """
  taps = np.zeros((block, block + 2, 3), np.float32)
  for voxel in range(block):
    for tap in range(3):
      taps[voxel, voxel - tap + 2, tap] = 1
  return taps


def _gradients(inputs, activation, weights, slabs, gather: Callable, arrays):
  """Gradients of x, scale, shift and weights.

  `gather` makes a list of copies [n, S, ...] of a slab of the arrays [N, n, ...]; all copies of a
  voxel or block, times the weights, are the gradient of its activations.
  """
  x, scale, shift = inputs

  def slab(sums, arrays):
    x, *rest = arrays
    a, pull = jax.vjp(lambda *v: activated(*v, activation), x, scale, shift)
    copies = jnp.concatenate(gather(*rest), -1).reshape(-1, len(weights))
    dx, *coefficients = pull((copies @ weights).reshape(a.shape).astype(a.dtype))
    dweights = copies.T @ a.astype(jnp.float32).reshape(len(copies), -1)
    return jax.tree.map(jnp.add, sums, (*coefficients, dweights)), dx

  zeros = jnp.zeros_like(scale), jnp.zeros_like(shift), jnp.zeros_like(weights)
  sums, dx = lax.scan(slab, zeros, (_split(x, slabs), *arrays))
  return dx.reshape(x.shape), *sums


def _slabs(shape, rows):
  """(N, n, S): how many slabs there are, and the samples and the planes of each."""
  b, sx, *rest = shape[:-1]
  plane = math.prod(rest)
  if sx * plane <= rows:
    n = max(d for d in range(1, b + 1) if b % d == 0 and d * sx * plane <= rows)
    return b // n, n, sx
  s = max(d for d in range(1, sx + 1) if sx % d == 0 and (d == 1 or d * plane <= rows))
  return b * sx // s, 1, s


def _split(v, slabs):
  """[B, .., Y, Z, C] -> [N, n, .., Y, Z, C], of a volume whose planes belong to slabs in order."""
  return v.reshape(*slabs[:2], -1, *v.shape[2:])


def _scan(slab, *arrays):
  """The loop over slabs; JAX's own derivative makes the copies again and does not keep them."""
  return lax.scan(jax.checkpoint(slab, prevent_cse=False), None, arrays)


def _total(y, dy, dsums, dtype):
  """The cotangent of y, which the sums depend on too, with as many digits as that type has."""
  first, second = dsums.reshape(2, 1, 1, 1, 1, -1)
  total = dy.astype(jnp.float32) + first + 2 * second * y.astype(jnp.float32)
  return total.astype(dtype).astype(jnp.float32)


def _pad(v, axis, widths):
  """v with zeros before and after it along an axis."""
  return jnp.pad(v, [widths if n == axis else (0, 0) for n in range(v.ndim)])


def _matrix(taps: np.ndarray, kernel: jax.Array) -> jax.Array:
  """[from, to, tap] and [3, 3, 3, in, out] -> [from^3 * in, to^3 * out]."""
  n, m, _ = taps.shape
  cin, cout = kernel.shape[-2:]
  for _ in range(3):  # one spatial axis of the kernel after another: x, y, z
    kernel = jnp.tensordot(kernel, taps, ((0,), (2,)))
  # now [in, out, from, to, from, to, from, to]
  return kernel.transpose(2, 4, 6, 0, 3, 5, 7, 1).reshape(n**3 * cin, m**3 * cout)
