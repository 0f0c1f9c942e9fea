"""Figures as text."""

import pytest

from experiments.perf import layers, measuring, texts


def test_median_and_range():
  found = texts.spread([0.03, 0.01, 0.02])
  assert found == {'median': 0.02, 'low': 0.01, 'high': 0.03}
  assert texts.show(found, 1e3) == '20.00 (10.00 to 30.00)'


def test_a_machine_without_kernels_and_a_limit():
  machine = {
    'processor': 'Abacus',
    'cores': 2,
    'devices': '1 x cpu',
    'compiled kernels': None,
    'versions': {'jax': '1', 'flax': '2'},
    'settings': {},
  }
  line = 'Abacus, 2 cores; 1 x cpu; no compiled kernels; jax 1, flax 2'
  assert texts.describe(machine, {}) == line
  assert texts.describe(machine, {'A': 'x', 'B': 'y'}) == f'{line}\nlimit: A=x B=y'


def test_named_tuples_become_dictionaries():
  cost = layers.Cost(1, 2, 3.0, 4.0)
  row = layers.Row('a', (2, 3), 'float32', cost, cost)
  plain = {'operations': 1, 'bytes': 2, 'floor': 3.0, 'seconds': 4.0}
  assert texts.plain(row) == {
    'name': 'a',
    'output': (2, 3),
    'dtype': 'float32',
    'forward': plain,
    'backward': plain,
  }


@pytest.mark.parametrize('theirs, disturbed', [((4.0, 5.0), False), ((5.0, 0.4), True)])
def test_a_disturbed_comparison_is_called_one(capsys, theirs, disturbed):
  ours = [measuring.Steps(9.0, (1.0, 2.0, 3.0), 1 << 30, None)] * 2
  found = texts.report_peer('shape', 20, ours, theirs, tried=5.5)
  assert found['disturbed'] is disturbed
  assert found['ratio']['low'] == 10 / max(theirs) and found['ratio']['high'] == 10 / min(theirs)
  assert ('not a fair comparison: PyTorch had 5.50' in capsys.readouterr().out) is disturbed
