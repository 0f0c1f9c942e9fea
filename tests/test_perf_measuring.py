"""What the benchmark measures is what it says; how fast that was is no test's business."""

import functools
import os

import jax
import pytest
import synthetic

from cvn.errors import UserError
from cvn.ops import deconv
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


def test_steps():
  steps = measuring.time_steps('shape', 2, False, 2)
  assert len(steps.seconds) == 2
  assert 0 < max(steps.seconds) < steps.first
  assert steps.peak > 1 << 28  # two volumes of 24 channels alone are 50 MB
  assert steps.device_peak is None or jax.default_backend() != 'cpu'


def test_reference_uses_the_librarys_deconvolution(monkeypatch):
  called, choice_before = [], deconv.by_platform
  programs = [functools.partial(called.append, name) for name in ('kernels', 'products', 'library')]
  monkeypatch.setattr(measuring, 'time_steps', lambda *_: deconv.by_platform(*programs))
  measuring.time_reference('shape')
  assert called == ['library']
  assert deconv.by_platform is choice_before


def test_machine():
  machine = measuring.describe_machine()
  assert machine['cores'] == os.cpu_count()
  assert machine['versions']['jax'] == jax.__version__
  assert machine['compiled kernels'] or not machine['tile units']


@pytest.mark.slow
def test_steps_on_a_data_set(tmp_path):
  synthetic.make_dataset(tmp_path / 'set', 6)
  times = measuring.time_data('shape', 2, False, 1, str(tmp_path / 'set'))
  assert times.real > 0 and times.synthetic > 0


@pytest.mark.slow
def test_inference():
  assert len(measuring.time_inference(2)) == 2
