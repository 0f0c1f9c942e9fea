"""Limits on the instruction set, so that two programs are compared on the same one.

A limit is a set of environment variables for both programs: CVN_TARGET for our kernels
(cvn/ops/native.py), XLA_FLAGS for the loops that XLA compiles, ATEN_CPU_CAPABILITY for PyTorch's
own loops, ONEDNN_MAX_CPU_ISA and MKL_ENABLE_INSTRUCTIONS for the libraries in both. XLA's matrix
library YNNPACK follows no limit: under one it is switched off, and XLA takes Eigen with oneDNN.
"""

import contextlib
import os
from collections.abc import Iterator, Mapping

from cvn.errors import UserError
from cvn.ops import compile as compiling

LIMITS = ('none', 'avx2', 'avx512')
_TARGETS = {'avx2': ('x86-64-v3',), 'avx512': ('x86-64-v4-bf16', 'x86-64-v4')}  # the best first
_WITHOUT_YNNPACK = '--xla_cpu_experimental_ynn_fusion_type='
_VARIABLES = {
  'avx2': {
    'ATEN_CPU_CAPABILITY': 'avx2',
    'MKL_ENABLE_INSTRUCTIONS': 'AVX2',
    'ONEDNN_MAX_CPU_ISA': 'AVX2',
    'XLA_FLAGS': f'--xla_cpu_max_isa=AVX2 {_WITHOUT_YNNPACK}',
  },
  'avx512': {  # without tile units (AMX)
    'ATEN_CPU_CAPABILITY': 'avx512',
    'MKL_ENABLE_INSTRUCTIONS': 'AVX512',
    'ONEDNN_MAX_CPU_ISA': 'AVX512_CORE_BF16',
    'XLA_FLAGS': f'--xla_cpu_max_isa=AVX512_BF16 {_WITHOUT_YNNPACK}',
  },
}


def find_variables(limit: str) -> dict[str, str]:
  """The environment variables that set a limit.

  Args:
    limit: one of `LIMITS`.

  Raises:
    UserError: this processor does not have the instructions.
  """
  if limit == 'none':
    return {}
  usable = compiling.usable_targets()
  target = next((t for t in _TARGETS[limit] if t in usable), None)
  if target is None:
    raise UserError(f'--limit={limit}: this processor does not have these instructions')
  return {'CVN_TARGET': target, **_VARIABLES[limit]}


@contextlib.contextmanager
def applied(variables: Mapping[str, str]) -> Iterator[None]:
  """Sets variables for the processes that are started in a block; flags of XLA are added to."""
  before = {name: os.environ.get(name) for name in variables}
  for name, value in variables.items():
    added = before[name] if name == 'XLA_FLAGS' else None
    os.environ[name] = f'{added} {value}' if added else value
  try:
    yield
  finally:
    for name, value in before.items():
      if value is None:
        del os.environ[name]
      else:
        os.environ[name] = value
