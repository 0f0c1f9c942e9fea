"""The program that makes the experiments' data: what it asks of datagen.generate, and its lists."""

import pytest

from cvn.errors import UserError
from datagen.sources import SourceModel
from datagen.sources.furniture_catalogue import Piece
from datagen.splits import read_splits
from experiments import collection as program
from experiments.lib import stages


@pytest.fixture
def asked(monkeypatch):
  """The programs that are run, not run; data sets are there after their first."""
  lines, made = [], set()

  def run_program(folder, name, **named):
    del folder
    assert name == 'datagen.generate'
    lines.append(named)
    made.add(named['output'])

  monkeypatch.setattr(program, 'run_program', run_program)
  monkeypatch.setattr(program, 'read_json', lambda url, _: 1 if url in made else None)
  monkeypatch.setattr(program, 'to_url', str)
  return lines


def test_real_and_procedural_models_share_a_data_set_and_people_have_their_own(
  asked, monkeypatch, tmp_path
):
  places = {'chair0': 'tall_chair_0/x.obj', 'chair1': 'tall_chair_1/x.obj', 'bench': 'bench/x.obj'}
  pieces = [
    SourceModel(name, 'chair', detail=Piece(model, name, name, (), '', ('', '', ''), '', ''))
    for name, model in places.items()
  ]
  more = [SourceModel(f'human-1-{i}', 'human', detail=None) for i in range(30)]
  models = {('sweethome3d', None, 0): pieces, ('humans', 30, 1): more}
  monkeypatch.setattr(
    program, 'list_models', lambda source, _, __, limit, seed: models[source, limit, seed]
  )
  program.main(
    ['--sweethome3d=LIBRARIES', '--humans=W.whl', '--procedural=5', f'--output={tmp_path}']
  )
  assert [x['source'] for x in asked] == ['sweethome3d', 'procedural', 'humans', 'humans']
  assert [x['append'] for x in asked] == ['false', 'true', 'false', 'true']
  assert [(x.get('limit'), x.get('seed')) for x in asked[1:]] == [(5, None), (300, None), (30, 1)]
  objects, people = f'{tmp_path}/objects', f'{tmp_path}/people'
  assert [x['output'] for x in asked] == [objects, objects, people, people]
  assert read_splits(asked[-1]['splits'], 'human') == {m.id: 'val' for m in more}
  lists = read_splits(str(tmp_path / 'splits'), 'chair')
  assert lists['chair0'] == lists['chair1'] != lists['bench']
  assert stages.read_json(str(tmp_path / 'collection.json')) == {'argv': stages.argv()}


def test_nothing_to_make_is_said(asked, tmp_path):
  with pytest.raises(UserError, match='nothing to make'):
    program.main(['--procedural=0', f'--output={tmp_path}'])
  assert asked == []
