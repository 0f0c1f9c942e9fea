"""The boundary mesh and its files."""

import json
import os
import struct

import numpy as np
import pytest
import trimesh

from cvn import export, grid
from cvn.errors import UserError


def _voxels(size=8, seed=0, box=((2, 1, 3), (5, 7, 6))):
  occupancy = np.zeros((size,) * 3, bool)
  (x0, y0, z0), (x1, y1, z1) = box
  occupancy[x0:x1, y0:y1, z0:z1] = True
  color = np.random.default_rng(seed).integers(0, 256, (*occupancy.shape, 3)) / 255
  return grid.ColoredVoxels(occupancy, color)


def _solid(voxels):
  mesh = export.surface_mesh(voxels)
  return trimesh.Trimesh(mesh.vertices, mesh.triangles)  # merges vertices by position


def test_box_is_closed_and_has_the_boxes_volume_area_and_place():
  solid = _solid(_voxels())
  assert solid.is_watertight and solid.is_winding_consistent
  np.testing.assert_allclose(solid.volume, 3 * 6 * 3 / 8**3)  # positive: faces look outwards
  np.testing.assert_allclose(solid.area, 2 * (3 * 6 + 6 * 3 + 3 * 3) / 8**2)
  expected = np.array([[2, 1, 3], [5, 7, 6]]) / 8 - 0.5
  np.testing.assert_allclose(solid.bounds, expected)


def test_hollow_box_has_its_inner_wall():
  voxels = _voxels()
  voxels.occupancy[3, 2:6, 4] = False
  solid = _solid(voxels)
  assert solid.is_watertight
  np.testing.assert_allclose(solid.volume, (54 - 4) / 8**3)


def test_volume_of_any_set_is_its_count_and_area_its_faces():
  rng = np.random.default_rng(1)
  occupancy = rng.random((10,) * 3) < 0.3
  voxels = grid.ColoredVoxels(occupancy, rng.random((10, 10, 10, 3)))
  mesh = export.surface_mesh(voxels)
  a, b, c = np.moveaxis(mesh.vertices[mesh.triangles], 1, 0)
  normal = np.cross(b - a, c - a)
  np.testing.assert_allclose(np.sum(a * normal) / 6, occupancy.sum() / 1000)
  padded = np.pad(occupancy, 1).astype(int)
  faces = sum(np.abs(np.diff(padded, axis=k)).sum() for k in range(3))
  assert len(mesh.triangles) == 2 * faces


def test_full_grid_fills_the_cube():
  voxels = grid.ColoredVoxels(np.ones((4,) * 3, bool), np.zeros((4, 4, 4, 3)))
  np.testing.assert_array_equal(_solid(voxels).bounds, [[-0.5] * 3, [0.5] * 3])


def test_every_triangle_has_its_voxels_colour():
  voxels = _voxels()
  mesh = export.surface_mesh(voxels)
  corners = mesh.vertices[mesh.triangles]
  a, b, c = np.moveaxis(corners, 1, 0)
  inwards = -np.cross(b - a, c - a)
  inwards /= np.linalg.norm(inwards, axis=-1, keepdims=True)
  inside = grid.world_to_grid(corners.mean(1) + inwards * 0.3 / 8, size=8).astype(int)
  expected = np.round(voxels.color[tuple(inside.T)] * 255)
  for corner in range(3):
    found = mesh.colors[mesh.vertex_color[mesh.triangles[:, corner]]]
    np.testing.assert_array_equal(found, expected)


def test_one_colour_shares_all_vertices():
  occupancy = np.ones((1, 1, 1), bool)
  mesh = export.surface_mesh(grid.ColoredVoxels(occupancy, np.full((1, 1, 1, 3), 0.5)))
  assert len(mesh.vertices) == 8 and len(mesh.triangles) == 12


