"""The furniture source on libraries written here: what is chosen, and how it is set up."""

import os
import pickle
import zipfile

import numpy as np
import pytest

from cvn.errors import UserError
from datagen import plan
from datagen.geometry.mesh import albedo
from datagen.sources import SourceModel, sweethome3d
from datagen.sources.furniture_catalogue import Piece
from datagen.sources.sweethome3d import list_models, load
from datagen.splits import split_of

CATALOGUE = 'PluginFurnitureCatalog.properties'
# A tetrahedron with corners at the origin and at 1 on x, 2 on y and 3 on z.
OBJ = 'v 0 0 0\nv 1 0 0\nv 0 2 0\nv 0 0 3\nusemtl {}\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n'


def write_library(path, pieces, *, head='license=CC0', catalogue=CATALOGUE, files=()):
  """A library whose pieces are (name, keys); each has its model `NAME/NAME.obj` unless it says so.

  Other languages' names, which must not be read, are there as in every real library.
  """
  lines, members = [head], dict(files)
  for n, (name, keys) in enumerate(pieces, 1):
    model = f'{name}/{name}.obj'.replace(' ', '')
    defaults = {'id': f'Lib#{name}', 'name': name, 'model': '/' + model, 'creator': 'Ann'}
    lines += [f'{key}#{n}={value}' for key, value in (defaults | keys).items()]
    members.setdefault(model, 'mtllib m.mtl\n' + OBJ.format('m'))
    members.setdefault(os.path.join(os.path.dirname(model), 'm.mtl'), 'newmtl m\nKd 1 0.2 0.4\n')
  members[catalogue] = '\n'.join(lines)
  members[catalogue.replace('.', '_fr.')] = 'name#1=Chaise\nmodel#1=/chaise.obj\n'
  with zipfile.ZipFile(path, 'w') as archive:
    for name, text in members.items():
      archive.writestr(name, text.encode('latin-1') if isinstance(text, str) else text)
  return str(path)


def chosen(path, category):
  return [m.detail.name for m in list_models(category, path, None, 0)]


@pytest.fixture
def shop(tmp_path):
  tagged = [
    ('Ford Focus', 'Blend Swap, Car'), ('Lorry', 'Truck'), ('City bus', 'Car'),
    ('Truck', 'Car'), ('Van', 'Car, Truck'), ('Car model', 'Toy'), ('Female', 'Human, Woman'),
    ('Mannequin', 'Human'), ('Cat', 'Animal'), ('Bar stool', 'Chair, Seat'), ('Puff', 'Chair'),
  ]  # fmt: skip
  plain = [
    'Smart car', 'Carpet', 'Toy car', 'Oak chair', 'Armchair', 'ARMCHAIR ottoman', 'Chairlift',
    'Chair with cushion', 'Wheelchair', 'Chair lift', 'Table', 'Table lamp', 'Table fan', 'Desk',
    'Desk lamp', 'Tablet', 'Tablecloth', 'Table on trestles', 'Table tennis', 'Table tennis bat',
    'Bedside table', 'Football table', 'Boy', 'Woman shoes', 'Snow man', 'Electric guitar',
    'Guitar stand', 'Sofa', 'Couch',
  ]  # fmt: skip
  pieces = [(name, {'tags': tags}) for name, tags in tagged] + [(name, {}) for name in plain]
  return write_library(tmp_path / 'shop.sh3f', pieces)


@pytest.mark.parametrize(
  ('category', 'names'),
  [
    ('car', ['Ford Focus', 'Van', 'Smart car']),
    ('human', ['Female', 'Boy']),
    ('chair', ['Bar stool', 'Oak chair', 'Armchair', 'Chair with cushion', 'Wheelchair']),
    ('table', ['Table', 'Desk', 'Table on trestles', 'Table tennis']),
    ('guitar', ['Electric guitar']),
    ('sofa=sofa|couch', ['Sofa', 'Couch']),
    ('table=^table$', ['Table']),
    ('sofa=divan', []),
  ],
)
def test_categories_are_chosen_by_name_and_tag(shop, category, names):
  assert chosen(shop, category) == names
  models = list_models(category, shop, None, 0)
  assert {m.category for m in models} <= {category.partition('=')[0]}
  assert list_models(category, shop, 1, 5) == models[:1]


def test_a_model_says_whose_it_is_and_under_which_licence(tmp_path):
  pieces = [
    ('Chair', {}),
    ('Old chair', {'creator': 'Jos\\u00e9  M\xfcller', 'license': 'CC-BY 3.0 \xa9 Jos\\u00e9'}),
  ]
  path = write_library(tmp_path / 'a.sh3f', pieces)
  first, second = list_models('chair', path, None, 0)
  assert (first.id, first.creator, first.licence) == ('Lib_Chair', 'Ann', 'CC0')
  assert (second.id, second.creator) == ('Lib_Old_chair', 'José Müller')
  assert second.licence == 'CC-BY 3.0 © José'
  assert first.path == path and pickle.loads(pickle.dumps(second)) == second


