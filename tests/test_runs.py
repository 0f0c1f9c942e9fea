"""Which run is this? What is there is reused only where it is what is asked for, field by field."""

import json
import os
import shutil

import leavings
import pytest
import synthetic

from cvn import dataset
from cvn.errors import UserError
from experiments.lib import cli, protocol, results, training
from experiments.paper import iou as table_iou

COMMON = ('--models=all', '--epochs=16', '--batch_size=2', '--learning_rate=1e-3', '--dtype=mixed')


def plan(*arguments):
  return protocol.read_flags(cli.parse(protocol.define_flags, arguments))


@pytest.fixture
def commands(monkeypatch):
  return leavings.without_programs(monkeypatch)


@pytest.fixture(scope='module')
def data(tmp_path_factory):
  return leavings.make_data(tmp_path_factory.mktemp('data') / 'A')


@pytest.fixture
def used(data, tmp_path, commands):
  """The flags of a workdir with scores of a method, and the programs that were run for them."""
  given = (f'--data={data}', f'--workdir={tmp_path / "W"}', *COMMON)
  results.evaluate(plan(*given), 'blended_0.2')
  assert [p for p, _ in commands] == ['train', 'train', 'evaluate']
  commands.clear()
  return given, commands


def ask(*arguments, method='blended_0.2', **options):
  return results.evaluate(plan(*arguments), method, **options)


def test_the_same_again_runs_nothing(used):
  given, commands = used
  first, second = ask(*given), ask(*given)
  assert first == second and commands == []


CHANGED = {
  '--batch_size=4': 'batch_size=2, not 4',
  '--learning_rate=3e-4': 'learning_rate=0.001, not 0.0003',
  '--dtype=float32': 'dtype=mixed, not float32',
  '--epochs=8': 'epochs=16, not 8',
  '--quick': 'epochs=16, not 1',
  '--fresh_statistics=20': 'fresh_statistics=0, not 20',
  '--category=car': 'data_digest=.* not ',  # of the models to train on
}


@pytest.mark.parametrize(('changed', 'message'), CHANGED.items())
def test_a_run_of_other_flags_is_an_error_that_names_the_field(used, changed, message):
  given, commands = used
  with pytest.raises(UserError, match=f'msfcel_all_0 was .*{message}') as found:
    ask(*given, changed)
  assert 'name another --workdir, or delete' in str(found.value)
  assert commands == []


def test_other_data_of_the_same_size_is_an_error(used, tmp_path):
  given, commands = used
  other = leavings.make_data(tmp_path / 'B', split='val')
  with pytest.raises(UserError, match=r'data_digest=\w+ \(.*/A/\), not \w+ \(.*/B/\)'):
    ask(*given, f'--data={other}')
  assert commands == []


def test_other_test_models_are_an_error_of_the_scores(used, tmp_path):
  """The networks are the ones asked for; what they were evaluated on is not."""
  given, commands = used
  grown = dataset.open_dataset(leavings.make_data(tmp_path / 'B'))
  grown = dataset.extend(grown, [grown.manifest.models[5]._replace(id='new')])
  record = synthetic.make_record(99, azimuths=(0, 90), image_size=32, grid_size=16)
  dataset.write_record(grown.arrays, 14, record)
  with pytest.raises(UserError, match=r'blended_0\.2_all_0_test\.json was made with data_digest='):
    ask(*given, f'--data={grown.root}')
  assert commands == []


def test_moved_data_is_the_same_data(used, tmp_path):
  given, commands = used
  ask(*given, f'--data={leavings.make_data(tmp_path / "elsewhere")}')
  assert commands == []


@pytest.mark.parametrize(
  ('changed', 'ran'),
  [
    ('--seeds=1', ['train', 'train', 'evaluate']),
    ('--models=category', ['train', 'train', 'evaluate'] * 2),
    ('--threshold=val', ['evaluate']),
    ('--source=synthetic', ['evaluate']),
    ('--epochs=17', ['train', 'train', 'evaluate']),  # goes on, and is evaluated anew
  ],
)
def test_what_has_a_place_of_its_own_is_made(used, changed, ran):
  given, commands = used
  (before,) = ask(*given)
  found = ask(*given, changed)
  assert [p for p, _ in commands] == ran
  assert before not in found


def test_sources_to_train_on_are_compared(used):
  given, commands = used
  with pytest.raises(UserError, match=r"source=\[\], not \['synthetic'\]"):
    ask(*given, '--train_source=synthetic')
  assert commands == []


