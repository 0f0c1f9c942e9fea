"""Sampling an image at flow coordinates.

Images are [B, H, W, C]; flow [B, ..., 2] holds (u, v) in [0, 1], u right, v down, with the centre
of pixel (row, column) at ((column + 0.5) / W, (row + 0.5) / H), as in cvn.camera. Coordinates
outside the image take the colour of its border.
"""

import jax
import jax.numpy as jnp

# The authors' rule for views without alpha: as close as this, in every channel, to the top-left
# pixel's red value is background.
_BACKGROUND_TOLERANCE = 1e-3


def bilinear(image: jax.Array, flow: jax.Array) -> jax.Array:
  """Bilinear samples (section 3.3), differentiable in image and flow.

  At a pixel's exact centre the gradient is that of the cell to its right and below.

  Args:
    image: [B, H, W, C].
    flow: [B, ..., 2].

  Returns:
    [B, ..., C].
  """
  _check(image, flow)
  (c0, c1), wc = _cell(flow[..., 0], image.shape[2])
  (r0, r1), wr = _cell(flow[..., 1], image.shape[1])
  wc, wr = wc[..., None], wr[..., None]
  top = _gather(image, r0, c0) * (1 - wc) + _gather(image, r0, c1) * wc
  bottom = _gather(image, r1, c0) * (1 - wc) + _gather(image, r1, c1) * wc
  return top * (1 - wr) + bottom * wr


def nearest(image: jax.Array, flow: jax.Array) -> jax.Array:
  """The pixel that holds the coordinate, floor(flow * size): no gradient reaches the flow.

  >>> image = jnp.array([[[[0.25], [0.75]]]])  # one row of two pixels
  >>> nearest(image, jnp.array([[0.6, 0.5]]))
  Array([[0.75]], dtype=float32)

  Args:
    image: [B, H, W, C].
    flow: [B, ..., 2].

  Returns:
    [B, ..., C].
  """
  _check(image, flow)
  return _gather(image, *_pixel(flow, image.shape))


def nearest_foreground(image: jax.Array, flow: jax.Array, foreground: jax.Array) -> jax.Array:
  """The colour of the foreground pixel closest to the pixel that holds the coordinate.

  Test-time sampling (section 3.5, colour sampling). Distances are Euclidean, between pixels; among
  equally close ones the topmost counts, then the leftmost. An image without any foreground is
  sampled as by `nearest`.

  Args:
    image: [B, H, W, C].
    flow: [B, ..., 2].
    foreground: [B, H, W] bool.

  Returns:
    [B, ..., C].
  """
  _check(image, flow)
  return nearest(fill(image, foreground), flow)


def bilinear_foreground(image: jax.Array, flow: jax.Array) -> jax.Array:
  """Bilinear samples of the image with its background filled: training as at test time.

  Blend weights are then trained on the sampled colours that are blended at test time. With
  `bilinear` they are trained on the background wherever a flow misses the object.

  Args:
    image: [B, H, W, 3] on a plain background, see `foreground_from_color`.
    flow: [B, ..., 2].

  Returns:
    [B, ..., 3].
  """
  _check(image, flow)
  return bilinear(fill(image, foreground_from_color(image)), flow)


def fill(image: jax.Array, foreground: jax.Array) -> jax.Array:
  """Every background pixel takes the colour of the foreground pixel that is closest to it.

  Args:
    image: [B, H, W, C].
    foreground: [B, H, W] bool.

  Raises:
    ValueError: the shapes do not fit.
  """
  if foreground.shape != image.shape[:3]:
    raise ValueError(f'foreground {foreground.shape} does not fit images {image.shape}')
  return _gather(image, *jax.vmap(_nearest_true)(foreground))


def foreground_from_color(image: jax.Array) -> jax.Array:
  """Pixels [B, H, W] that differ from the background, for images [B, H, W, 3] without alpha.

  The authors' rule: a pixel is background when all its channels are within 1e-3 of the red value of
  the image's top-left pixel.
  """
  corner = image[:, :1, :1, :1]
  return jnp.any(jnp.abs(image - corner) >= _BACKGROUND_TOLERANCE, axis=-1)


def _cell(coordinate, size):
  """The two pixels around a coordinate along one axis, and the second one's weight."""
  x = coordinate * size - 0.5
  # floor and floor + 1, not floor and ceil: those meet at pixel centres, where the slope would
  # vanish. Past the border both are the border pixel.
  low = jnp.floor(x)
  weight = x - low
  low = low.astype(jnp.int32)
  return (jnp.clip(low, 0, size - 1), jnp.clip(low + 1, 0, size - 1)), weight


def _pixel(flow, shape):
  def index(coordinate, size):
    return jnp.clip(jnp.floor(coordinate * size).astype(jnp.int32), 0, size - 1)

  return index(flow[..., 1], shape[1]), index(flow[..., 0], shape[2])


def _gather(image, row, column):
  return jax.vmap(lambda im, r, c: im[r, c])(image, row, column)


def _nearest_true(mask):
  """Row and column [H, W] of the true pixel nearest to every pixel; its own where none is true.

  Exact and separable: the nearest in every row first, then the best of the rows.
  """
  h, w = mask.shape
  rows, columns = jnp.arange(h), jnp.arange(w)
  here = jnp.where(mask, columns[None, :], -w)
  left = jax.lax.cummax(here, axis=1)
  here = jnp.where(mask, columns[None, :], 2 * w)
  right = jax.lax.cummin(here, axis=1, reverse=True)
  to_left, to_right = columns[None, :] - left, right - columns[None, :]
  column = jnp.where(to_left <= to_right, left, right)
  # A row without a true pixel is farther than any pixel of the image.
  gap = jnp.where(jnp.any(mask, axis=1)[:, None], jnp.minimum(to_left, to_right), h + w)
  # One number for (squared distance, row): a plain minimum then breaks ties towards the top.
  key = gap[None] ** 2 + ((rows[:, None] - rows[None, :]) ** 2)[:, :, None]
  row = jnp.min(key * h + rows[None, :, None], axis=1) % h
  column = jnp.take_along_axis(column, row, axis=0)
  found = jnp.any(mask)
  return (
    jnp.where(found, row, jnp.broadcast_to(rows[:, None], (h, w))),
    jnp.where(found, column, jnp.broadcast_to(columns[None, :], (h, w))),
  )


def _check(image, flow):
  if image.ndim != 4 or flow.ndim < 2 or flow.shape[-1] != 2 or flow.shape[0] != image.shape[0]:
    raise ValueError(
      f'images [B, H, W, C] and flow [B, ..., 2] are needed: {image.shape}, {flow.shape}'
    )