def test_ply_brings_back_geometry_and_colours(tmp_path):
  voxels = _voxels()
  path = str(tmp_path / 'new' / 'a.ply')
  export.write_ply(path, voxels)
  loaded = trimesh.load(path, process=False)
  mesh = export.surface_mesh(voxels)
  np.testing.assert_allclose(loaded.vertices, mesh.vertices, atol=1e-7)
  np.testing.assert_array_equal(loaded.faces, mesh.triangles)
  np.testing.assert_array_equal(loaded.visual.vertex_colors[:, :3], mesh.colors[mesh.vertex_color])
  with open(path, 'rb') as f:
    assert b'property uchar red' in f.read(1000)


def test_glb_brings_back_geometry_and_colours(tmp_path):
  voxels = _voxels()
  path = str(tmp_path / 'a.glb')
  export.write_glb(path, voxels)
  loaded = trimesh.load_scene(path, process=False).geometry['voxels']
  mesh = export.surface_mesh(voxels)
  np.testing.assert_allclose(loaded.vertices, mesh.vertices, atol=1e-7)
  np.testing.assert_array_equal(loaded.faces, mesh.triangles)
  texture = loaded.visual.material.baseColorTexture
  colors = trimesh.visual.uv_to_color(loaded.visual.uv, texture)
  np.testing.assert_array_equal(colors[:, :3], mesh.colors[mesh.vertex_color])
  solid = trimesh.Trimesh(loaded.vertices, loaded.faces)
  assert solid.is_watertight and solid.volume > 0


def test_glb_has_a_material_with_the_palette(tmp_path):
  path = str(tmp_path / 'a.glb')
  export.write_glb(path, _voxels())
  with open(path, 'rb') as f:
    data = f.read()
  magic, version, length, json_length, kind = struct.unpack('<4sIII4s', data[:20])
  assert (magic, version, length, kind) == (b'glTF', 2, len(data), b'JSON')
  tree = json.loads(data[20 : 20 + json_length])
  (mesh,) = tree['meshes']
  (primitive,) = mesh['primitives']
  material = tree['materials'][primitive['material']]
  pbr = material['pbrMetallicRoughness']
  assert pbr['metallicFactor'] == 0 and pbr['roughnessFactor'] == 1
  assert pbr.get('baseColorFactor', [1, 1, 1, 1]) == [1, 1, 1, 1]
  assert not material.get('doubleSided', False)
  assert 'TEXCOORD_0' in primitive['attributes'] and 'NORMAL' not in primitive['attributes']
  texture = tree['textures'][pbr['baseColorTexture']['index']]
  assert tree['samplers'][texture['sampler']]['magFilter'] == 9728
  assert tree['images'][texture['source']]['mimeType'] == 'image/png'


def test_ply_with_z_up_is_turned_not_mirrored(tmp_path):
  voxels = _voxels()
  export.write_ply(tmp_path / 'y.ply', voxels)
  export.write_ply(tmp_path / 'z.ply', voxels, up='z')
  y, z = (trimesh.load(tmp_path / f'{up}.ply') for up in 'yz')
  np.testing.assert_allclose(
    z.vertices, np.stack([y.vertices[:, i] for i in (0, 2, 1)], -1) * [1, -1, 1]
  )
  np.testing.assert_allclose(z.volume, y.volume)


@pytest.mark.parametrize('write', [export.write_glb, export.write_ply])
def test_nothing_occupied_writes_nothing(tmp_path, write):
  empty = grid.ColoredVoxels(np.zeros((4,) * 3, bool), np.zeros((4, 4, 4, 3)))
  with pytest.raises(UserError, match='no voxel is occupied'):
    write(str(tmp_path / 'a'), empty)
  assert os.listdir(tmp_path) == []


def test_a_place_that_cannot_be_written(tmp_path):
  (tmp_path / 'file').write_text('')
  with pytest.raises(UserError, match='cannot write'):
    export.write_glb(str(tmp_path / 'file' / 'a.glb'), _voxels())
