"""Faces that coincide: only the visible one is kept.

Many models contain a face twice, once for each side and with different colours, or several times.
Renderers that cull back faces show the right colour. We shade both sides, so rounding would decide
which of the faces a ray meets, and a voxel would average them. Keeping one face makes views and
voxels agree.
"""

import itertools

import mitsuba as mi
import numpy as np

from datagen.geometry.mesh import TexturedMesh
from datagen.geometry.render import to_mitsuba

HIDDEN = 0.25  # a side that fewer rays meet than this share of its other side's is an inside
_SIDES = np.concatenate([np.eye(3), -np.eye(3)])
_CORNERS = np.array(list(itertools.product((-1, 1), repeat=3))) / np.sqrt(3)
DIRECTIONS = np.concatenate([_SIDES, _CORNERS])  # from where rays come
RESOLUTION = 112  # rays along either side of a square that holds the mesh


def without_coincident(mesh: TexturedMesh) -> TexturedMesh:
  """Keeps one of all faces with the same three corners, in either orientation.

  It is the face whose front is seen: rays from all around meet its front, and hardly ever the other
  side's. If both sides are seen, or neither, a face with a texture wins over one without, then the
  face whose appearance is seen more often elsewhere, which keeps sheets in one colour, then the
  first.

  Args:
    mesh: the mesh, normalised.
  """
  place, turn = _places(mesh.vertices, mesh.faces)
  count = np.bincount(place)
  again = np.flatnonzero(count[place] > 1)
  if not len(again):
    return mesh
  side = 2 * place + turn
  met = np.zeros(2 * len(count))
  if (np.bincount(side[again], minlength=len(met)).reshape(-1, 2) > 0).all(1).any():
    front, back = _rays_met(mesh)
    # A ray may be said to meet any of the faces in a place, from before it or from behind.
    met = np.bincount(side, front, len(met)) + np.bincount(side ^ 1, back, len(met))
  met, opposite = met[side[again]], met[side[again] ^ 1]
  looks = _looks(mesh, again)
  share = np.bincount(looks, met) / np.maximum(np.bincount(looks, met + opposite), 1)
  order = np.lexsort(
    (-share[looks], mesh.texture[again] < 0, met < HIDDEN * opposite, place[again])
  )
  first = np.diff(place[again[order]], prepend=-1) != 0
  keep = count[place] == 1
  keep[again[order[first]]] = True
  return mesh._replace(
    faces=mesh.faces[keep],
    corner_colors=mesh.corner_colors[keep],
    corner_uv=mesh.corner_uv[keep],
    texture=mesh.texture[keep],
  )


def _places(vertices, faces):
  """The places of faces and their orientations.

  Returns:
    place [F] int64, the same for the same three corners; turn [F], 0 or 1.
  """
  corners = _hash(vertices)[faces]
  # The order of the corners has no part in a sum, and only their turn in the order from the least.
  place = np.unique(corners.sum(1), return_inverse=True)[1]
  least = corners.argmin(1)
  after, before = (corners[np.arange(len(faces)), (least + k) % 3] for k in (1, 2))
  return place, (after < before).astype(np.int64)


def _hash(vertices):
  """Hashes [V] uint64 of positions; different positions practically never collide."""
  bits = (vertices + 0.0).view(np.uint64)  # + 0.0: of zero there are two
  h = np.zeros(len(vertices), np.uint64)
  for k in range(3):
    h = (h ^ bits[:, k]) * np.uint64(0x9E3779B97F4A7C15)
    h ^= h >> np.uint64(29)
    h *= np.uint64(0xBF58476D1CE4E5B9)
    h ^= h >> np.uint64(32)
  return h


def _looks(mesh, faces):
  """[N] int64, the same for faces with the same texture and colour."""
  color = np.rint(255 * mesh.corner_colors[faces, 0]).astype(np.int64)
  number = color @ (256 ** np.arange(4)) + (mesh.texture[faces].astype(np.int64) << 32)
  return np.unique(number, return_inverse=True)[1]


def _rays_met(mesh):
  """The number of rays that meet each face from the front and from behind: two [F] int64."""
  mi.set_variant('scalar_rgb')
  scene = mi.load_dict({'type': 'scene', 'shape': to_mitsuba(mesh)})
  integrator = mi.load_dict({'type': 'aov', 'aovs': 'face:prim_index'})
  a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
  normal = np.cross(b - a, c - a)
  met = np.zeros((2, len(mesh.faces)), np.int64)
  for direction in DIRECTIONS:
    image = mi.render(scene, sensor=_sensor(direction), integrator=integrator, spp=1)
    face = np.rint(np.asarray(image)[..., -1]).astype(np.int64).ravel() - 1
    face = face[face >= 0]
    from_behind = normal[face] @ direction < 0
    for k in range(2):
      met[k] += np.bincount(face[from_behind == k], minlength=len(mesh.faces))
  return met


def _sensor(direction):
  """Parallel rays from one direction, in a square that holds the cube [-0.5, 0.5]^3."""
  up = (0, 0, 1) if abs(direction[1]) > 0.9 else (0, 1, 0)
  look = mi.ScalarTransform4f().look_at(origin=(2 * direction).tolist(), target=(0, 0, 0), up=up)
  return mi.load_dict(
    {
      'type': 'orthographic',
      'to_world': look
      @ mi.ScalarTransform4f().scale((0.87, 0.87, 1)),  # half of the cube's diagonal
      'near_clip': 0.01,
      'sampler': {'type': 'stratified', 'sample_count': 1, 'jitter': False},
      'film': {
        'type': 'hdrfilm',
        'width': RESOLUTION,
        'height': RESOLUTION,
        'rfilter': {'type': 'box'},
        'pixel_format': 'rgba',
        'component_format': 'float32',
      },
    }
  )
