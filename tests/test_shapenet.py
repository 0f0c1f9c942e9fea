"""ShapeNetCore in miniature, both versions, in folders and archives."""

import os
import pathlib
import pickle
import zipfile

import numpy as np
import PIL.Image
import pytest

from cvn.errors import UserError
from datagen import plan
from datagen.geometry.mesh import NO_COLOR, albedo
from datagen.sources import shapenet, source
from datagen.splits import read_splits

CHAIR, CAR = '03001627', '02958343'
RELEASE = pathlib.Path(__file__).parents[2] / 'shared' / 'release_splits'
# A cube whose sides are named after their directions in the file.
CUBE = """mtllib model.mtl
v -1 -1 -1
v 1 -1 -1
v 1 1 -1
v -1 1 -1
v -1 -1 1
v 1 -1 1
v 1 1 1
v -1 1 1
vt -2 7
vt -1 7
vt -1 8
vt -2 8
usemtl +x
f 2/1 3/2 7/3
f 2/1 7/3 6/4
usemtl -x
f 1/1 5/2 8/3
f 1/1 8/3 4/4
usemtl +y
f 4/1 8/2 7/3
f 4/1 7/3 3/4
usemtl -y
f 1/1 2/2 6/3
f 1/1 6/3 5/4
usemtl +z
f 5/1 6/2 7/3
f 5/1 7/3 8/4
usemtl -z
f 1/1 4/2 3/3
f 1/1 3/3 2/4
"""
DIRECTION = {'x': [1, 0, 0], 'y': [0, 1, 0], 'z': [0, 0, 1]}
COLORS = {
  '+x': (1, 0, 0),
  '-x': (0, 1, 1),
  '+y': (0, 1, 0),
  '-y': (1, 0, 1),
  '+z': (0, 0, 1),
  '-z': (1, 1, 0),
}
PLAIN = ''.join(f'newmtl {n}\nKd {r} {g} {b}\n' for n, (r, g, b) in COLORS.items())
BLUE, RED = [51, 102, 255], [255, 0, 0]


def write_model(folder, version, mtl=PLAIN):
  """Writes a cube as version 1 or 2 has it; returns the folder of its OBJ file."""
  below = folder / 'models' if version == 2 else folder
  below.mkdir(parents=True)
  name = 'model_normalized' if version == 2 else 'model'
  (below / f'{name}.obj').write_text(CUBE.replace('model.mtl', f'{name}.mtl'))
  if mtl is not None:
    (below / f'{name}.mtl').write_text(mtl)
  return below


def pack(folder, archive):
  """A folder as a zip archive, with itself as the topmost name."""
  with zipfile.ZipFile(archive, 'w') as z:
    for path in sorted(folder.rglob('*')):
      z.write(path, path.relative_to(folder.parent))


def color_of(mesh, side):
  """Colour, 0..255, in the middle of a side's first triangle."""
  direction = np.array(DIRECTION[side[1]]) * (1 if side[0] == '+' else -1)
  face = (mesh.vertices[mesh.faces].mean(1) @ direction).argmax()
  return np.rint(255 * albedo(mesh, np.array([face]), np.array([[1 / 3] * 3]))[0, :3]).tolist()


def load_only(category, folder):
  (model,) = shapenet.list_models(category, str(folder))
  return shapenet.load(model)


def packed(folder):
  """The same as archives, in a folder of their own."""
  archives = folder.with_name(f'{folder.name}_zip')
  archives.mkdir()
  for synset in folder.iterdir():
    pack(synset, archives / f'{synset.name}.zip')
  return archives


@pytest.mark.parametrize('place', [lambda folder: folder, packed])
@pytest.mark.parametrize(('version', 'front', 'left'), [(1, '+x', '-z'), (2, '-z', '-x')])
def test_models_face_z(tmp_path, version, front, left, place):
  """What ShapeNet calls the front comes to +z, its top to +y, and so its left to +x."""
  write_model(tmp_path / 'core' / CHAIR / 'abc', version)
  mesh = load_only('chair', place(tmp_path / 'core'))
  for side, original in (('+z', front), ('+y', '+y'), ('+x', left)):
    assert color_of(mesh, side) == [255 * c for c in COLORS[original]]
  assert mesh.missing == ()
  volume = np.einsum('fk,fk->', *sides_and_normals(mesh)) / 6
  assert volume == pytest.approx(8)  # turned and not mirrored: its faces still look outwards


