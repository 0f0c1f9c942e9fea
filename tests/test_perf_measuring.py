"""What the benchmark measures is what it says; how fast that was is no test's business."""

import itertools
import os
import types

import jax
import jax.numpy as jnp
import pytest
import synthetic

from cvn.errors import UserError
from cvn.ops import deconv, native
from cvn.ops.normalization import ELU
from experiments.perf import measuring


def fail(message):
  raise UserError(message)


def test_alone_is_another_process_with_its_own_folder_of_programs(tmp_path):
  assert measuring.alone(os.getpid) != os.getpid()
  folder = measuring.alone(os.getenv, 'JAX_COMPILATION_CACHE_DIR', programs=str(tmp_path / 'new'))
  assert folder != str(tmp_path / 'new') and (tmp_path / 'new').is_dir()


def test_alone_passes_on_what_the_user_can_mend():
  with pytest.raises(UserError, match='too few'):
    measuring.alone(fail, 'too few')
  with pytest.raises(UserError, match='take a smaller --batch_size'):
    measuring.alone(os.abort)


@pytest.fixture
def clock(monkeypatch):
  """A clock that goes on by a second whenever it is read."""
  monkeypatch.setattr(
    measuring, 'time', types.SimpleNamespace(perf_counter=itertools.count().__next__)
  )


def test_every_step_is_timed_by_itself(clock):
  steps = measuring.time_steps('shape', 2, False, 2)
  assert (steps.first, steps.seconds) == (1, (1, 1))
  assert steps.peak > 1 << 28  # two volumes of 24 channels alone are 50 MB
  assert steps.device_peak is None or jax.default_backend() != 'cpu'


def test_reference_uses_the_librarys_deconvolution(monkeypatch):
  def lowered(*_, implementation):
    arrays = jnp.zeros((1, 2, 2, 2, 3)), jnp.ones(3), jnp.zeros(3), jnp.zeros((3, 3, 3, 3, 2))
    run = jax.jit(lambda *a: deconv.deconv(*a, ELU, implementation=implementation))
    return run.lower(*arrays).as_text()

  monkeypatch.setattr(measuring, 'time_steps', lowered)
  assert 'stablehlo.convolution' in measuring.time_reference('shape')


def test_machine():
  machine = measuring.describe_machine()
  assert machine['cores'] == os.cpu_count() and machine['platform'] == jax.default_backend()
  assert machine['versions']['jax'] == jax.__version__
  library = native.library()
  assert machine['compiled kernels'] == (
    f'{library.instruction_set} ({library.origin})' if library else None
  )


@pytest.mark.slow
def test_steps_on_a_data_set(tmp_path, clock):
  synthetic.make_dataset(tmp_path / 'set', 6)
  times = measuring.time_data('shape', 2, False, 1, str(tmp_path / 'set'))
  a_step = 1 / measuring.DATA_STEPS
  assert (times.synthetic, times.real) == (a_step, a_step)


@pytest.mark.slow
def test_every_reconstruction_is_timed_by_itself(clock):
  assert measuring.time_inference(2) == (1, 1)
