"""Target appearance flows: where each view shows the colour of each surface voxel (section 3.3).

A voxel is represented by the surface point nearest to its centre. It is visible in a view if the
point lies within `tolerance` voxels, along the viewing axis, of the surface that the view shows in
the pixel of the point's projection; its flow is that projection. The pixel may show another colour
than the voxel's, which is the dominant colour of its surface. Then the flow is the centre of the
closest of the 3 x 3 pixels around, about the size of a voxel, that shows a similar colour and a
surface within the tolerance. If there is none, the projection stays.

A hidden voxel takes the foreground pixel of similar colour that is closest to its projection. If
the view has no similar pixel, it takes the most similar one, and among equals the closest.

Colours are similar if their Euclidean RGB distance in [0, 1] is at most `similarity`. A flow is
right if both nearest and bilinear sampling fetch a similar colour, whatever background is mixed in
at an outline.
"""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from cvn.camera import Camera, project
from cvn.grid import GRID_SIZE

# Voxels. Half a pixel's step on a surface 60 degrees aslant; a plate thicker than that keeps its
# two faces apart.
TOLERANCE = 1.0
SIMILARITY = 0.1
FIDELITY = 0.1  # of the statistics: a sampled colour this close to the voxel's is the right one

_AROUND = np.array(list(itertools.product((-1, 0, 1), repeat=2)))  # the 3 x 3 pixels
_NEIGHBOURS = 4  # pixels tried first for an occluded voxel, enough for most
_CHUNK = 128  # voxels compared with many pixels at once
_TOO_FAR = np.float32(1e9)  # squared pixels, more than any image has


class FlowStats(NamedTuple):
  """How well the flows fetch the voxels' colours, over all views of one model."""

  visible: float  # share of (view, voxel) pairs that are visible
  matched: float  # share that are occluded and found a pixel of similar colour
  fallback: float  # share that are occluded and found none
  visible_error: float  # mean `sampling_error` of visible voxels
  visible_faithful: float  # share of visible voxels for which it is below FIDELITY
  error: float  # mean over all pairs


class TargetFlows(NamedTuple):
  """Flows of S voxels in V views."""

  flow: np.ndarray  # [V, S, 2] float32, (u, v) in [0, 1]
  visible: np.ndarray  # [V, S] bool
  stats: FlowStats


def target_flows(
  point: np.ndarray,
  color: np.ndarray,
  rgba: np.ndarray,
  depth: np.ndarray,
  cameras: Sequence[Camera],
  *,
  grid_size: int = GRID_SIZE,
  tolerance: float = TOLERANCE,
  similarity: float = SIMILARITY,
) -> TargetFlows:
  """Finds the target flow of every surface voxel in every view.

  Args:
    point: [S, 3] the surface points that represent the voxels, world coordinates.
    color: [S, 3] u8 the voxels' colours.
    rgba: [V, H, W, 4] u8 the views.
    depth: [V, H, W] along the viewing axis, world units; inf where alpha is 0.
    cameras: one for each view.
    grid_size: voxels along one side of the grid.
    tolerance: in voxels.
    similarity: RGB distance.

  Returns:
    The flows.

  Raises:
    ValueError: shapes do not agree, or a view is empty.
  """
  if not rgba.shape[:3] == depth.shape == (len(cameras), *depth.shape[1:]):
    raise ValueError(f'views {rgba.shape}, depth {depth.shape}, {len(cameras)} cameras')
  if not point.shape == color.shape == (len(point), 3):
    raise ValueError(f'points {point.shape}, colours {color.shape}')
  size = np.array(depth.shape[:0:-1])
  color = color.astype(np.float64)
  flow = np.empty((len(cameras), len(point), 2), np.float32)
  visible = np.empty((len(cameras), len(point)), bool)
  error = np.empty((len(cameras), len(point)))
  fallbacks = 0
  for v, camera in enumerate(cameras):
    if not np.isfinite(depth[v]).any():
      raise ValueError(f'view {v} is empty')
    pixel, distance = project(point, camera)
    near = _shows(depth[v], np.floor(pixel).astype(int), distance, tolerance / grid_size)
    pixel[near] = _corrected(
      pixel[near], distance[near], color[near], rgba[v], depth[v], tolerance / grid_size, similarity
    )
    row, column = np.nonzero(np.isfinite(depth[v]))
    centers = np.stack([column, row], -1) + 0.5
    seen = rgba[v, row, column, :3].astype(np.float64)
    chosen, fell_back = _closest_similar(
      pixel[~near], color[~near], centers, seen, similarity * 255
    )
    pixel[~near] = centers[chosen]
    fallbacks += fell_back.sum()
    flow[v], visible[v] = pixel / size, near
    error[v] = sampling_error(rgba[v], pixel, color)
  seen_error = error[visible] if visible.any() else np.zeros(1)
  fallback, share = fallbacks / visible.size, visible.mean()
  stats = FlowStats(
    visible=float(share),
    matched=float(1 - share - fallback),
    fallback=float(fallback),
    visible_error=float(seen_error.mean()),
    visible_faithful=float((seen_error < FIDELITY).mean()),
    error=float(error.mean()),
  )
  return TargetFlows(flow, visible, stats)