def sides_and_normals(mesh):
  a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
  return a, np.cross(b, c)


@pytest.mark.parametrize('place', [lambda folder: folder, packed])
@pytest.mark.parametrize(
  ('version', 'file', 'name'),
  [
    (1, 'texture0.png', 'texture0.png'),
    (1, 'images/texture0.png', './images/texture0.png'),
    (1, 'images/texture0.png', '.\\images\\texture0.png'),
    (1, 'untextured/my wood.PNG', 'untextured\\my wood.png'),
    (1, 'untextured/texture0.png', 'texture0.png'),
    (1, 'images/texture0.png', 'C:\\Users\\me\\My Models\\Texture0.png'),
    (1, 'texture0.png', '/home/me/texture0.png'),
    (1, 'texture0.png', '../../../texture0.png'),
    (2, 'images/texture0.png', '../images/texture0.png'),
    (2, 'images/texture0.png', '..\\images\\texture0.png'),
    (2, 'images/texture0.png', 'texture0.png'),
    (2, 'images/texture0.png', 'D:/x/images/texture0.png'),
    (2, 'models/texture0.png', '-s 1 1 1 texture0.png'),
  ],
)
def test_textures_are_found_where_they_are(tmp_path, version, file, name, place):
  """The cube's texture coordinates lie between -2 and 8: the image repeats."""
  folder = tmp_path / 'core' / CHAIR / 'abc'
  mtl = ''.join(f'newmtl {side}\nKd 1 1 1\nmap_Kd {name}\n' for side in COLORS)
  write_model(folder, version, mtl)
  (folder / file).parent.mkdir(exist_ok=True)
  halves = np.zeros((32, 32, 3), np.uint8)
  halves[:16], halves[16:] = BLUE, RED
  PIL.Image.fromarray(halves).save(folder / file)
  mesh = load_only('chair', place(tmp_path / 'core'))
  assert mesh.missing == () and len(mesh.textures) == 1
  # A side's first triangle has its middle at u, v of fractions (2/3, 1/3): in the lower half.
  assert color_of(mesh, '+z') == RED


@pytest.mark.parametrize('version', [1, 2])
def test_what_is_missing_is_counted_and_leaves_the_material_color(tmp_path, version):
  mtl = PLAIN.replace('Kd 0 0 1', 'Kd 0.2 0.4 1\nmap_Kd ..\\images\\gone.png')
  mtl = mtl.replace('Kd 1 0 0', 'Kd 1 0 0\nmap_Kd C:\\x\\texture1.png')
  write_model(tmp_path / CHAIR / 'abc', version, mtl)
  mesh = load_only('chair', tmp_path)
  assert len(mesh.missing) == 2 and not mesh.textures
  assert color_of(mesh, {1: '-x', 2: '-z'}[version]) == BLUE
  assert color_of(mesh, {1: '+z', 2: '-x'}[version]) == RED


def test_textures_of_other_models_are_not_taken(tmp_path):
  """Every model calls its first picture texture0: another one's is not its own."""
  mtl = PLAIN.replace('Kd 0 0 1', 'Kd 0.2 0.4 1\nmap_Kd ../images/texture0.png')
  write_model(tmp_path / CHAIR / 'abc', 2, mtl)
  other = tmp_path / CHAIR / 'def' / 'images'
  other.mkdir(parents=True)
  PIL.Image.new('RGB', (8, 8), (9, 9, 9)).save(other / 'texture0.png')
  for folder in (tmp_path, packed(tmp_path)):
    mesh = shapenet.load(shapenet.list_models('chair', str(folder))[0])
    assert mesh.missing == ('../images/texture0.png',)
    assert color_of(mesh, '-z') == BLUE


def test_without_its_mtl_a_model_is_grey_and_that_is_counted(tmp_path):
  write_model(tmp_path / CHAIR / 'abc', 2, mtl=None)
  mesh = load_only('chair', tmp_path)
  assert mesh.missing == ('model_normalized.mtl',)
  assert color_of(mesh, '+z') == [255 * NO_COLOR] * 3


