"""Small meshes after public bug reports, a kind of fault each, and what is right.

meshes.zip holds them in a folder each, meshes.json what is right: the colours around the middles of
the front's quarters (upper left, upper right, lower left, lower right; null where nothing is, '-'
where anything is), proportions, or a pattern of the reason for which a mesh may be refused, or is.
"""

import json
import os
import re
import zipfile

import numpy as np
import pytest

from cvn.errors import UserError
from datagen.geometry.mesh import albedo, is_surface
from datagen.reading import EXTENSIONS, notes, read_mesh
from datagen.reading.files import folder_files

HERE = os.path.dirname(__file__)
FOUR = [[220, 40, 40], [40, 180, 60], [40, 60, 200], [230, 210, 50]]
QUARTERS = [(0.25, 0.75), (0.75, 0.75), (0.25, 0.25), (0.75, 0.25)]
with open(os.path.join(HERE, 'meshes.json'), encoding='utf-8') as f:
  EXPECTED = json.load(f)


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
  folder = tmp_path_factory.mktemp('meshes')
  with zipfile.ZipFile(os.path.join(HERE, 'meshes.zip')) as z:
    z.extractall(folder)
  return str(folder)


def read(folder, name):
  files = folder_files(folder)
  (path,) = (n for n in files.names(name) if n.lower().endswith(EXTENSIONS))
  return read_mesh(files, path)


def front(mesh):
  """What a ray from the front meets at the middle of each quarter: its colour, or None."""
  low, high = (f(mesh.vertices[np.unique(mesh.faces)], 0) for f in (np.min, np.max))
  corners = mesh.vertices[mesh.faces]
  found = []
  for u, v in QUARTERS:
    # Not exactly the middle: there two triangles meet, and texels do.
    at = low[:2] + (np.array([u, v]) + [0.013, 0.007]) * (high - low)[:2]
    edges = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], -1)[:, :2]
    flat = np.abs(np.linalg.det(edges)) > 1e-9 * np.prod(high - low)
    weight = np.zeros((len(corners), 3))
    weight[flat, 1:] = np.linalg.solve(edges[flat], (at - corners[flat, 0, :2])[..., None])[..., 0]
    weight[:, 0] = 1 - weight[:, 1] - weight[:, 2]
    depth = (weight * corners[..., 2]).sum(1)
    met = flat & (weight >= -1e-9).all(1) & (depth > high[2] - 0.03 * (high - low)[2])
    met = np.flatnonzero(met)
    met = met[is_surface(mesh, met, weight[met])]
    first = met[np.argsort(-depth[met], kind='stable')[:1]]
    color = 255 * albedo(mesh, first, weight[first])[:, :3]
    found.append(color[0].round().astype(int).tolist() if len(first) else None)
  return found, (high - low).tolist()


@pytest.mark.parametrize('name', EXPECTED)
def test_mesh(folder, name):
  expected = EXPECTED[name]
  try:
    mesh = read(folder, name)
  except UserError as e:
    assert '\n' not in str(e)
    reason = str(e).split(': ', 1)[1]
    assert re.search(expected.get('fails', '(?!)'), reason, re.IGNORECASE), e
    return
  assert expected.get('fails') != '.' and len(expected) > 2
  found, size = front(mesh)
  quarters = FOUR if expected.get('front') == 'four' else expected.get('front', ['-'] * 4)
  for actual, right in zip(found, quarters, strict=True):
    if right == '-':
      continue
    assert (actual is None) == (right is None), (found, quarters)
    assert right is None or np.abs(np.subtract(actual, right)).max() <= 15, (found, quarters)
  if 'size' in expected:
    right = np.array(expected['size'])
    np.testing.assert_allclose(np.array(size) / max(size), right / right.max(), atol=0.02)


@pytest.mark.parametrize(
  ('name', 'missing', 'noted'),
  [
    ('b04_windows_path', (), (notes.PICTURE_GUESSED,)),
    ('b04c_windows_path_missing', ('C:\\Users\\anna\\Desktop\\chair\\wood.png',), ()),
    ('b05_no_usemtl', (), (notes.MATERIAL_GUESSED,)),
    ('b06_vertex_color_255', (), (notes.COLOR_RANGE_GUESSED,)),
    ('b08_d_0', (), (notes.ALPHA_IGNORED,)),
    ('b09h_case_of_material', (), (notes.MATERIAL_GUESSED,)),
    ('b23_mixed_faces', (), (notes.BAD_COORDINATES,)),
    ('b26_latin1', (), (notes.TEXT_GUESSED,)),
    ('b30b_only_the_name', (), (notes.PICTURE_GUESSED,)),
    ('a07_skin', (), (notes.POSE,)),
    ('c09_rgba_all_transparent', (), (notes.ALPHA_IGNORED,)),
    ('d01c_ushort', (), ()),
    ('d11_vertex_and_face_colors', (), (notes.COLORS_IGNORED,)),
    ('a01_texture_transform', (), ()),
    ('b09_names', (), ()),
  ],
)
def test_what_was_guessed_is_said(folder, name, missing, noted):
  mesh = read(folder, name)
  assert (mesh.missing, mesh.notes) == (missing, noted)
