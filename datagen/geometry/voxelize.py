"""Colour voxelisation: the voxels that a surface occupies, and the colour of the surface in each.

After Huang, Yagel, Filippov and Kurzion, "An Accurate Method for Voxelizing Polygon Meshes" (1998),
with lengths in voxels (L = 1). A voxel is occupied if, for some face, its centre lies
  * within R_c of the face, its edges and its vertices, and
  * within t of its plane.
The constants are theirs for 6-separation, the thinnest shell: R_c = 1/2 and t = cos(b) / 2, where b
is the angle between the face's normal and the nearest axis. No path of steps between face-adjacent
voxels crosses a closed surface without meeting an occupied voxel: where a step along an axis
crosses a face, one of its ends is within 1/2 of the crossing, and so within t of the plane. (Paths
through edges and corners of voxels may cross; stopping them takes R_c = sqrt(3)/2, a shell 1.7
times as thick.) In the paper, edges count without the second condition. With it, a flat sheet is
one layer however finely its faces are cut: one voxel in each row along the axis nearest to its
normal. So every occupied centre is within 1/2 voxel of the surface, every occupied voxel touches
the surface, and every centre within 1 / (2 sqrt 3) = 0.289 voxels of it is occupied.

One rule is added so that rods thinner than a voxel, which may pass between all centres, do not
vanish: in each slice of voxels that an edge crosses, the voxel nearest to the edge is occupied if
none of the up to four voxels around the edge is. These centres are within sqrt(2)/2 voxels of the
surface.

Ties, such as a face on the border of two voxels, are broken by shrinking the surface by 1e-6 of its
size and shifting it by less than that. Such a face is then one voxel thick, not two, and the ends
of the longest side stay within the margin.

Holes in textures are not surface; glass is (see datagen/geometry/mesh.py).
"""

import itertools
from typing import NamedTuple

import numpy as np

from cvn.errors import UserError
from cvn.grid import GRID_SIZE, PADDING_INDEX, world_to_grid
from datagen.geometry import dominant
from datagen.geometry.mesh import TexturedMesh, albedo, is_surface

SAMPLES_PER_SIDE = 4  # colour is read at least so often along a voxel's side
CHUNK = 1 << 18  # candidates, or samples, handled at a time; bounds the memory
UNSEEN = 1e-6  # weight of surface that no view shows: it counts where nothing else is
SLIVER = 1e-3  # voxels; a face that is less high is no more than its edges
EPSILON = 1e-9  # rounding, in voxels


class SurfaceVoxels(NamedTuple):
  """The S occupied voxels of a mesh, sorted, the last axis fastest."""

  index: np.ndarray  # [S, 3] uint8
  color: np.ndarray  # [S, 3] uint8 sRGB
  point: np.ndarray  # [S, 3] float64, world: the surface's point that is nearest to the centre


class _Claims(NamedTuple):
  """The nearest surface point to the centre of each occupied voxel."""

  distance: np.ndarray  # [size^3] float64; infinite in voxels that nothing occupies
  face: np.ndarray  # [size^3] int64
  barycentric: np.ndarray  # [size^3, 3] float64


