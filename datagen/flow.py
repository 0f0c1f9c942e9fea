"""Target appearance flows: where each view shows the colour of each surface voxel (section 3.3).

A voxel is visible in a view when its centre lies within `tolerance` voxels, along the viewing axis,
of the surface that the view shows where the centre projects; its flow is that projection. The shell
of voxels sticks out a little over the outline of the surface in it: a centre that projects past the
outline, or past an edge in front of something far behind, is visible when one of the eight
neighbouring pixels shows a surface within the tolerance, and its flow is the nearest such pixel's
centre. What something else hides is never visible.

An occluded voxel takes, among the foreground pixels of similar colour, the one closest to its
projection; similar means within `similarity`, as Euclidean distance of RGB in [0, 1]. When the view
has no similar pixel, it takes the most similar one, and of several the closest.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from cvn.camera import Camera, project
from cvn.grid import GRID_SIZE, index_to_world

# Voxels. A centre is within 0.87 of some surface point of its voxel; a plate two voxels thick or
# more keeps its two faces apart.
TOLERANCE = 1.0
SIMILARITY = 0.1
FIDELITY = 0.1  # of the statistics: a sampled colour this close to the voxel's is the right one

_NEIGHBOURS = 32  # pixels tried first for an occluded voxel
_CHUNK = 256  # voxels compared with all pixels at once


class FlowStats(NamedTuple):
  """How well the flows show the voxels' colours, over all views of one model."""

  visible: float  # share of (view, voxel) pairs that are visible
  matched: float  # share that are occluded and found a pixel of similar colour
  fallback: float  # share that are occluded and found none
  visible_error: float  # mean RGB distance of visible voxels to the pixel they land on
  visible_faithful: float  # share of visible voxels for which that distance is below FIDELITY
  error: float  # mean RGB distance over all pairs


class TargetFlows(NamedTuple):
  """Flows of S voxels in V views."""

  flow: np.ndarray  # [V, S, 2] float32, (u, v) in [0, 1]
  visible: np.ndarray  # [V, S] bool
  stats: FlowStats


