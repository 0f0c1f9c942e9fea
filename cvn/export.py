"""Coloured voxels as mesh files.

The mesh is the boundary of the occupied voxels: one quad (two triangles) a face between an
occupied and an empty voxel, counter-clockwise seen from outside, in the world of cvn.grid: the
cube [-0.5, 0.5]^3, y up, front towards +z, which is glTF's own convention. Two quads share a
corner's vertex where they have the same colour, so each vertex has one colour.

GLB carries its colours as a palette texture (a texel a colour, every vertex at a texel's centre)
in an ordinary metallic-roughness material: every viewer shows that, while vertex colours are
ignored by some, and are linear light where colours here are sRGB. Since (u, v) is the same all over
a face, no filter and no mipmap can mix neighbouring texels. Normals are left out: glTF then asks
for flat ones, as a voxel has.
"""

from typing import NamedTuple

import numpy as np
import trimesh
from PIL import Image

from cvn import grid
from cvn.boundary import find_faces
from cvn.errors import UserError
from cvn.figures import to_uint8
from cvn.files import atomic_write

_NEAREST = 9728  # glTF's (and OpenGL's) number for the filter


class SurfaceMesh(NamedTuple):
  """Triangles between occupied and empty voxels, coloured by vertex."""

  vertices: np.ndarray  # [V, 3] float, world
  triangles: np.ndarray  # [F, 3] int, counter-clockwise from outside
  colors: np.ndarray  # [C, 3] uint8 sRGB, the palette
  vertex_color: np.ndarray  # [V] int, index into `colors`


def surface_mesh(voxels: grid.ColoredVoxels) -> SurfaceMesh:
  """The boundary of the occupied voxels.

  Args:
    voxels: occupancy [X, X, X] bool, color [X, X, X, 3] in [0, 1].

  Raises:
    UserError: no voxel is occupied.
  """
  occupancy = np.asarray(voxels.occupancy, bool)
  if not occupancy.any():
    raise UserError('no voxel is occupied: there is no surface to write')
  n = len(occupancy)
  colors, color_of = np.unique(to_uint8(voxels.color)[occupancy], axis=0, return_inverse=True)
  color_index = np.zeros(occupancy.shape, int)
  color_index[occupancy] = color_of.ravel()

  faces = find_faces(occupancy)
  quad_colors = color_index[tuple(faces.voxel.T)]

  key = np.ravel_multi_index(np.moveaxis(faces.corners, -1, 0), (n + 1,) * 3)
  key = key * len(colors) + quad_colors[:, None]
  unique, quads = np.unique(key, return_inverse=True)
  lattice = np.stack(np.unravel_index(unique // len(colors), (n + 1,) * 3), -1)
  triangles = quads.reshape(-1, 4)[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
  # A corner of voxel i is half a voxel below its centre.
  vertices = grid.index_to_world(lattice - 0.5, size=n)
  return SurfaceMesh(vertices, triangles, colors, unique % len(colors))


def write_glb(path: str, voxels: grid.ColoredVoxels) -> None:
  """Writes a binary glTF file whose material shows the colours.

  Raises:
    UserError: no voxel is occupied, or the place cannot be written.
  """
  mesh = surface_mesh(voxels)
  side = int(np.ceil(np.sqrt(len(mesh.colors))))
  palette = np.zeros((side * side, 3), np.uint8)
  palette[: len(mesh.colors)] = mesh.colors
  row, column = np.divmod(mesh.vertex_color, side)
  # trimesh's v runs upwards: 1 is the image's first row.
  uv = np.stack([(column + 0.5) / side, 1 - (row + 0.5) / side], -1)
  material = trimesh.visual.material.PBRMaterial(
    name='voxels',
    baseColorTexture=Image.fromarray(palette.reshape(side, side, 3)),
    metallicFactor=0.0,
    roughnessFactor=1.0,
    doubleSided=False,
  )
  visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
  solid = trimesh.Trimesh(mesh.vertices, mesh.triangles, visual=visual, process=False)

  def with_sampler(tree):
    tree['samplers'] = [{'magFilter': _NEAREST, 'minFilter': _NEAREST}]
    for texture in tree['textures']:
      texture['sampler'] = 0

  scene = trimesh.Scene({'voxels': solid})
  data = scene.export(file_type='glb', include_normals=False, tree_postprocessor=with_sampler)
  _write(path, data)


def write_ply(path: str, voxels: grid.ColoredVoxels, *, up: str = 'y') -> None:
  """Writes a binary PLY file with colours (uchar red, green, blue) on its vertices.

  Args:
    path: the file.
    voxels: occupancy [X, X, X] bool, color [X, X, X, 3] in [0, 1].
    up: 'y', as elsewhere here, or 'z', as in Blender and CAD programs; the front then faces -y.

  Raises:
    UserError: no voxel is occupied, or the file cannot be written.
  """
  mesh = surface_mesh(voxels)
  x, y, z = mesh.vertices.T
  solid = trimesh.Trimesh(
    np.stack([x, -z, y] if up == 'z' else [x, y, z], -1),
    mesh.triangles,
    vertex_colors=mesh.colors[mesh.vertex_color],
    process=False,
  )
  _write(path, solid.export(file_type='ply', vertex_normal=False))


def _write(path: str, data: bytes) -> None:
  with atomic_write(path) as temporary, open(temporary, 'wb') as f:
    f.write(data)