def voxelize(
  mesh: TexturedMesh, size: int = GRID_SIZE, seen: np.ndarray | None = None
) -> SurfaceVoxels:
  """The surface shell of a mesh and its albedo.

  The colour of a voxel is the dominant colour (see dominant.py) of the surface inside it, or the
  albedo at the surface point nearest to its centre if that surface is too small to be sampled.
  Faces that no view shows, such as linings and interiors, count only in voxels without visible
  faces.

  Args:
    mesh: in the cube [-0.5, 0.5]^3; parts outside are cut off.
    size: voxels along a side of the grid, at most 255.
    seen: [F] bool, the faces that some view shows; None for all.

  Returns:
    The voxels.

  Raises:
    ValueError: a size that bytes cannot index.
    UserError: the mesh has no surface inside the cube.
  """
  if not 1 <= size <= PADDING_INDEX:
    raise ValueError(f'size must be in [1, {PADDING_INDEX}], got {size}')
  shift = np.array([1.0, 0.6, 0.35]) * 1e-6
  # Centres of voxels are at whole numbers here.
  points = world_to_grid(mesh.vertices * (1 - 1e-6), size=size) - 0.5 + shift
  corners = points[mesh.faces]
  claims = _Claims(np.full(size**3, np.inf), np.zeros(size**3, np.int64), np.zeros((size**3, 3)))
  _claim_near_faces(claims, mesh, corners, size)
  _claim_thin_rods(claims, mesh, corners, size)
  voxel = np.flatnonzero(np.isfinite(claims.distance))
  if not len(voxel):
    raise UserError('the mesh has no visible surface inside the cube')

  sampled, dominant_color = dominant.dominant_colors(_tally(mesh, corners, size, claims, seen))
  bare = np.isin(voxel, sampled, invert=True)
  at = voxel[bare]
  color = np.empty((len(voxel), 3))
  color[~bare] = dominant_color
  color[bare] = albedo(mesh, claims.face[at], claims.barycentric[at])[:, :3]
  index = np.stack(np.unravel_index(voxel, (size,) * 3), -1)
  triangle = mesh.vertices[mesh.faces[claims.face[voxel]]]
  return SurfaceVoxels(
    index.astype(np.uint8),
    np.rint(255 * np.clip(color, 0, 1)).astype(np.uint8),
    np.einsum('nk,nkc->nc', claims.barycentric[voxel], triangle),
  )