def target_flows(
  index: np.ndarray,
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
    index: [S, 3] the voxels.
    color: [S, 3] u8 their colours.
    rgba: [V, H, W, 4] u8 the views.
    depth: [V, H, W] along the viewing axis, world units; inf where alpha is 0.
    cameras: one a view.
    grid_size: voxels along one side of the grid.
    tolerance: voxels.
    similarity: distance in RGB.

  Returns:
    The flows.

  Raises:
    ValueError: shapes do not agree, or a view shows nothing.
  """
  if not rgba.shape[:3] == depth.shape == (len(cameras), *depth.shape[1:]):
    raise ValueError(f'views {rgba.shape}, depth {depth.shape}, {len(cameras)} cameras')
  if not index.shape == color.shape == (len(index), 3):
    raise ValueError(f'voxels {index.shape}, colours {color.shape}')
  points = index_to_world(index.astype(np.float64), size=grid_size)
  size = np.array(depth.shape[:0:-1])
  flow = np.empty((len(cameras), len(index), 2), np.float32)
  visible = np.empty((len(cameras), len(index)), bool)
  error = np.empty((len(cameras), len(index)))
  fallbacks = 0
  for v, camera in enumerate(cameras):
    foreground = np.isfinite(depth[v])
    if not foreground.any():
      raise ValueError(f'view {v} is empty')
    pixel, distance = project(points, camera)
    pixel, visible[v] = _visible(pixel, distance, depth[v], tolerance / grid_size)
    hidden = ~visible[v]
    row, column = np.nonzero(foreground)
    centers = np.stack([column, row], -1) + 0.5
    seen = rgba[v, row, column, :3]
    chosen, fell_back = _closest_similar(
      pixel[hidden], color[hidden], centers, seen, similarity * 255
    )
    pixel[hidden] = centers[chosen]
    fallbacks += fell_back.sum()
    flow[v] = pixel / size
    column, row = np.minimum(pixel.astype(int), size - 1).T
    sampled = rgba[v, row, column, :3].astype(np.float64)
    error[v] = np.linalg.norm(sampled - color, axis=-1) / 255
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


def _visible(pixel, distance, depth, tolerance):
  """The visibility rule in one view.

  Args:
    pixel: [S, 2] projections of the voxels' centres.
    distance: [S] their depths.
    depth: [H, W], inf where empty.
    tolerance: world units.

  Returns:
    pixel: [S, 2] where the voxels are seen, moved onto the surface where they stick out.
    visible: [S] bool.
  """
  height, width = depth.shape
  column, row = np.floor(pixel).astype(int).T
  # A frame of pixels that hide everything: no voxel out of the image is visible.
  framed = np.pad(depth, 2, constant_values=-np.inf)
  column, row = np.clip(column, -1, width) + 2, np.clip(row, -1, height) + 2
  here = framed[row, column]
  visible = np.abs(here - distance) <= tolerance

  out = np.flatnonzero(here > distance + tolerance)  # past an outline
  best = np.full(len(out), np.inf)
  moved = pixel[out]
  for down in (-1, 0, 1):
    for right in (-1, 0, 1):
      r, c = row[out] + down, column[out] + right
      center = np.stack([c - 2, r - 2], -1) + 0.5
      far = np.square(center - pixel[out]).sum(-1)
      better = (np.abs(framed[r, c] - distance[out]) <= tolerance) & (far < best)
      best[better], moved[better] = far[better], center[better]
  snapped = np.isfinite(best)
  pixel = pixel.copy()
  pixel[out[snapped]] = moved[snapped]
  visible[out[snapped]] = True
  return pixel, visible


def _closest_similar(pixel, color, centers, seen, similarity):
  """The rule for occluded voxels in one view.

  Args:
    pixel: [N, 2] projections.
    color: [N, 3] u8 voxels' colours.
    centers: [P, 2] the foreground pixels' centres.
    seen: [P, 3] u8 their colours.
    similarity: largest distance of similar colours, of 255.

  Returns:
    chosen: [N] index of the pixel taken.
    fallback: [N] bool, no pixel is similar.
  """
  color, seen = color.astype(np.float64), seen.astype(np.float64)
  neighbours = min(_NEIGHBOURS, len(centers))
  _, near = cKDTree(centers).query(pixel, k=np.arange(1, neighbours + 1))
  similar = np.linalg.norm(seen[near] - color[:, None], axis=-1) <= similarity
  chosen = np.take_along_axis(near, similar.argmax(1)[:, None], 1)[:, 0]
  fallback = np.zeros(len(pixel), bool)
  # The others are compared with all pixels, by matrix products: squared distances of 8-bit colours
  # are whole numbers that float32 holds exactly, and of positions only the order counts.
  middle = centers.mean(0)
  place, there = (pixel - middle).astype(np.float32), (centers - middle).astype(np.float32)
  rest = np.flatnonzero(~similar.any(1))
  for at in np.split(rest, range(_CHUNK, len(rest), _CHUNK)):
    difference = _squared_distances(color[at].astype(np.float32), seen.astype(np.float32))
    least = difference.min(1, keepdims=True)
    fallback[at] = least[:, 0] > similarity**2
    candidate = difference <= np.maximum(least, np.float32(similarity**2))
    far = _squared_distances(place[at], there)
    chosen[at] = np.where(candidate, far, np.inf).argmin(1)
  return chosen, fallback


def _squared_distances(a, b):
  """[N, D], [P, D] -> [N, P]."""
  square_a, square_b = (np.square(x).sum(1, keepdims=True) for x in (a, b))
  left = np.concatenate([a, square_a, np.ones_like(square_a)], 1)
  right = np.concatenate([-2 * b, np.ones_like(square_b), square_b], 1)
  return left @ right.T
