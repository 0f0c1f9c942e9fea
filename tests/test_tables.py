"""Tables in Markdown: numbers beside the paper's, the best ones bold, and what is said of them."""

import math

import markdown_cells
import pytest

from cvn.evaluation.intervals import Estimate
from experiments.lib import tables
from experiments.lib.results import Comparison, Line, Number, Table

NAN = math.nan


def line(title, car, chair, published=(NAN, NAN, NAN), seeds=None):
  """A method evaluated on 9 cars and 7 chairs."""
  numbers = {
    'car': Number(car, 0.01, 9, published[0]),
    'chair': Number(chair, NAN, 7, published[1]),
  }
  return Line(title, numbers, seeds or [(car + chair) / 2], published[2])


OURS = line('Ours', 0.3, 0.2, (0.395, 0.18, 0.298))
OTHER = line('Other', 0.1, 0.5, (0.4, 0.17, 0.28))
TRIVIAL = line('Mean', 0.2, 0.1)


def make(*lines, comparisons=(), form='.3f'):
  """The tables of `methods_table`, read back."""
  text = tables.methods_table(Table([*lines], [*comparisons]), form, 'IoU')
  return text, markdown_cells.read(text)


def test_numbers_stand_beside_the_papers_and_the_best_are_bold():
  text, (table,) = make(OURS, OTHER, TRIVIAL)
  assert table == [
    ['', 'car (9)', 'paper', 'chair (7)', 'paper', 'avg.', 'paper'],
    ['Ours', '0.300 ± 0.010', '0.395', '0.200', '0.180', '0.250', '0.298'],
    ['Other', '0.100 ± 0.010', '0.400', '0.500', '0.170', '0.300', '0.280'],
    ['Mean', '0.200 ± 0.010', '–', '0.100', '–', '0.150', '–'],
  ]
  bold = {x for x in text.replace('|', '').split() if x.startswith('**0')}
  assert bold == {f'**{x}**' for x in ('0.300', '0.400', '0.500', '0.180', '0.300', '0.298')}


def test_equal_numbers_are_all_the_best():
  text, (table,) = make(line('a', 0.3001, 0.2), line('b', 0.3002, 0.1))
  assert text.count('**0.300**') == 2
  assert 'paper' not in table[0]  # no column for a paper without numbers


def test_a_category_that_a_method_lacks_is_a_dash():
  _, (table,) = make(OURS, OTHER._replace(categories={'car': OTHER.categories['car']}))
  assert markdown_cells.column(table, 'chair (7)') == {'Ours': '0.200', 'Other': '–'}


def test_seeds_have_columns_for_one_category_and_a_spread_for_several():
  several = line('a', 0.3, 0.2, seeds=[0.2, 0.3])
  _, (table,) = make(several, form='.2f')
  assert table[1][-1] == '0.25 ± 0.07'
  chairs = several._replace(categories={'chair': several.categories['chair']})
  _, (table,) = make(chairs, form='.2f')
  assert table == [['', 'chair (7)', 'by seed', 'by seed'], ['a', '0.20', '0.20', '0.30']]


def test_few_models_are_a_remark():
  few = OURS._replace(categories={**OURS.categories, 'guitar': Number(0.1, NAN, 1, NAN)})
  (said,) = tables.remarks([few], ['car', 'guitar'])
  assert 'guitar 1' in said and 'car' not in said


def test_the_order_of_the_methods_is_compared_with_the_papers():
  (same,) = tables.remarks([OURS, line('Low', 0.1, 0.1, (0, 0, 0.1))], ['car'])
  assert same.endswith(': Ours > Low.')
  (other,) = tables.remarks([OURS, OTHER], ['car'])
  assert 'Other > Ours;' in other and other.endswith('Ours > Other.')


@pytest.mark.parametrize(
  ('difference', 'error', 'verdict'),
  [(0.03, 0.01, 'above'), (-0.03, 0.01, 'below'), (0.02, 0.01, 'not told apart')],
)
def test_differences_are_compared_with_chance(difference, error, verdict):
  compared = Comparison('Ours', 'Other', difference, error, 16, 0.125, 0.75, [0.5])
  _, (_, table) = make(OURS, comparisons=[compared])
  number = f'{difference:+.3f}'.replace('-', '−')
  assert table[0][1:] == ['difference', '', 'median', 'above in', 'of models', 'by seed']
  cells = ['− Other', f'{number} ± 0.010', verdict, '+0.125', '75 %', '16', '+0.500']
  assert table[1] == cells


def test_the_ablation_has_gains_over_the_first_line():
  steps = Table([line('paper', 0.2, 0.2), line('+ x', 0.25, 0.2)], [])
  gain = Comparison('best', 'paper', 0.03, 0.01, 16, 0.02, 0.75, [])
  parts = {'val iou': steps, 'test psnr_rgb': steps._replace(comparisons=[gain])}
  table, compared = markdown_cells.read(tables.ablation_table(parts, 'steps'))
  mean = (0.25 * 9 + 0.2 * 7) / 16
  assert table == [
    ['', 'IoU, val', 'PSNR RGB, dB, test'],
    ['paper', '0.200', '0.20'],
    ['+ x', f'{mean:.3f} +14%', f'{mean:.2f} +0.03'],
  ]
  assert compared[1][:2] == ['PSNR RGB, dB', '+0.03 ± 0.01']


def test_an_estimate_and_its_interval():
  def cell(*numbers):
    return tables.estimate_cell(Estimate(*numbers), '.2f').replace('*', '').replace('\\', '')

  assert cell(0.5, 0.25, 0.75) == '0.50 [0.25, 0.75]'
  assert cell(0.5, NAN, NAN) == '0.50'
  assert cell(NAN, NAN, NAN) == '–'
