"""Means, errors and comparisons by hand; the programs of the paper's tables."""

import json

import markdown_cells
import numpy as np
import pytest
import synthetic
import workdirs

from experiments.lib import cli, protocol, results, stages
from experiments.lib.results import AVERAGE, Row, Scores
from experiments.paper import ablation
from experiments.paper import iou as paper_iou
from experiments.paper import psnr as paper_psnr

CAR = Scores(('a', 'b', 'c'), np.array([[0.1, 0.2, 0.3], [0.3, 0.4, 0.5]]))
CHAIR = Scores(('d',), np.array([[0.6], [0.8]]))


def test_a_cell_is_the_mean_over_models_with_their_standard_error():
  mean, error, count = results.mean_and_error(CAR)
  assert (mean, count) == (pytest.approx(0.3), 3)
  assert error == pytest.approx(0.1 / np.sqrt(3))  # of 0.2, 0.3, 0.4
  mean, error, count = results.mean_and_error(CHAIR)
  assert (mean, count) == (pytest.approx(0.7), 1) and np.isnan(error)


def test_a_model_without_a_number_is_left_out():
  scores = Scores(('a', 'b'), np.array([[np.nan, 0.5]]))
  mean, error, count = results.mean_and_error(scores)
  assert (mean, count) == (0.5, 1) and np.isnan(error)


def test_the_average_is_that_of_categories_and_told_by_seed():
  row = Row('ours', {'car': CAR, 'chair': CHAIR}, {})
  np.testing.assert_allclose(results.seed_means(row), [(0.2 + 0.6) / 2, (0.4 + 0.8) / 2])


def test_methods_are_compared_model_by_model():
  other = Row('other', {'car': CAR, 'chair': CHAIR}, {})
  better = Row(
    'ours', {c: s._replace(values=s.values + 0.125) for c, s in other.scores.items()}, {}
  )
  found = results.compare(better, other)
  assert found == (
    'ours',
    'other',
    0.125,
    pytest.approx(0),
    4,
    0.125,
    1,
    pytest.approx([0.125, 0.125]),
  )


def test_one_model_has_no_error():
  one = {'chair': CHAIR._replace(values=CHAIR.values[:1])}
  found = results.compare(Row('a', one, {}), Row('b', one, {}))
  assert (found.error, found.models, found.above, found.seeds) == (0, 1, 0, [])


def test_a_table_comes_back_from_json(tmp_path):
  row = Row('ours', {'chair': CHAIR, 'car': CAR}, {'chair': 0.18, AVERAGE: 0.2})
  table = results.tabulate({'a': row, 'b': row._replace(title='other', published={})}, 'a')
  path = str(tmp_path / 'table.json')
  stages.write_json(path, table)
  found = stages.read_json(path)
  chair = found['lines'][0]['categories']['chair']
  assert chair == {'mean': pytest.approx(0.7), 'error': None, 'models': 1, 'published': 0.18}
  np.testing.assert_equal(results.read_table(found), table)


def test_the_mean_over_models_weights_categories_by_models():
  line = results.summarize(Row('ours', {'chair': CHAIR, 'car': CAR}, {}))
  assert results.mean_over_models(line) == pytest.approx((0.2 + 0.3 + 0.4 + 0.7) / 4)
  assert results.overall(line) == pytest.approx((0.3 + 0.7) / 2)


def report(value, split='test', baseline=0.25):
  """What experiments.evaluate says of two cars and a chair, two views each."""
  models = {'a': 'car', 'b': 'car', 'c': 'chair'}

  def by_model(x):
    metrics = dict.fromkeys(('iou', 'psnr_rgb', 'psnr_ycbcr'))
    return {
      name: {'category': category, 'source': 'mine', **{k: [x, None, x + 0.5] for k in metrics}}
      for name, category in models.items()
    }

  return {
    **{'data': 'D', 'split': split, 'shape': 'runs/msfcel_all_0'},
    'options': {'runs': {'shape': {'step': 4, 'config': workdirs.CONFIG}}},
    'networks': {'by_model': by_model(value)},
    'baselines': {'by_model': by_model(baseline)},
  }


