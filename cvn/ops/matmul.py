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
  slabs, cout = _slabs(x.shape, _DECONV_ROWS), kernel.shape[-1]
  matrix = deconv_matrix(kernel).reshape(2, 4 * cin, 2, 4 * cout)
  even, odd = matrix[:, :, 0].reshape(8 * cin, -1), matrix[0, :, 1]
  last = activated(x[:, slabs[2] - 1 : -1 : slabs[2]], gain, offset, activation)
  before = _pad(last, 1, (1, 0))  # the plane before each slab

  def slab(_, arrays):
    x, before = arrays
    n, s, sy, sz, _ = x.shape
    a = jnp.concatenate([before, activated(x, gain, offset, activation)], 1)
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
    return None, (y, _sums(y))

  _, (y, sums) = _scan(slab, _split(x, slabs), _split(before, slabs))
  return y.reshape(b, *(2 * s for s in size), cout), jnp.sum(sums, 0)


def conv(x: jax.Array, kernel: jax.Array) -> jax.Array:
  """3x3x3 SAME convolution: [B, X, Y, Z, in], [3, 3, 3, in, out] -> [B, X, Y, Z, out].

  One product makes what every block of 2^3 voxels gives to the 4^3 voxels it reaches, and the
  overlaps are added.
  """
  sizes = x.shape[1:4]
  x = jnp.pad(x, ((0, 0), *((0, s % 2) for s in sizes), (0, 0)))
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
    a = activated(x, gain, offset, activation).astype(jnp.float32)
    given = (a.reshape(-1, block * cin) @ matrix).reshape(*x.shape[:3], sz // block, 3, 3, -1)
    return None, add([given[..., j, :] for j in range(3)], 2)

  _, given = _scan(slab, _split(x, slabs))
  given = given.reshape(b, sx, sy, sz // block, 3, block + 2, cout)
  given = add([given[..., i, :, :] for i in range(3)], 1)
  y, end = given[..., 1:-1, :], block - 1
  y += _pad(_pad(given[:, :, :, 1:, :1], 3, (0, 1)), 4, (end, 0))  # the next block's first
  y += _pad(_pad(given[:, :, :, :-1, -1:], 3, (1, 0)), 4, (0, end))  # the last one's last
  y = y.reshape(b, sx, sy, sz, cout).astype(dtype)
  return y, _sums(y)


def conv_gradient(
  x: jax.Array,
  gain: jax.Array,
  offset: jax.Array,
  kernel: jax.Array,
  activation: Activation,
  y: jax.Array,
  dy: jax.Array,
  dsums: jax.Array,
) -> tuple[jax.Array, ...]:
  """Gradients of x, gain, offset and kernel from the cotangents of y and sums.

  The copies hold the cotangents of the 3 x 3 rows that a block gives to.
  """
  sx, sy, sz = x.shape[1:4]
  slabs, block = _slabs(x.shape, _CONV_ROWS), math.gcd(sz, _BLOCK)
  total = _total(y, dy, dsums, x.dtype)
  for axis in (1, 2, 3):
    y = _add_overlaps(y, axis, axis + 3)
  return _interleave(y)[:, : sizes[0], : sizes[1], : sizes[2]]


def deconv_matrix(kernel: jax.Array) -> jax.Array:
  """[8 * in, 8 * out]: from an input and the seven before it to the eight voxels of its block."""
  return _matrix(_DECONV_TAPS, kernel)


def conv_matrix(kernel: jax.Array) -> jax.Array:
  """[8 * in, 64 * out]: from a block's eight voxels to the 4^3 they reach."""
  return _matrix(_CONV_TAPS, kernel)


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
  """Gradients of x, gain, offset and weights.

  `gather` makes a list of copies [n, S, ...] of a slab of the arrays [N, n, ...]; all copies of a
  voxel or block, times the weights, are the gradient of its activations.
  """
  x, gain, offset = inputs

  def slab(sums, arrays):
    x, *rest = arrays
    a, pull = jax.vjp(lambda *v: activated(*v, activation), x, gain, offset)
    copies = jnp.concatenate(gather(*rest), -1).reshape(-1, len(weights))
    dx, *coefficients = pull((copies @ weights).reshape(a.shape).astype(a.dtype))
    dweights = copies.T @ a.astype(jnp.float32).reshape(len(copies), -1)
    return jax.tree.map(jnp.add, sums, (*coefficients, dweights)), dx

  zeros = jnp.zeros_like(gain), jnp.zeros_like(offset), jnp.zeros_like(weights)
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


def _sums(y):
  """[2, C]: of y and of its square, over all axes but the last."""
  wide, axes = y.astype(jnp.float32), tuple(range(y.ndim - 1))
  return jnp.stack([jnp.sum(wide, axes), jnp.sum(wide * wide, axes)])


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