def _claim_near_faces(claims, mesh, corners, size):
  """The paper's tests for faces, edges and vertices, in one pass over all faces."""
  a = corners[:, 0]
  ab, ac = corners[:, 1] - a, corners[:, 2] - a
  normal = np.cross(ab, ac)
  area = np.sqrt(_dot(normal, normal))  # of the parallelogram
  normal /= np.maximum(area, 1e-300)[:, None]
  longest = np.sqrt(np.maximum.reduce([_dot(ab, ab), _dot(ac, ac), _dot(ac - ab, ac - ab)]))
  has_inside = area > SLIVER * longest
  # Columns of voxels run along w, the normal's nearest axis; u and v are the other two.
  w = np.abs(normal).argmax(-1)
  uv = np.stack([(w + 1) % 3, (w + 2) % 3], -1)
  limit = 0.5 * np.abs(normal).max(-1)
  slope = _take(normal, uv) / np.where(area > 0, _take(normal, w), 1)[:, None]
  low, high = corners.min(1), corners.max(1)
  first = np.maximum(np.ceil(_take(low, uv) - 0.5), 0).astype(np.int64)
  last = np.minimum(np.floor(_take(high, uv) + 0.5), size - 1).astype(np.int64)
  count = np.maximum(last - first + 1, 0) * (area > 0)[:, None]
  for f, k in _ragged(count[:, 0] * count[:, 1], CHUNK // 3):
    column = first[f] + np.stack(np.divmod(k, count[f, 1]), -1)
    height = _take(a[f], w[f]) - _dot(slope[f], column - _take(a[f], uv[f]))
    height = np.rint(np.clip(height, _take(low[f], w[f]), _take(high[f], w[f])))
    # Distance 1/2 from the face is at most sqrt(3)/2 along w: within one voxel of the rounded one.
    voxel = np.empty((len(f), 3, 3), np.int64)
    np.put_along_axis(voxel, uv[f][:, None], column[:, None], -1)
    along = height.astype(np.int64)[:, None] + np.array([[-1, 0, 1]])
    np.put_along_axis(voxel, w[f][:, None, None], along[..., None], -1)
    voxel, f = voxel.reshape(-1, 3), np.repeat(f, 3)
    q = voxel - a[f]
    distance, barycentric = _nearest(q, ab[f], ac[f], normal[f], has_inside[f])
    ok = distance <= 0.5 + EPSILON
    ok &= (np.abs(_dot(q, normal[f])) <= limit[f] + EPSILON) | ~has_inside[f]
    _claim(claims, mesh, size, voxel[ok], distance[ok], f[ok], barycentric[ok])


def _nearest(q, ab, ac, normal, has_inside):
  """The points of triangles (0, ab, ac) that are nearest to points q, all [N, 3].

  Returns:
    (distance [N], barycentric [N, 3]).
  """
  d00, d01, d11 = _dot(ab, ab), _dot(ab, ac), _dot(ac, ac)
  d20, d21, qq = _dot(q, ab), _dot(q, ac), _dot(q, q)
  scale = 1 / np.maximum(d00 * d11 - d01 * d01, 1e-300)
  v, w = (d11 * d20 - d01 * d21) * scale, (d00 * d21 - d01 * d20) * scale
  inside = has_inside & (v >= 0) & (w >= 0) & (v + w <= 1)
  # Along the edges, from corner 0 to 1, 0 to 2 and 1 to 2: where, and the squared distance there.
  dbc, pbc = d00 - 2 * d01 + d11, d21 - d20 + d00 - d01
  t = [np.clip(p / np.maximum(d, 1e-300), 0, 1) for p, d in ((d20, d00), (d21, d11), (pbc, dbc))]
  squared = np.stack(
    [
      qq - t[0] * (2 * d20 - t[0] * d00),
      qq - t[1] * (2 * d21 - t[1] * d11),
      qq - 2 * d20 + d00 - t[2] * (2 * pbc - t[2] * dbc),
    ]
  )
  edge = squared.argmin(0)
  distance = np.where(inside, np.abs(_dot(q, normal)), np.sqrt(np.maximum(squared.min(0), 0)))
  v = np.where(inside, v, np.choose(edge, [t[0], 0 * t[0], 1 - t[2]]))
  w = np.where(inside, w, np.choose(edge, [0 * t[1], t[1], t[2]]))
  return distance, np.stack([1 - v - w, v, w], -1)


def _claim_thin_rods(claims, mesh, corners, size):
  """Occupies, along every edge, a voxel in each slice without an occupied voxel around the edge."""
  for i in range(3):
    start, step = corners[:, i], corners[:, (i + 1) % 3] - corners[:, i]
    axis = np.abs(step).argmax(-1)
    ends = np.stack([_take(start, axis), _take(start + step, axis)])
    first = np.maximum(np.ceil(ends.min(0)), 0).astype(np.int64)
    last = np.minimum(np.floor(ends.max(0)), size - 1).astype(np.int64)
    for f, k in _ragged(np.maximum(last - first + 1, 0), CHUNK):
      along = _take(step[f], axis[f])
      t = (first[f] + k - ends[0, f]) / np.where(along == 0, 1, along)
      point = start[f] + t[:, None] * step[f]
      np.put_along_axis(point, axis[f][:, None], (first[f] + k)[:, None].astype(float), -1)
      lower, upper = np.floor(point), np.ceil(point)
      taken = np.zeros(len(f), bool)
      for corner in itertools.product([False, True], repeat=3):
        around = np.where(corner, upper, lower).astype(np.int64)
        inside = _in_grid(around, size)
        taken[inside] |= np.isfinite(claims.distance[_flat(around[inside], size)])
      f, t, point = f[~taken], t[~taken], point[~taken]
      voxel = np.rint(point).astype(np.int64)
      barycentric = np.zeros((len(f), 3))
      barycentric[:, i], barycentric[:, (i + 1) % 3] = 1 - t, t
      _claim(claims, mesh, size, voxel, np.linalg.norm(point - voxel, axis=-1), f, barycentric)


def _claim(claims, mesh, size, voxel, distance, face, barycentric):
  """Occupies voxels in place; each keeps the nearest point so far."""
  ok = _in_grid(voxel, size)
  ok[ok] = is_surface(mesh, face[ok], barycentric[ok])
  at, distance, face, barycentric = _flat(voxel[ok], size), distance[ok], face[ok], barycentric[ok]
  order = np.lexsort((distance, at))
  order = order[np.diff(at[order], prepend=-1) != 0]
  order = order[distance[order] < claims.distance[at[order]]]
  claims.distance[at[order]] = distance[order]
  claims.face[at[order]] = face[order]
  claims.barycentric[at[order]] = barycentric[order]


def _tally(mesh, corners, size, claims, seen):
  """Counts albedo and area at random points of the faces, by occupied voxel.

  A face is cut into rows between its longest edge and the opposite corner, and rows into cells,
  with one random point in each (the generator's seed is fixed). A regular grid of points would
  alias with fine patterns.
  """
  edges = np.linalg.norm(np.roll(corners, -1, 1) - corners, axis=-1)  # from corner i to i + 1
  base = edges.argmax(-1)
  length = _take(edges, base)
  area = 0.5 * np.linalg.norm(
    np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=-1
  )
  height = 2 * area / np.maximum(length, 1e-300)
  most = 2 * SAMPLES_PER_SIDE * size  # longer than the cube's diagonal
  columns, rows = (
    np.clip(np.ceil(SAMPLES_PER_SIDE * side), 1, most).astype(np.int64) for side in (length, height)
  )
  order = (base[:, None] + np.array([[2, 0, 1]])) % 3  # the corner opposite the base comes first
  rng = np.random.default_rng(0)
  occupied, tally = np.isfinite(claims.distance), dominant.EMPTY
  for f, k in _ragged(columns * rows, CHUNK):
    row, column = np.divmod(k, columns[f])
    jitter = rng.random((2, len(f)))
    s, t = (row + jitter[0]) / rows[f], (column + jitter[1]) / columns[f]
    weights = np.empty((len(f), 3))
    np.put_along_axis(weights, order[f], np.stack([1 - s, s * (1 - t), s * t], -1), -1)
    point = np.einsum('nk,nkc->nc', weights, corners[f])
    voxel = np.rint(point).astype(np.int64)
    ok = _in_grid(voxel, size)
    at = _flat(voxel[ok], size)
    ok[ok] = occupied[at]
    f, s, weights, at = f[ok], s[ok], weights[ok], at[occupied[at]]
    share = 2 * s * area[f] / (rows[f] * columns[f])  # a row's cells are as wide as the row
    present = is_surface(mesh, f, weights) & (share > 0)
    if seen is not None:
      share[~seen[f]] *= UNSEEN
    color = albedo(mesh, f[present], weights[present])[:, :3]
    tally = dominant.add(tally, at[present], share[present], color)
  return tally


def _ragged(count, chunk):
  """All pairs (i, k) with k < count[i], in order, about `chunk` pairs at a time."""
  cuts = np.searchsorted(np.cumsum(count), np.arange(0, count.sum() + chunk, chunk))
  for begin, end in itertools.pairwise(np.unique(np.append(cuts, [0, len(count)]))):
    n = count[begin:end]
    i = np.repeat(np.arange(begin, end), n)
    if len(i):
      yield i, np.arange(len(i)) - np.repeat(np.cumsum(n) - n, n)


def _take(array, axes):
  """Picks entries of [N, 3] along the last axis: axes [N] -> [N], [N, M] -> [N, M]."""
  if axes.ndim == 1:
    return np.take_along_axis(array, axes[:, None], -1)[:, 0]
  return np.take_along_axis(array, axes, -1)


def _dot(a, b):
  return np.einsum('nk,nk->n', a, b)


def _in_grid(voxel, size):
  x, y, z = voxel.astype(np.uint64).T  # below 0 becomes huge
  return (x < size) & (y < size) & (z < size)


def _flat(voxel, size):
  return (voxel[:, 0] * size + voxel[:, 1]) * size + voxel[:, 2]