def test_models_are_listed_by_id_from_folders_and_archives(tmp_path):
  core = tmp_path / 'core'
  for n, id in enumerate(('b2', 'a1', 'c3')):
    write_model(core / CHAIR / id, 1 + n % 2)
  (core / CHAIR / '.hidden').mkdir()
  (core / CHAIR / 'chairs.csv').write_text('')
  write_model(core / '02876657' / 'bottle', 2)
  for folder in (core, packed(core)):
    models = shapenet.list_models('chair', str(folder))
    assert [m.id for m in models] == ['a1', 'b2', 'c3']
    assert {m.category for m in models} == {'chair'}
    assert {m.licence for m in models} == {shapenet.LICENCE}
    assert pickle.loads(pickle.dumps(models)) == models
    assert shapenet.list_models('chair', str(folder), 2) == models[:2]
    assert shapenet.list_models(CHAIR, str(folder)) == models
    assert [m.category for m in shapenet.list_models('02876657', str(folder))] == ['02876657']
    with pytest.raises(UserError, match=rf'neither a folder {CAR} nor an archive {CAR}\.zip'):
      shapenet.list_models('car', str(folder))
  assert shapenet.list_models('chair', str(core / CHAIR))[0].id == 'a1'
  assert shapenet.list_models('chair', str(tmp_path / 'core_zip' / f'{CHAIR}.zip'))[0].id == 'a1'
  # The data set keeps places below the input, which may move.
  planned = plan.plan(shapenet.list_models('chair', str(core), 1), 'shapenet', input_dir=str(core))
  assert planned[0].path == os.path.join(CHAIR, 'a1')


@pytest.mark.parametrize('top', ['', 'ShapeNetCore.v2/'])
def test_archives_may_begin_above_the_synset_or_below_it(tmp_path, top):
  folder = write_model(tmp_path / 'abc', 1)
  with zipfile.ZipFile(tmp_path / f'{CHAIR}.zip', 'w') as z:
    for name in ('model.obj', 'model.mtl'):
      z.write(folder / name, f'{top}{CHAIR if top else ""}/abc/{name}'.lstrip('/'))
  assert color_of(load_only('chair', tmp_path), '+z') == RED


def test_errors_say_what_to_do(tmp_path):
  with pytest.raises(UserError, match=r"'sofa'.*car, chair, guitar, table.*synset"):
    shapenet.list_models('sofa', str(tmp_path))
  for folder in (None, '', str(tmp_path / 'gone')):
    with pytest.raises(UserError, match='--input'):
      shapenet.list_models('chair', folder)
  (tmp_path / CHAIR).mkdir()
  with pytest.raises(UserError, match='no model'):
    shapenet.list_models('chair', str(tmp_path))
  (tmp_path / CHAIR / 'abc').mkdir()
  with pytest.raises(
    UserError, match=r'abc has neither models/model_normalized\.obj nor model\.obj'
  ):
    load_only('chair', tmp_path)
  (tmp_path / f'{CAR}.zip').write_text('no archive')
  with pytest.raises(UserError, match=rf'{CAR}\.zip'):
    shapenet.list_models('car', str(tmp_path))


def test_the_lists_of_the_paper_choose_the_models(tmp_path):
  """Lists have the synset's name; models that no list names are left out."""
  for id in ('abc', 'def', 'ghi', 'not in the paper'):
    write_model(tmp_path / CHAIR / id, 2)
  lists = tmp_path / 'lists'
  lists.mkdir()
  for split, ids in (('train', 'def\nlost\n'), ('val', 'ghi\n'), ('test', 'abc\n')):
    (lists / f'{split}_list_{CHAIR}.txt').write_text(ids)
  for category in ('chair', CHAIR):
    models = plan.list_models('shapenet', [category], str(tmp_path), None, 0)
    listed, note = plan.keep_listed(models, str(lists), None)
    planned = plan.plan(listed, 'shapenet', input_dir=str(tmp_path))
    assert [(m.id, m.split) for m in planned] == [('abc', 'test'), ('def', 'train'), ('ghi', 'val')]
    assert '3 models listed and found, 1 listed but not found, 1 found but not' in note


@pytest.mark.skipif(not RELEASE.is_dir(), reason='the lists of the paper are not here')
@pytest.mark.parametrize(
  ('category', 'counts'),
  [
    ('car', (2372, 339, 678)),
    ('chair', (1539, 220, 440)),
    ('table', (1777, 254, 508)),
    ('guitar', (441, 63, 127)),
  ],
)
def test_the_lists_of_the_paper(category, counts):
  splits = list(read_splits(str(RELEASE), category).values())
  assert tuple(splits.count(split) for split in ('train', 'val', 'test')) == counts


def test_is_a_source():
  assert source('shapenet') is shapenet