def test_the_data_set_says_so_too(shop):
  """Several categories at once, one of them with a pattern."""
  found = plan.list_models('sweethome3d', ['guitar', 'sofa=sofa|couch'], shop, None, 0)
  models = plan.plan(found, 'sweethome3d', input_dir=shop)
  assert [(m.id, m.category) for m in models] == [
    ('Lib_Electric_guitar', 'guitar'),
    ('Lib_Sofa', 'sofa'),
    ('Lib_Couch', 'sofa'),
  ]
  assert {(m.path, m.creator, m.licence) for m in models} == {('shop.sh3f', 'Ann', 'CC0')}
  assert [m.split for m in models] == [m.split for m in found]


def test_a_folder_of_libraries_has_unique_and_stable_ids(tmp_path):
  """Two versions of one library, a jar without a catalogue, the program's jar, hidden files."""
  (tmp_path / 'old').mkdir()
  write_library(tmp_path / 'new.sh3f', [('Chair', {}), ('Chair', {}), ('Big chair', {})])
  write_library(tmp_path / 'old' / 'new.SH3F', [('Chair', {}), ('Chair 2', {'name': 'Chair'})])
  write_library(tmp_path / 'x.jar', [('Stuhl', {'id': ''})], catalogue='x/properties')
  write_library(
    tmp_path / 'program.jar',
    [('Armchair', {'id': ''})],
    catalogue='com/eteks/sweethome3d/io/DefaultFurnitureCatalog.properties',
  )
  (tmp_path / '._new.sh3f').write_text('no archive')
  models = list_models('chair', str(tmp_path), None, 0)
  ids = [m.id for m in models]
  assert ids[0][:-8] == ids[2][:-8] == 'Lib_Chair_' and ids[0] != ids[2]
  assert ids[1:2] + ids[3:] == ['Lib_Big_chair', 'Lib_Chair_2', 'program_Armchair_Armchair.obj']
  os.rename(tmp_path, tmp_path.parent / 'moved')
  assert [m.id for m in list_models('chair', str(tmp_path.parent / 'moved'), None, 0)] == ids


def test_variants_of_a_model_share_a_split(tmp_path):
  """Also models of one file, whatever their pieces are called."""
  woods = ('alder', 'pear', 'teak', 'oak', 'pine', 'beech', 'ash')
  sets = [f'set{n}' for n in range(40)]
  pieces = [
    (f'{s}_office_{wood}_table', {'name': 'Table'}) for s in sets[:20] for wood in woods
  ] + [(f'{s} {wood} table', {'model': f'/{s}.obj'}) for s in sets[20:] for wood in woods]
  models = list_models('table', write_library(tmp_path / 'a.sh3f', pieces), None, 0)
  assert len(models) == 40 * len(woods)
  split = {}
  for m in models:
    split.setdefault(m.id.replace(' ', '_').split('_')[1 if 'Lib' in m.id else 0], set()).add(
      m.split
    )
  assert len(split) == 40 and all(len(s) == 1 for s in split.values())
  assert set.union(*split.values()) == {'train', 'val', 'test'}
  assert split['set20'] == {split_of('set20')}


def test_rotation_and_size_are_applied(tmp_path):
  """v' = M v with M row by row, then each side gets the length that the catalogue says."""
  turn = '0 0 -1 0 1 0 1 0 0'  # z becomes -x, x becomes z
  pieces = [
    ('Chair', {'modelRotation': turn}),
    ('Big chair', {'modelRotation': turn, 'width': 30, 'depth': 20, 'height': 10}),
    ('Plain chair', {}),
  ]
  path = write_library(tmp_path / 'a.sh3f', pieces)
  corners = [corner_set(load(m)) for m in list_models('chair', path, None, 0)]
  assert corners[0] == {(0, 0, 0), (0, 0, 1), (0, 2, 0), (-3, 0, 0)}
  assert corners[1] == {(0, 0, 0), (0, 0, 20), (0, 10, 0), (-30, 0, 0)}
  assert corners[2] == {(0, 0, 0), (1, 0, 0), (0, 2, 0), (0, 0, 3)}


def test_a_flat_model_stays_flat(tmp_path):
  flat = 'v 0 0 0\nv 1 0 0\nv 0 0 1\nf 1 2 3\n'
  keys = {'model': 'flat.obj', 'width': 8, 'depth': 4, 'height': 1}
  path = write_library(tmp_path / 'a.sh3f', [('Table', keys)], files={'flat.obj': flat})
  (model,) = list_models('table', path, None, 0)
  assert corner_set(load(model)) == {(0, 0, 0), (8, 0, 0), (0, 0, 4)}


