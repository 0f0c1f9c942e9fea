"""Thousands of files with a byte, a number or a line gone wrong: each is a mesh, or an error."""

import io
import os
import random
import re
import time
import zipfile

import numpy as np
import pytest
import trimesh
from PIL import Image
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from cvn.errors import UserError
from datagen.geometry.coincident import without_coincident
from datagen.geometry.mesh import normalize
from datagen.geometry.voxelize import voxelize
from datagen.reading import EXTENSIONS, read_mesh
from datagen.reading.files import archive_files, folder_files

FILES = 2000
SECONDS = 5  # of work that no file of some hundred bytes is worth
POINTS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 1]], float)
FACES = np.array([[0, 1, 2], [0, 2, 3]])
OBJ = b"""mtllib a.mtl
v 0 0 0
v 1 0 0
v 1 1 0 1 0 0
v 0 1 1e-1
vt 0 0
vt 1 0
vt 1 1
usemtl m
f 1/1 2/2 3/3
f -4//1 -2 -1
f 1 2 3 4 1
"""
MTL = b'newmtl m\nKd 1 .5 0\nd 0.9\nmap_Kd a.png\n'
OFF = b'OFF\n4 2 0\n0 0 0\n1 0 0\n1 1 0\n0 1 1\n3 0 1 2\n4 0 1 2 3\n'
NUMBER = re.compile(rb'-?\d+\.?\d*(?:e[-+]?\d+)?')
NUMBERS = b'0 -1 7 1e30 1e308 1e999 nan inf -inf 1e-30 1e-320 1000000000 4294967295 x'.split()
WORDS = [b'\n', b'\0', b'/', b'"', b'<', b'{', b']', b'\\\n', b'f ', b'../', b'\xff', b'solid']


def picture():
  stream = io.BytesIO()
  Image.effect_noise((8, 8), 50).save(stream, 'PNG')
  return stream.getvalue()


def archive(files):
  stream = io.BytesIO()
  with zipfile.ZipFile(stream, 'w', zipfile.ZIP_DEFLATED) as z:
    for name, content in files.items():
      z.writestr(name, content)
  return stream.getvalue()


def small_files():
  """One of every kind: [(name of what is read, {name: content})]."""
  obj = {'a.obj': OBJ, 'a.mtl': MTL, 'a.png': picture()}
  plain = trimesh.Trimesh(POINTS, FACES, process=False)
  colored = trimesh.Trimesh(POINTS, FACES, face_colors=[[9, 9, 9, 255]] * 2, process=False)
  material = PBRMaterial(baseColorTexture=Image.effect_noise((8, 8), 50))
  textured = plain.copy()
  textured.visual = TextureVisuals(uv=POINTS[:, :2], material=material)
  gltf = trimesh.exchange.gltf.export_gltf(trimesh.Scene(textured))
  contents = {
    'a.glb': textured.export(file_type='glb'),
    'b.ply': colored.export(file_type='ply'),
    'a.ply': colored.export(file_type='ply', encoding='ascii'),
    'a.off': OFF,
    'a.stl': plain.export(file_type='stl'),
    'b.stl': plain.export(file_type='stl_ascii').encode(),
    'a.dae': plain.export(file_type='dae'),
    'a.zip': archive(obj),
  }
  found = [(name, {name: content}) for name, content in contents.items()]
  return [*found, ('a.obj', obj), ('model.gltf', gltf)]


def files_of_programs():
  """Those of meshes.zip, as `small_files`."""
  found = []
  with zipfile.ZipFile(os.path.join(os.path.dirname(__file__), 'meshes.zip')) as z:
    folders = {}
    for name in z.namelist():
      folder, _, below = name.partition('/')
      folders.setdefault(folder, {})[below] = z.read(name)
  for files in folders.values():
    found += [(name, files) for name in files if name.lower().endswith(EXTENSIONS)]
  return found


def mutated(rng, content, others):
  """Some content with some things wrong."""
  content = bytearray(content)
  for _ in range(rng.choice([1, 1, 2, 4])):
    at = rng.randrange(len(content) or 1)
    numbers = list(NUMBER.finditer(content))
    match rng.randrange(8):
      case 0 if content:
        content[at] ^= 1 << rng.randrange(8)
      case 1 if content:
        content[at] = rng.choice([0, 127, 128, 255])
      case 2:
        del content[at:]
      case 3:
        del content[at : at + rng.randrange(1, 40)]
      case 4:
        content[at:at] = content[: rng.randrange(100)]
      case 5:
        content[at:at] = rng.choice(WORDS)
      case 6:
        other = rng.choice(others)
        content[at:] = other[rng.randrange(len(other)) :]
      case _ if numbers:
        span = rng.choice(numbers).span()
        content[slice(*span)] = rng.choice(NUMBERS)
  return bytes(content)


def make(folder, name):
  """What is done with a mesh file, on a small grid and without the views."""
  if name.endswith('.zip'):
    with archive_files(str(folder / name)) as files:
      mesh = read_mesh(files, 'a.obj')
  else:
    mesh = read_mesh(folder_files(str(folder)), name)
  mesh = without_coincident(normalize(mesh))
  assert all(np.isfinite(a).all() for a in (mesh.vertices, mesh.corner_colors, mesh.corner_uv))
  voxelize(mesh, 16)


@pytest.mark.slow
@pytest.mark.parametrize('kinds', [small_files, files_of_programs])
@pytest.mark.parametrize('seed', range(4))
def test_mutated_files(tmp_path, seed, kinds):
  rng = random.Random(seed)
  kinds = kinds()
  contents = [content for _, files in kinds for content in files.values()]
  made = 0
  for n in range(FILES):
    name, files = rng.choice(kinds)
    changed = rng.choice(list(files))
    folder = tmp_path / str(n)
    folder.mkdir()
    for file, content in files.items():
      if file == changed:
        content = mutated(rng, content, contents)
      (folder / file).parent.mkdir(parents=True, exist_ok=True)
      (folder / file).write_bytes(content)
    start = time.process_time()
    try:
      make(folder, name)
      made += 1
    except UserError as e:
      assert '\n' not in str(e), folder
    except Exception as e:
      raise AssertionError(f'look at {folder}') from e
    assert time.process_time() - start < SECONDS, folder
  assert FILES / 10 < made < FILES  # neither all nor none are still meshes
