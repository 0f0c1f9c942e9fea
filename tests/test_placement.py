"""How models stand, and the table that says so of single ones."""

import numpy as np
import pytest
import trimesh
from solids import textured

from cvn.errors import UserError
from datagen.placement import TABLE, UPS, read_table, stand_up, with_metadata
from datagen.sources import SourceModel

MODELS = [SourceModel(id, 'car') for id in ('a', 'b', 'c')]


@pytest.mark.parametrize('up', UPS)
@pytest.mark.parametrize('turn', [0, 90, -30])
def test_what_points_up_does_so_then_and_nothing_is_mirrored(up, turn):
  axis = np.zeros(3)
  axis['xyz'.index(up[-1])] = -1 if up[0] == '-' else 1
  box = trimesh.creation.box((1, 1, 1))
  box.apply_translation(3 * axis)
  mesh = stand_up(textured(box), up, turn)
  np.testing.assert_allclose(mesh.vertices[np.unique(mesh.faces)].mean(0), [0, 3, 0], atol=1e-9)
  assert trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).volume == pytest.approx(1)


@pytest.mark.parametrize(
  ('up', 'turn', 'front'),
  [
    ('y', 180, [0, 0, -1]),
    ('y', -90, [1, 0, 0]),
    ('y', 90, [-1, 0, 0]),
    ('z', 0, [0, -1, 0]),  # as in Blender, whose models face -y
    ('z', 180, [0, 1, 0]),
  ],
)
def test_what_was_the_front_faces_the_viewer_then(up, turn, front):
  box = trimesh.creation.box((1, 1, 1))
  box.apply_translation(front)
  mesh = stand_up(textured(box), up, turn)
  np.testing.assert_allclose(mesh.vertices[np.unique(mesh.faces)].mean(0), [0, 0, 1], atol=1e-9)


def test_what_stands_already_is_not_touched():
  mesh = textured(trimesh.creation.box())
  assert stand_up(mesh, 'y', 0.0) is mesh


def test_the_table_goes_before_the_flags(tmp_path):
  (tmp_path / TABLE).write_text('id, up, turn, creator\nb, z, 90, Anna\nc,,,\nother,x,,\n')
  flags = {'up': 'x', 'split': 'test', 'licence': 'CC0', 'creator': 'Bob'}
  a, b, c = with_metadata(MODELS, input_dir=str(tmp_path), **flags)
  assert a == c._replace(id='a')
  assert (a.up, a.turn, a.split, a.licence, a.creator) == ('x', 0.0, 'test', 'CC0', 'Bob')
  assert (b.up, b.turn, b.split, b.licence, b.creator) == ('z', 90.0, 'test', 'CC0', 'Anna')


def test_without_a_word_models_stay_as_they_are(tmp_path):
  models = [MODELS[0]._replace(licence='own', split='val')]
  assert with_metadata(models, input_dir=str(tmp_path)) == models
  assert with_metadata(models, licence='CC0')[0].licence == 'own'


@pytest.mark.parametrize(
  ('text', 'reason'),
  [
    ('name,up\na,z\n', 'must name the column id'),
    ('id,upp\na,z\n', "not 'upp'"),
    ('', 'must name the column id'),
    ('id,up\na,w\n', "line 2: up is 'w'"),
    ('id,turn\na,left\n', "line 2: turn is 'left'"),
    ('id,turn\na,nan\n', "line 2: turn is 'nan'"),
    ('id,split\na,all\n', "line 2: split is 'all'"),
    ('id,up\na,z\na,z\n', 'line 3: a appears twice'),
    ('id,up\n,z\n', 'line 2: the id is missing'),
    ('id,up\nx,z\n', 'names none of the models: it has x, the folder has a'),
  ],
)
def test_tables_that_are_wrong(tmp_path, text, reason):
  (tmp_path / 't.csv').write_text(text)
  with pytest.raises(UserError, match=reason):
    with_metadata(MODELS, table=str(tmp_path / 't.csv'))


def test_tables_that_cannot_be_read(tmp_path):
  with pytest.raises(UserError, match='cannot be read'):
    read_table(str(tmp_path / 'gone.csv'))
  (tmp_path / 'a.csv').write_bytes(b'id\xff')
  with pytest.raises(UserError, match='cannot be read'):
    read_table(str(tmp_path / 'a.csv'))