def corner_set(mesh):
  return {tuple(map(float, np.round(v, 6))) for v in mesh.vertices}


def first_color(mesh):
  return 255 * albedo(mesh, np.array([0]), np.full((1, 3), 1 / 3))[0]


def test_colours_are_the_mtl_files_or_the_built_in_materials(tmp_path):
  """Amber without an MTL file, own materials before built-in ones, and those beside an MTL file."""
  files = {
    'Amberchair/Amberchair.obj': OBJ.format('amber'),
    'Ownchair/Ownchair.obj': 'mtllib own.mtl\n' + OBJ.format('amber'),
    'Ownchair/own.mtl': 'newmtl amber\nKd 0 1 0\n',
    'Glasschair/Glasschair.obj': 'mtllib own.mtl\n' + OBJ.format('glasstransparent'),
    'Glasschair/own.mtl': 'newmtl amber\nKd 0 1 0\n',
  }
  names = ['Amber chair', 'Own chair', 'Glass chair', 'Chair']
  path = write_library(tmp_path / 'a.sh3f', [(name, {}) for name in names], files=files)
  models = list_models('chair', path, None, 0)
  colors = [first_color(load(m)) for m in models]
  expected = [(147, 68, 0, 255), (0, 255, 0, 255), (120, 120, 120, 64), (255, 51, 102, 255)]
  np.testing.assert_allclose(colors, expected, atol=0.6)
  assert not any(load(m).missing for m in models)


@pytest.mark.parametrize(
  ('keys', 'reason'),
  [
    ({'model': '/gone.obj'}, 'no file gone.obj'),
    ({'model': '/Chair/chair.3ds'}, r'chair\.3ds is not in a supported format: \.obj'),
    ({'model': '/../../Chair/Chair'}, 'not in a supported format'),
    ({'modelRotation': '1 0 0 0 1 0 0 0'}, "9 numbers, not '1 0 0 0 1 0 0 0'"),
    ({'modelRotation': '1 0 0 0 1 0 0 0 nan'}, 'modelRotation must be 9 numbers'),
    ({'modelRotation': '1 0 0 0 1 0 0 0 -1'}, 'not a rotation: 1 0 0 0 1 0 0 0 -1'),
    ({'modelRotation': '2 0 0 0 2 0 0 0 2'}, 'not a rotation'),
    ({'width': '1'}, "must be 3 numbers, not '1  '"),
    ({'width': '1', 'depth': '0', 'height': '1'}, 'must be positive'),
    ({'width': '1', 'depth': 'inf', 'height': '1'}, 'must be 3 numbers'),
  ],
)
def test_a_bad_piece_has_a_reason(tmp_path, keys, reason):
  path = write_library(tmp_path / 'a.sh3f', [('Chair', keys)])
  (model,) = list_models('chair', path, None, 0)
  with pytest.raises(UserError, match=reason) as e:
    load(model)
  assert '\n' not in str(e.value)


def test_bad_input_is_named(shop, tmp_path):
  (tmp_path / 'broken.sh3f').write_bytes(b'PK no archive')
  write_library(tmp_path / 'x.jar', [('Chair', {})], catalogue='x.properties')
  (tmp_path / 'empty').mkdir()
  for category, path, said in (
    ('sofa', shop, "car, chair, guitar, human, table, not 'sofa'.*--category='sofa=PATTERN'"),
    ('sofa=', shop, 'NAME=PATTERN'),
    ('=sofa', shop, 'NAME=PATTERN'),
    ('sofa=(', shop, 'not a regular expression'),
    ('chair', None, 'needs --input: a furniture library'),
    ('chair', str(tmp_path / 'gone'), 'gone does not exist'),
    ('chair', str(tmp_path / 'empty'), 'empty has no furniture catalogue'),
    ('chair', str(tmp_path / 'x.jar'), r'x\.jar has no furniture catalogue'),
    ('chair', str(tmp_path / 'broken.sh3f'), r'broken\.sh3f cannot be read as a zip archive'),
    ('chair', str(tmp_path), r'broken\.sh3f cannot be read'),
  ):
    with pytest.raises(UserError, match=said):
      list_models(category, path, None, 0)


def test_a_library_that_is_gone_when_its_model_is_read(tmp_path):
  piece = Piece('a.obj', '', 'Chair', (), '', ('', '', ''), '', '')
  with pytest.raises(UserError, match=r'gone\.sh3f'):
    load(SourceModel('a', 'chair', path=str(tmp_path / 'gone.sh3f'), detail=piece))


def test_every_category_has_patterns_that_compile():
  for choice in sweethome3d.CATEGORIES.values():
    assert sweethome3d._is_chosen(Piece('', '', 'x', (), '', ('', '', ''), '', ''), choice) is False
