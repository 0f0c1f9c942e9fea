"""Costs on many devices: counts against sums by hand."""

import pytest

from experiments.perf import scaling


@pytest.fixture(scope='module')
def costs():
  return {n: scaling.count('shape', n) for n in (64, 128)}


def test_counts_of_the_shape_network(costs):
  cost = costs[64]
  conv2d = [(7, 3, 64), (5, 64, 64), (5, 64, 128), (3, 128, 128), (3, 128, 256)]
  kernels = sum(s * s * i * o for s, i, o in conv2d) + 4096 * 512 + 512 * 512 + 512 * 8192
  kernels += 27 * (128 * 64 + 64 * 32 + 32 * 32 + 32 * 24 + 24)
  channels = 64 + 64 + 128 + 128 + 256 + 512 + 512 + 8192 + 64 + 32 + 32 + 24 + 1
  assert cost.parameters == kernels + 3 * channels  # bias, and gamma and beta of the norm
  assert cost.reduced == 4 * (cost.parameters + 4 * channels)
  assert cost.state == 4 * (3 * cost.parameters + 2 * channels + 3)  # three counts of steps
  assert cost.operations == pytest.approx(7.3e9, rel=0.01)
  assert cost.sample == 4 * 128**2 + 3 * 8192


def test_finer_grids(costs):
  assert 6 < costs[128].operations / costs[64].operations < 8
  assert costs[128].parameters - costs[64].parameters == (512 + 3) * 128 * (8**3 - 4**3)


def test_efficiency():
  assert scaling.efficiency(30, 2, 10, 3) == 0.5
  assert scaling.efficiency(30, 1, 10, 3) == 1


def test_the_program_prints_tables(capsys):
  scaling.main(['--grid_size=64', '--seconds=1'])
  out = capsys.readouterr().out
  assert '| shape | 64^3 | 7.7 M |' in out and '| 256 devices |' in out
