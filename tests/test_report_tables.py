"""The report's tables: numbers beside the paper's, the best ones, and what is said of them."""

import math

import pytest

from cvn.evaluation.intervals import Estimate
from experiments.lib.tables import Comparison
from experiments.report import tables as report_tables
from experiments.report.blocks import Cell, Items, Table
from experiments.report.results import Line, Lines, Number

NAN = math.nan


def line(title, car, chair, published=(NAN, NAN, NAN), seeds=None):
  """A method judged on 9 cars and 7 chairs."""
  numbers = {
    'car': Number(car, 0.01, 9, published[0]),
    'chair': Number(chair, NAN, 7, published[1]),
  }
  return Line(title, numbers, seeds or [(car + chair) / 2], published[2])


OURS = line('Ours', 0.3, 0.2, (0.395, 0.18, 0.298))
OTHER = line('Other', 0.1, 0.5, (0.4, 0.17, 0.28))
TRIVIAL = line('Mean', 0.2, 0.1)


def test_numbers_stand_beside_the_papers_and_the_best_are_bold():
  table, said = report_tables.methods_table(Lines([OURS, OTHER, TRIVIAL], []), '.3f', 'IoU')
  assert table.groups == [('car (9)', 2), ('chair (7)', 2), ('avg.', 2)]
  assert list(table.columns) == ['here', 'paper'] * 3
  cells = dict(table.rows)
  assert cells['Ours'] == [
    Cell('0.300', '± 0.010', True),
    Cell('0.395'),
    Cell('0.200'),
    Cell('0.180', best=True),
    Cell('0.250'),
    Cell('0.298', best=True),
  ]
  assert [c.text for c in cells['Mean']] == ['0.200', '–', '0.100', '–', '0.150', '–']
  assert list(said.lines) == ['Order of the methods: Other > Ours; in the paper: Ours > Other.']


def test_equal_numbers_are_all_the_best():
  rows = [line('a', 0.3001, 0.2), line('b', 0.3002, 0.1)]
  (table,) = report_tables.methods_table(Lines(rows, []), '.3f', '')
  assert [cells[0].best for _, cells in table.rows] == [True, True]
  assert table.columns == ['here'] * 3  # no column for a paper that says nothing


def test_a_category_that_a_method_lacks_is_a_dash():
  lacking = OTHER._replace(categories={'car': OTHER.categories['car']})
  table, _ = report_tables.methods_table(Lines([OURS, lacking], []), '.3f', '')
  assert table.rows[1][1][2] == Cell('–')


def test_seeds_are_told_by_one_in_one_category_and_as_spread_in_several():
  several = line('a', 0.3, 0.2, seeds=[0.2, 0.3])
  (table,) = report_tables.methods_table(Lines([several], []), '.2f', '')
  assert table.rows[0][1][-1] == Cell('0.25', '± 0.07', True)
  chairs = several._replace(categories={'chair': several.categories['chair']})
  (table,) = report_tables.methods_table(Lines([chairs], []), '.2f', '')
  assert table.groups == [('chair (7)', 1), ('by seed', 2)]
  assert [c.text for c in table.rows[0][1]] == ['0.20', '0.20', '0.30']


def test_few_models_are_told():
  few = OURS._replace(categories={**OURS.categories, 'guitar': Number(0.1, NAN, 1, NAN)})
  said = report_tables.remarks([few], ['car', 'guitar'])
  assert said == ['Test models are few (guitar 1): numbers there say little.']


def test_same_order_as_in_the_paper():
  (said,) = report_tables.remarks([OURS, line('Low', 0.1, 0.1, (0, 0, 0.1))], ['car'])
  assert said == 'The order of the methods is the paper’s: Ours > Low.'


@pytest.mark.parametrize(
  ('difference', 'error', 'verdict'),
  [(0.03, 0.01, 'above'), (-0.03, 0.01, 'below'), (0.02, 0.01, 'not told apart')],
)
def test_differences_say_whether_they_are_more_than_chance(difference, error, verdict):
  compared = Comparison('Ours', 'Other', difference, error, 16, 0.125, 0.75, [])
  (table,) = report_tables.differences_table([compared], '.3f')
  ((label, cells),) = table.rows
  assert label == '− Other' and cells[1] == Cell('', verdict)
  assert cells[0] == Cell(f'{difference:+.3f}'.replace('-', '−'), '± 0.010')
  assert [c.text for c in cells[2:]] == ['+0.125', '75 %', '16']
  assert table.groups == []


def test_the_ablation_tells_gains_over_the_first_line():
  steps = Lines([line('paper', 0.2, 0.2), line('+ x', 0.25, 0.2)], [])
  gain = Comparison('best', 'paper', 0.03, 0.01, 16, 0.02, 0.75, [])
  table, compared = report_tables.ablation_table(
    {'val iou': steps, 'test psnr_rgb': steps._replace(comparisons=[gain])}, 'steps'
  )
  mean = (0.25 * 9 + 0.2 * 7) / 16
  assert [c.text for c in table.rows[1][1]] == [f'{mean:.3f}', f'{mean:.2f}']
  assert [c.detail for c in table.rows[1][1]] == ['+14%', '+0.03']
  assert [c.detail for c in table.rows[0][1]] == ['', '']
  assert compared.rows[0][0] == 'PSNR RGB, dB'


def test_an_estimate_and_its_interval():
  assert report_tables.estimate_cell(Estimate(0.5, 0.25, 0.75), '.2f') == Cell(
    '0.50', '[0.25, 0.75]'
  )
  assert report_tables.estimate_cell(Estimate(0.5, NAN, NAN), '.2f') == Cell('0.50')
  assert report_tables.estimate_cell(Estimate(NAN, NAN, NAN), '.2f') == Cell('–')


def test_without_anything_to_say_there_is_only_the_table():
  blocks = report_tables.methods_table(Lines([TRIVIAL], []), '.3f', '')
  assert [type(b) for b in blocks] == [Table]
  assert not any(isinstance(b, Items) for b in blocks)
