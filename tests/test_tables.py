"""Means, errors and comparisons of the paper's tables, by hand; and the programs around them."""

import json

import numpy as np
import pytest
import synthetic
import workdirs
from absl import flags

from experiments.lib import protocol, stages, tables
from experiments.lib.tables import AVERAGE, Row, Scores
from experiments.paper import ablation
from experiments.paper import iou as table_iou
from experiments.paper import psnr as table_psnr

CAR = Scores(('a', 'b', 'c'), np.array([[0.1, 0.2, 0.3], [0.3, 0.4, 0.5]]))
CHAIR = Scores(('d',), np.array([[0.6], [0.8]]))


def test_a_cell_is_the_mean_over_models_with_their_standard_error():
  mean, error, count = tables.mean_and_error(CAR)
  assert (mean, count) == (pytest.approx(0.3), 3)
  assert error == pytest.approx(0.1 / np.sqrt(3))  # of 0.2, 0.3, 0.4
  mean, error, count = tables.mean_and_error(CHAIR)
  assert (mean, count) == (pytest.approx(0.7), 1) and np.isnan(error)


def test_a_model_without_a_number_is_left_out():
  scores = Scores(('a', 'b'), np.array([[np.nan, 0.5]]))
  mean, error, count = tables.mean_and_error(scores)
  assert (mean, count) == (0.5, 1) and np.isnan(error)


def test_the_average_is_that_of_categories_and_told_by_seed():
  row = Row('ours', {'car': CAR, 'chair': CHAIR}, {})
  np.testing.assert_allclose(tables.seed_means(row), [(0.2 + 0.6) / 2, (0.4 + 0.8) / 2])


def test_markdown_puts_the_published_number_beside_ours():
  one_seed = {'car': CAR._replace(values=CAR.values[:1])}
  text = tables.to_markdown([Row('ours', one_seed, {'car': 0.395, AVERAGE: 0.298})], '.3f')
  assert '| ours | 0.200 ± 0.058 [0.395] | 0.200 [0.298] |' in text
  assert '| test models | 3 |  |' in text
  both = tables.to_markdown([Row('ours', {'car': CAR}, {})], '.2f')
  assert '0.30 (seeds: 0.14)' in both


def test_methods_are_compared_model_by_model():
  other = Row('other', {'car': CAR, 'chair': CHAIR}, {})
  better = Row(
    'ours', {c: s._replace(values=s.values + 0.125) for c, s in other.scores.items()}, {}
  )
  found = tables.compare(better, other)
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
  assert tables.to_line(found, '.3f') == (
    'ours - other: +0.125 ± 0.000 over 4 models, median +0.125, above in 100%;'
    ' by seed +0.125, +0.125'
  )


def test_one_model_has_no_error():
  one = {'chair': CHAIR._replace(values=CHAIR.values[:1])}
  found = tables.compare(Row('a', one, {}), Row('b', one, {}))
  assert (found.error, found.models, found.above, found.seeds) == (0, 1, 0, [])


def test_json_has_no_nan():
  row = Row('ours', {'chair': CHAIR}, {'chair': 0.18})
  found = json.loads(json.dumps(tables.to_json([row]), allow_nan=False))[0]
  assert found['categories']['chair'] == {
    'mean': pytest.approx(0.7),
    'error': None,
    'models': 1,
    'seeds': [0.6, 0.8],
    'published': 0.18,
  }


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

  def evaluate(plan, method, category, seed, *, split='test', threshold=None):
    asked.append((method, category, seed, split, threshold))
    return report(len(method), split)

  monkeypatch.setattr(tables.protocol, 'evaluate', evaluate)
  monkeypatch.setattr(tables.protocol, 'categories', lambda _: ['car', 'chair'])
  return asked


@pytest.mark.parametrize(
  ('program', 'name', 'arguments'),
  [(table_iou, 'iou', []), (table_psnr, 'psnr', ['--methods=flow,blended_0.2'])],
)
def test_programs_print_and_write_the_tables(program, name, arguments, evaluated, tmp_path, capsys):
  f = flags.FlagValues()
  program.define_flags(f)
  data = synthetic.make_dataset(tmp_path / 'data', 3, image_size=32, grid_size=16).root
  f(
    [
      'program',
      f'--data={data}',
      f'--workdir={tmp_path}',
      '--models=all',
      '--seeds=0,1',
      *arguments,
    ]
  )
  program.run(f)
  told = capsys.readouterr().out
  assert {(c, s) for _, c, s, *_ in evaluated} == {('all', '0'), ('all', '1')}
  table = json.loads((tmp_path / 'tables' / f'{name}.json').read_text())
  assert '- networks: one for all categories [one a category]' in told
  assert table['differences']['networks'] == 'one for all categories'
  if name == 'iou':
    assert {t for *_, t in evaluated} == {'paper', 'val'}
    assert '| Ours (MSFCEL) | 6.250 ± 0.000 [0.395] |' in told
    assert '| Mean training shape | 0.500 ± 0.000 |' in told
    assert 'Ours (MSFCEL) - Adapted R2N2: +2.000 ± 0.000 over 3 models' in told
    assert table['val']['rows'][0]['average'] == {'seeds': [4.25, 4.25], 'published': 0.235}
  else:
    assert '| Ours (α = 0.2) | 11.25 ± 0.00 [10.881] |' in told
    assert table['psnr_ycbcr']['rows'][1]['categories']['chair']['published'] == 22.750
    assert table['psnr_rgb']['comparisons'][0]['difference'] == 7
  assert table['runs']['msfcel_all_0']['batch_size'] == 2 and table['argv'] == stages.argv()


def test_the_ablation_tells_gains_on_val_and_test(evaluated, tmp_path, capsys):
  f = flags.FlagValues()
  ablation.define_flags(f)
  data = synthetic.make_dataset(tmp_path / 'data', 3, image_size=32, grid_size=16).root
  f(['program', f'--data={data}', f'--workdir={tmp_path}', '--models=all'])
  ablation.run(f)
  told = capsys.readouterr().out
  assert {s for *_, s, _ in evaluated} == {'val', 'test'}
  # The fake numbers are the length of a method's name, plus a quarter.
  assert '| paper | 11.250 | 11.25 | 11.250 | 11.25 |' in told
  assert '| + threshold chosen on val | 14.250 (+27%) | 14.25 (+3.00 dB) |' in told
  assert 'IoU: best - paper: -7.000 ± 0.000 over 3 models, median -7.000, above in 0%' in told
  table = json.loads((tmp_path / 'tables' / 'ablation.json').read_text())
  assert len(table['test']['psnr_rgb']['rows']) == len(ablation.STEPS)
  (comparison,) = table['test']['iou']['comparisons']
  assert (comparison['better'], comparison['difference']) == ('best', -7)
  assert table['val']['iou']['comparisons'] == []


def test_a_model_for_each_category_is_judged_by_its_own(evaluated, tmp_path):
  f = flags.FlagValues()
  table_iou.define_flags(f)
  f(['program', '--data=D', f'--workdir={tmp_path}'])
  results = tables.evaluate(protocol.read_flags(f), 'msfcel')
  found = tables.select(results, 'iou')
  assert [(m, c) for m, c, *_ in evaluated] == [('msfcel', 'car'), ('msfcel', 'chair')]
  assert found['car'].models == ('a', 'b') and found['chair'].models == ('c',)
  np.testing.assert_allclose(found['car'].values, [[6.25, 6.25]])