@pytest.mark.parametrize(
  ('part', 'value', 'name'),
  [
    ('recipe', 'release', 'recipe'),
    ('shape_loss', 'cross_entropy', 'shape_loss'),
    ('mirror', 'true', 'mirror'),
    ('recolor', 'true', 'recolor'),
    ('schedule', 'staircase', 'schedule'),
    ('sample', 'nearest', 'sample'),
    ('surface_distance', 'l1', 'surface_distance'),
    ('heads', 'surface', 'heads'),
    ('network', 'color', 'network'),
  ],
)
def test_a_training_that_has_changed_since_is_an_error(used, monkeypatch, part, value, name):
  """As where a method's trainings are edited, or a recipe."""
  given, commands = used
  changed = protocol.TRAININGS['msfcel'] | {part: value}
  monkeypatch.setitem(protocol.TRAININGS, 'msfcel', changed)
  with pytest.raises(UserError, match=rf'msfcel_all_0 was made with {name}='):
    ask(*given)
  assert commands == []


def test_a_recipe_that_has_changed_under_its_name_is_another_one(used, monkeypatch):
  given, _ = used
  recipe = training.RECIPES['paper']._replace(kernel_penalty=1e-3)
  monkeypatch.setitem(training.RECIPES, 'paper', recipe)
  with pytest.raises(UserError, match=r'kernel_penalty=0\.0, not 0\.001'):
    ask(*given)


def test_a_recipe_given_by_its_own_number_is_the_same(data, tmp_path, commands):
  given = (f'--data={data}', f'--workdir={tmp_path}', '--models=all', '--batch_size=2')
  for more in ((), ('--learning_rate=3e-4',)):
    ask(*given, *more, method='msfcel')
  assert [p for p, _ in commands] == ['train', 'evaluate']


@pytest.mark.parametrize(('part', 'value'), [('alpha', 0.4), ('flip', True), ('carve', True)])
def test_scores_of_other_options_are_an_error(used, monkeypatch, part, value):
  given, commands = used
  changed = protocol.METHODS['blended_0.2']._replace(**{part: value})
  monkeypatch.setitem(protocol.METHODS, 'blended_0.2', changed)
  with pytest.raises(UserError, match=rf'blended_0\.2_all_0_test\.json was made with {part}='):
    ask(*given)
  assert commands == []


def test_scores_are_compared_whatever_their_age(used, tmp_path):
  given, commands = used
  path = tmp_path / 'W/scores/blended_0.2_all_0_test.json'
  os.utime(path, (1, 1))
  ask(*given)
  assert commands == []
  report = json.loads(path.read_text())
  report['options']['runs']['color']['step'] = 3  # of an earlier checkpoint
  path.write_text(json.dumps(report))
  ask(*given)
  assert [p for p, _ in commands] == ['evaluate']


def test_networks_that_were_deleted_and_trained_otherwise_are_evaluated_anew(used, tmp_path):
  given, commands = used
  for name in ('msfcel_all_0', 'blended_all_0'):
    shutil.rmtree(tmp_path / 'W/runs' / name)
  ask(*given, '--dtype=float32')
  assert [p for p, _ in commands] == ['train', 'train', 'evaluate']


@pytest.mark.parametrize('text', ['[]', '{"networks": {}}', '{'])
def test_scores_that_do_not_tell_their_options_are_an_error(used, tmp_path, text):
  given, commands = used
  path = tmp_path / 'W/scores/blended_0.2_all_0_test.json'
  path.write_text(text)
  with pytest.raises(UserError, match=r'blended_0\.2_all_0_test\.json .*again'):
    ask(*given)
  assert commands == []


def test_headers_are_those_of_the_networks_and_models_behind_the_numbers(used, tmp_path, capsys):
  """The flags of the printing program say 16 epochs of batches of 2; so do the stored runs."""
  given, _ = used
  table_iou.main([*given, '--methods=msfcel'])
  table = json.loads((tmp_path / 'W/tables/iou.json').read_text())
  assert table['differences'] == {
    'models to train on': '5 car (synthetic), 5 chair (synthetic)',
    'models to test on': '1 chair (synthetic), 1 car (synthetic)',
    'networks': 'one for all categories',
    'epochs': '16',
    'batch': '2',
    'learning rate': '0.001',
    'arithmetic': 'mixed',
  }
  assert table['runs']['msfcel_all_0']['epochs'] == 16
  assert '- epochs: 16 [500]' in capsys.readouterr().out
