"""The strict session: several CPU devices, no promotion of ranks or types, warnings are errors.

Warnings that may pass are listed one by one, with the reason, under `filterwarnings` in
pyproject.toml.
"""

import os
import pathlib

os.environ.setdefault('JAX_PLATFORMS', 'cpu')
os.environ.setdefault('JAX_NUM_CPU_DEVICES', '4')
os.environ.setdefault('JAX_NUMPY_RANK_PROMOTION', 'raise')
os.environ.setdefault('JAX_NUMPY_DTYPE_PROMOTION', 'strict')
# What takes time in these tests is the compiler: compile each program once, not once a file.
_CACHE = pathlib.Path(__file__).parent.parent / '.pytest_cache' / 'jax'
os.environ.setdefault('JAX_COMPILATION_CACHE_DIR', str(_CACHE))
os.environ.setdefault('JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS', '1')