def sampling_error(rgba: np.ndarray, pixel: np.ndarray, color: np.ndarray) -> np.ndarray:
  """The error of the colours that sampling a view fetches, in the worst case.

  It is the larger of two distances: of the nearest pixel's colour, and of the bilinear sample (see
  cvn/sampler.py) over the background that is farthest from the right colour.

  Args:
    rgba: [H, W, 4] u8 the view.
    pixel: [S, 2] sampling positions, continuous pixel coordinates.
    color: [S, 3] the right colours, 0 to 255.

  Returns:
    [S] Euclidean RGB distances in [0, 1].
  """
  last = np.array(rgba.shape[1::-1]) - 1
  background = np.where(color < 127.5, 255.0, 0.0)

  def distance(column, row):
    texel = rgba[row, column]
    return np.where(texel[:, 3:] > 0, texel[:, :3], background) - color

  low = np.floor(pixel - 0.5)
  weight = pixel - 0.5 - low
  bilinear = 0
  for step in itertools.product((0, 1), repeat=2):
    share = np.abs(1 - np.array(step) - weight).prod(-1, keepdims=True)
    bilinear = bilinear + share * distance(*np.clip(low.astype(int) + step, 0, last).T)
  nearest = distance(*np.clip(np.floor(pixel).astype(int), 0, last).T)
  return np.sqrt(np.maximum(_squared(bilinear), _squared(nearest))) / 255


def _shows(depth, at, distance, tolerance):
  """Whether pixels of a view show a surface at given depths.

  Args:
    depth: [H, W], inf where empty.
    at: [..., 2] pixels (column, row), inside the image or not.
    distance: [...] depths.
    tolerance: world units.

  Returns:
    [...] bool.
  """
  inside = ((at >= 0) & (at < depth.shape[::-1])).all(-1)
  column, row = np.moveaxis(np.where(inside[..., None], at, 0), -1, 0)
  return inside & (np.abs(depth[row, column] - distance) <= tolerance)


def _corrected(pixel, distance, color, rgba, depth, tolerance, similarity):
  """Moves flows of visible voxels that show a wrong colour to the right pixels, in one view.

  Args:
    pixel: [N, 2] projections.
    distance: [N] depths.
    color: [N, 3] voxels' colours, 0 to 255.
    rgba: [H, W, 4] u8 the view.
    depth: [H, W] its depth.
    tolerance: world units.
    similarity: RGB distance.

  Returns:
    [N, 2].
  """
  wrong = np.flatnonzero(sampling_error(rgba, pixel, color) > similarity)
  around = np.floor(pixel[wrong, None]).astype(int) + _AROUND
  column, row = np.moveaxis(np.clip(around, 0, np.array(depth.shape[::-1]) - 1), -1, 0)
  difference = rgba[row, column, :3] - color[wrong, None]
  good = _squared(difference) <= (255 * similarity) ** 2
  good &= _shows(depth, around, distance[wrong, None], tolerance)
  far = np.where(good, _squared(around + 0.5 - pixel[wrong, None]), np.inf)
  best = far.argmin(1)
  found = np.isfinite(far[np.arange(len(wrong)), best])
  moved = pixel.copy()
  moved[wrong[found]] = around[found, best[found]] + 0.5
  return moved


