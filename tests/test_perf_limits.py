"""Limits on the instruction set: which variables they set, where, and that they hold."""

import os

import pytest

from cvn.errors import UserError
from cvn.ops import compile as compiling
from experiments.perf import limits, measuring


def test_no_limit():
  assert limits.find_variables('none') == {}


@pytest.mark.parametrize(
  'limit, usable, target',
  [
    ('avx2', ['x86-64-v3'], 'x86-64-v3'),
    ('avx2', ['sapphirerapids', 'x86-64-v4-bf16', 'x86-64-v4', 'x86-64-v3'], 'x86-64-v3'),
    ('avx512', ['x86-64-v4', 'x86-64-v3'], 'x86-64-v4'),
    ('avx512', ['sapphirerapids', 'x86-64-v4-bf16', 'x86-64-v4', 'x86-64-v3'], 'x86-64-v4-bf16'),
  ],
)
def test_kernels_are_built_for_the_best_set_within_the_limit(monkeypatch, limit, usable, target):
  monkeypatch.setattr(compiling, 'usable_targets', lambda: usable)
  found = limits.find_variables(limit)
  assert found['CVN_TARGET'] == target
  assert target in compiling.TARGETS
  assert {'ATEN_CPU_CAPABILITY', 'ONEDNN_MAX_CPU_ISA', 'XLA_FLAGS'} < found.keys()


@pytest.mark.parametrize('usable', [[], ['aarch64'], ['x86-64-v3']])
def test_a_processor_without_the_instructions(monkeypatch, usable):
  monkeypatch.setattr(compiling, 'usable_targets', lambda: usable)
  with pytest.raises(UserError, match='does not have these instructions'):
    limits.find_variables('avx512')


def test_variables_are_set_for_a_block(monkeypatch):
  monkeypatch.setenv('XLA_FLAGS', '--a=1')
  monkeypatch.setenv('ONEDNN_MAX_CPU_ISA', 'SSE41')
  monkeypatch.delenv('CVN_TARGET', raising=False)
  before = dict(os.environ)
  variables = {'XLA_FLAGS': '--b=2', 'ONEDNN_MAX_CPU_ISA': 'AVX2', 'CVN_TARGET': 'x'}
  with limits.applied(variables):
    assert os.environ == before | variables | {'XLA_FLAGS': '--a=1 --b=2'}
    assert measuring.alone(os.getenv, 'CVN_TARGET') == 'x'
  assert os.environ == before


def test_xla_takes_the_flags(monkeypatch):
  """An unknown flag ends the process."""
  monkeypatch.setattr(compiling, 'usable_targets', lambda: ['x86-64-v3'])
  with limits.applied(limits.find_variables('avx2')):
    assert measuring.alone(_double, 2.0) == 4


def _double(x):
  import jax

  return float(jax.jit(lambda x: 2 * x)(x))
