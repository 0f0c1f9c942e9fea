"""A run compiles each program once: through epochs' ends, validations, and when it is resumed."""

import numpy as np
import pytest
import synthetic

from cvn import train
from experiments import train as program

SIZES = {'image_size': 32, 'grid_size': 16}  # the smallest that the networks can have


@pytest.fixture
def made(monkeypatch):
  """The compiled functions that the program makes; pictures are left out."""
  made = {'make_step': [], 'make_eval': []}

  def noting(name, function):
    def make(*args, **kwargs):
      made[name].append(function(*args, **kwargs))
      return made[name][-1]

    return make

  for name in made:
    monkeypatch.setattr(train, name, noting(name, getattr(train, name)))
  monkeypatch.setattr(program, 'check_sizes', lambda dataset: None)
  monkeypatch.setattr(program, 'draw_views', lambda *_: np.zeros((8, 8, 3), np.uint8))
  return made


@pytest.mark.parametrize(
  'network, dtype',
  [('shape', 'mixed'), pytest.param('color', 'float32', marks=pytest.mark.slow)],
)
def test_one_compilation_a_run(made, tmp_path, network, dtype):
  # Models of different sizes, three steps an epoch, and five views to validate on in fours.
  splits = ('train',) * 13 + ('val',)
  synthetic.make_dataset(tmp_path / 'set', 14, splits=splits, azimuths=range(0, 360, 72), **SIZES)
  for epochs in (2, 4):  # the second run is a resumed one
    arguments = {
      'network': network,
      'dtype': dtype,
      'data': tmp_path / 'set',
      'workdir': tmp_path / 'run',
      'epochs': epochs,
      'batch_size': 4,
      'validate_every': 1,
    }
    assert program.main([f'--{name}={value}' for name, value in arguments.items()]) == 0
  assert [step._cache_size() for step in made['make_step']] == [1, 1]
  assert [evaluate._cache_size() for evaluate in made['make_eval']] == [1, 1]
