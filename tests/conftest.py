"""The strict session: several CPU devices, rank promotion raises, warnings are errors.

Warnings that may pass are listed one by one, with the reason, under `filterwarnings` in
pyproject.toml.
"""

import os

os.environ.setdefault('JAX_PLATFORMS', 'cpu')
os.environ.setdefault('JAX_NUM_CPU_DEVICES', '4')
os.environ.setdefault('JAX_NUMPY_RANK_PROMOTION', 'raise')