def _closest_similar(pixel, color, centers, seen, similarity):
  """The rule for hidden voxels, in one view.

  Args:
    pixel: [N, 2] projections.
    color: [N, 3] voxels' colours, 0 to 255.
    centers: [P, 2] centres of the foreground pixels.
    seen: [P, 3] their colours.
    similarity: maximum distance of similar colours, 0 to 255.

  Returns:
    chosen: [N] index of the pixel. fallback: [N] bool, True if no pixel is similar.
  """
  neighbours = np.arange(1, min(_NEIGHBOURS, len(centers)) + 1)
  _, near = cKDTree(centers).query(pixel, k=neighbours)
  similar = _squared(seen[near] - color[:, None]) <= similarity**2
  chosen = near[np.arange(len(pixel)), similar.argmax(1)]
  rest = np.flatnonzero(~similar.any(1))
  limit = np.full(len(rest), similarity**2)
  chosen[rest] = _closest_within(pixel[rest], color[rest], centers, seen, limit)
  fallback = chosen < 0
  if fallback.any():
    pixel, color = pixel[fallback], color[fallback]
    least, _ = cKDTree(np.unique(seen, axis=0)).query(color)
    limit = np.rint(np.square(least))  # colours are whole numbers
    chosen[fallback] = _closest_within(pixel, color, centers, seen, limit)
  return chosen, fallback


def _closest_within(pixel, color, centers, seen, limit):
  """The closest pixel [N] whose squared colour distance is at most `limit` [N]; -1 for none.

  Voxels of similar colours are processed together, and compared only with pixels of a colour near
  theirs.
  """
  chosen, limit = np.full(len(pixel), -1), np.floor(limit)  # squared distances are whole numbers
  order = _by_color(color)
  for at in np.split(order, range(_CHUNK, len(order), _CHUNK)) if len(order) else ():
    middle = (color[at].min(0) + color[at].max(0)) / 2
    reach = np.sqrt(_squared(color[at] - middle).max()) + np.sqrt(limit[at].max())
    near = np.flatnonzero(_squared(seen - middle) <= reach**2 + 1)
    if len(near):
      # float32 holds such distances of colours exactly, and of positions only the order counts.
      excess = _squared_distances(color[at], seen[near], less=limit[at])
      cost = _squared_distances(pixel[at] - pixel[at[0]], centers[near] - pixel[at[0]])
      cost += np.multiply(np.maximum(excess, 0, out=excess), _TOO_FAR, out=excess)
      best = cost.argmin(1)
      chosen[at] = np.where(cost[np.arange(len(at)), best] < _TOO_FAR, near[best], -1)
  return chosen


def _by_color(color):
  """An order [N] of colours [N, 3], 0 to 255, in which neighbours are similar (Morton order)."""
  bits = np.unpackbits(color.astype(np.uint8)[..., None], axis=-1)  # [N, 3, 8]
  code = np.packbits(bits.transpose(0, 2, 1).reshape(len(color), 24), axis=-1)
  return np.lexsort(code.T[::-1])


def _squared(x):
  """[..., C] -> [...]."""
  return np.einsum('...c,...c->...', x, x)


def _squared_distances(a, b, less=0):
  """Squared distances of a [N, D] to b [P, D], minus a number or [N]: [N, P] float32."""
  a, b = a.astype(np.float32), b.astype(np.float32)
  square_a, square_b = (_squared(a) - less)[:, None], _squared(b)[:, None]
  left = np.concatenate([a, square_a, np.ones_like(square_a)], 1, dtype=np.float32)
  right = np.concatenate([-2 * b, np.ones_like(square_b), square_b], 1)
  return left @ right.T
