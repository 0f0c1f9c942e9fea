"""What is read of a workdir, and what is said of damaged files."""

import json
import math
import shutil

import markdown_cells
import pytest
import workdirs

from cvn.errors import UserError
from experiments.report import read as report_read
from experiments.report.read import read_workdir, read_workdirs


@pytest.fixture(scope='module')
def given(tmp_path_factory):
  """A folder with a bit of everything."""
  return workdirs.write_all(tmp_path_factory.mktemp('given') / 'work')


def test_reads_everything(given):
  w = read_workdir(str(given))
  assert {*w.tables} == {'iou', 'psnr', 'ablation', 'measures', 'structure'}
  car = w.tables['iou'].parts['val'].lines[0].categories['car']
  assert (car.mean, car.models, car.published) == (pytest.approx(0.35), 2, 0.395)
  assert math.isnan(w.tables['psnr'].parts['psnr_rgb'].lines[0].published)
  assert w.people.source.runs['msfcel_all_0']['category'] == ['human']
  means, by_azimuth, by_complexity = markdown_cells.read(w.people.text)
  assert means[2][1].startswith('0.100 ')  # of the mean training shape
  assert len(by_azimuth) == 1 + 4 and sum(int(r[1]) for r in by_complexity[1:]) == 8
  assert [t.name for t in w.trainings] == ['msfcel_all_0', 'blended_all_0']  # the protocol's order
  assert {*w.figures} == {'people_azimuth', 'random'} and {*w.study} == {'preferences'}
  assert [*w.seconds.values()] == [90]
  assert w.label == 'one network for all categories'


def test_a_training_is_measured_in_views(tmp_path):
  workdirs.write_training(tmp_path, 'msfcel_arm_chair_3')
  (t,) = report_read.read_trainings(str(tmp_path))
  assert (t.training, t.scope, t.seed) == ('msfcel_arm', 'chair', '3')
  assert (t.steps, t.epochs, t.samples) == (4, 2, 8)
  assert t.logged == [(2 * n, {'loss': 1 / n}) for n in (1, 2, 3, 4)]
  assert t.validation == [(8, {'loss': 0.5, 'iou': 0.125})]


def test_a_line_that_is_being_written_is_left_out(tmp_path):
  workdirs.write_training(tmp_path)
  with open(tmp_path / 'runs/msfcel_all_0/log.jsonl', 'a') as f:
    f.write('{"step": 5, "ep')
  (t,) = report_read.read_trainings(str(tmp_path))
  assert t.steps == 4


@pytest.mark.parametrize('seeds', [1, 3])
def test_comparisons_are_those_of_the_tables(seeds, tmp_path):
  workdirs.write_tables(tmp_path, seeds=seeds)
  written = json.loads((tmp_path / 'tables/iou.json').read_text())['parts']['val']['comparisons']
  found = report_read.read_table(str(tmp_path / 'tables/iou.json')).parts['val'].comparisons
  assert [c._asdict() for c in found] == written
  assert len(found[0].seeds) == (0 if seeds == 1 else 3)


def test_scores_tell_the_networks_of_methods(tmp_path):
  report = {
    **{'data': 'D', 'split': 'test', 'shape': 'S', 'color': None, 'threshold': 0.5, 'alpha': 0.2},
    'networks': {'by_model': {'m': {'category': 'car'}}},
    'options': {'runs': {'shape': {'step': 4}}},
  }
  for name in ('blended_0.2_all_0_test', 'best_0.6_all_0_test_val', 'other_all_0_test'):
    workdirs.write_json(tmp_path / f'{name}.json', report)
  workdirs.write_json(tmp_path / 'msfcel_all_0_val.json', report | {'split': 'val'})
  found = {p.stem: report_read.read_score(str(p)) for p in tmp_path.iterdir()}
  assert found['blended_0.2_all_0_test'].method == 'blended_0.2'
  assert found['best_0.6_all_0_test_val'] == (
    *('best', 'D', 'S', '', 0.5, 0.2),
    *({'m': 'car'}, {'shape': {'step': 4}}),
  )
  assert found['other_all_0_test'] is None and found['msfcel_all_0_val'] is None


DAMAGE = {
  'tables/iou.json': ['{"paper": ', '[]', '{}', 'null'],
  'tables/psnr.json': [json.dumps(workdirs.source())],
  'tables/people.json': ['{}'],
  'runs/msfcel_all_0/config.json': ['', '{"batch_size": 0, "models": 4}', '{"batch_size": 9}'],
  'runs/msfcel_all_0/log.jsonl': ['{"step"\n{}\n', '[1]\n', '{"step": 1, "loss": "x"}\n'],
  'figures/random.png': ['', 'no picture'],
  'figures/random.json': ['{', '3'],
  'seconds.json': ['[1]', '{"a": "b"}'],
}


@pytest.mark.parametrize(('name', 'text'), [(n, t) for n, texts in DAMAGE.items() for t in texts])
def test_a_damaged_file_is_named(name, text, given, tmp_path):
  folder = shutil.copytree(given, tmp_path / 'work')
  (folder / name).write_text(text)
  with pytest.raises(UserError) as found:
    read_workdir(str(folder))
  assert f'{folder / name} is damaged' in str(found.value) and '\n' not in str(found.value)


def test_folders_that_hold_nothing(tmp_path):
  with pytest.raises(UserError, match='is not a folder'):
    read_workdir(str(tmp_path / 'missing'))
  with pytest.raises(UserError, match='holds no results'):
    read_workdir(str(tmp_path))


def test_folders_have_different_names(given, tmp_path):
  paths = [str(shutil.copytree(given, tmp_path / n / 'work')) for n in 'abc']
  first, second, third = read_workdirs([paths[0] + '/', *paths[1:]])
  assert (first.key, second.key, third.key) == ('work', 'work-2', 'work-3')
  alone = read_workdir(paths[0]).label
  assert first.label == f'{alone}, 2 epochs'
  assert (second.label, third.label) == (f'{first.label}-2', f'{first.label}-3')
  with pytest.raises(UserError, match='twice'):
    read_workdirs([paths[0], paths[0] + '/'])


def test_a_folder_is_called_after_the_networks_of_its_tables(tmp_path):
  workdirs.write_training(tmp_path, 'msfcel_all_0')
  workdirs.write_training(tmp_path, 'msfcel_chair_1', category=['chair'], seed=1)
  mixed = 'one network for all categories, a network a category (chair), 2 seeds'
  assert read_workdir(str(tmp_path)).label == mixed
  workdirs.write_tables(tmp_path, category=['chair'], seeds=3)
  assert read_workdir(str(tmp_path)).label == 'a network a category (chair), 3 seeds'
  workdirs.write_training(tmp_path / 'third', 'msfcel_all_0', source=['procedural', 'mine'])
  expected = 'one network for all categories, trained only on procedural models and mine'
  assert read_workdir(str(tmp_path / 'third')).label == expected
  workdirs.write_figure(tmp_path / 'other/figures/random.png')
  assert read_workdir(str(tmp_path / 'other')).label == 'other'