@pytest.fixture
def evaluated(monkeypatch):
  """What is evaluated; methods score the better the longer their names."""
  asked = []

  def evaluate(plan, method, category, seed, *, split='test', threshold=None, measures=False):
    del plan, measures
    asked.append((method, category, seed, split, threshold))
    return report(len(method), split)

  monkeypatch.setattr(protocol, 'evaluate', evaluate)
  monkeypatch.setattr(protocol, 'categories', lambda _: ['car', 'chair'])
  return asked


def run(program, tmp_path, *arguments):
  """Runs a program; returns what it prints as tables, and what it writes."""
  data = synthetic.make_dataset(tmp_path / 'data', 3, image_size=32, grid_size=16).root
  program.main([f'--data={data}', f'--workdir={tmp_path}', '--models=all', *arguments])
  name = program.__name__.rpartition('.')[2]
  return json.loads((tmp_path / 'tables' / f'{name}.json').read_text())


# The fake numbers are the length of a method's name plus a quarter.


def test_table_1_has_both_thresholds_and_the_paper(evaluated, tmp_path, capsys):
  table = run(paper_iou, tmp_path, '--seeds=0,1')
  assert {(c, s) for _, c, s, *_ in evaluated} == {('all', '0'), ('all', '1')}
  assert {t for *_, t in evaluated} == {'paper', 'val'}
  assert table['runs']['msfcel_all_0']['batch_size'] == 2 and table['argv'] == stages.argv()
  assert table['differences']['networks'] == 'one for all categories'
  r2n2, *_ = table['parts']['val']['lines']
  assert (r2n2['seeds'], r2n2['published']) == ([4.25, 4.25], 0.235)
  first, compared, *_ = markdown_cells.read(capsys.readouterr().out)
  assert markdown_cells.column(first, 'car (2)') == {
    'Adapted R2N2': '4.250 ± 0.000',
    'Ours (cross-entropy)': '13.250 ± 0.000',
    'Ours (MSFCEL)': '6.250 ± 0.000',
    'Mean training shape': '0.500 ± 0.000',
  }
  assert markdown_cells.column(first, 'paper')['Ours (MSFCEL)'] == '0.395'
  assert markdown_cells.column(compared, 'difference')['− Adapted R2N2'] == '+2.000 ± 0.000'
  assert markdown_cells.column(compared, 'of models')['− Adapted R2N2'] == '3'


def test_tables_2_and_3_are_of_both_measures(evaluated, tmp_path):
  parts = run(paper_psnr, tmp_path, '--methods=flow,blended_0.2')['parts']
  flow, ours, trivial = parts['psnr_ycbcr']['lines']
  assert ours['categories']['chair']['published'] == 22.750
  assert (flow['categories']['car']['mean'], trivial['categories']['car']['mean']) == (4.25, 0.5)
  assert parts['psnr_rgb']['comparisons'][0]['difference'] == 7


def test_the_ablation_has_val_and_test(evaluated, tmp_path, capsys):
  parts = run(ablation, tmp_path)['parts']
  assert {s for *_, s, _ in evaluated} == {'val', 'test'}
  assert len(parts['test psnr_rgb']['lines']) == len(ablation.STEPS)
  (comparison,) = parts['test iou']['comparisons']
  assert (comparison['better'], comparison['difference']) == ('best', -7)
  assert parts['val iou']['comparisons'] == []
  table, _ = markdown_cells.read(capsys.readouterr().out)
  first = {c: markdown_cells.column(table, c) for c in ('IoU, val', 'PSNR RGB, dB, val')}
  assert first['IoU, val']['+ threshold chosen on val'] == '14.250 +27%'
  assert first['PSNR RGB, dB, val']['+ threshold chosen on val'] == '14.25 +3.00'


def test_a_model_for_each_category_is_evaluated_on_its_own(evaluated, tmp_path):
  f = cli.parse(protocol.define_flags, data='D', workdir=tmp_path)
  found = results.select(results.evaluate(protocol.read_flags(f), 'msfcel'), 'iou')
  assert [(m, c) for m, c, *_ in evaluated] == [('msfcel', 'car'), ('msfcel', 'chair')]
  assert found['car'].models == ('a', 'b') and found['chair'].models == ('c',)
  np.testing.assert_allclose(found['car'].values, [[6.25, 6.25]])
