"""The trial of a library: kernels and plain products are timed in turn, and must agree."""

import json

import jax.numpy as jnp
import numpy as np
import pytest

from cvn.ops import native, trial
from cvn.ops.trial import Layer

SMALL = {
  'deconv': ((2, 2, 3, 4, 16), (16,), (16,), (3, 3, 3, 16, 8)),
  'conv': ((2, 2, 3, 4, 16), (16,), (16,), (3, 3, 3, 16, 3)),
  'activated': ((2, 2, 3, 4, 3), (3,), (3,)),
  'conv2d': ((2, 8, 8, 16), (3, 3, 16, 32)),
}


@pytest.fixture
def library():
  if not native.available():
    pytest.skip('no C++ compiler here')
  return native.library()


@pytest.mark.parametrize('layer', trial.LAYERS, ids=lambda layer: layer.operation)
def test_every_operation_is_timed_in_both_types(library, monkeypatch, layer):
  monkeypatch.setattr(trial, 'SECONDS', 0)
  found = trial.measure(library, layer._replace(shapes=SMALL[layer.operation]))
  assert set(found) == {'float32', 'mixed'}
  assert all(0 < t < 100 for times in found.values() for t in times)


@pytest.mark.parametrize('layer', trial.LAYERS, ids=lambda layer: layer.operation)
def test_kernels_are_compared_with_programs_that_have_none(library, layer):
  arguments = [np.zeros(shape, np.float32) for shape in SMALL[layer.operation]]
  for chosen in (library, 'plain'):
    text = trial._make_step(layer, False, chosen).lower(*arguments).as_text()
    names = {name for name in native.KERNELS if f'@{name}(' in text}
    assert bool(names) == (chosen is library)
    assert all(f'cvn_{layer.operation}' in name for name in names)


def test_the_layers_are_those_that_kernels_exist_for():
  assert {layer.operation for layer in trial.LAYERS} == set(SMALL)
  kernels = {name.removeprefix('cvn_').split('_')[0] for name in native.KERNELS}
  assert kernels == set(SMALL)


def differing(mixed, implementation, x, scale):
  """Kernels give another value than the plain product."""
  del mixed
  return (x * scale * (2 if implementation == 'plain' else 3),)


def infinite(mixed, implementation, x, scale):
  del mixed
  return x * 2, scale * (2 if implementation == 'plain' else jnp.nan)


@pytest.mark.parametrize('function', [differing, infinite])
def test_wrong_values_are_an_error(library, function):
  layer = Layer('deconv', function, ((2, 3), (2, 3)))
  with pytest.raises(ArithmeticError, match='deconv in float32 is wrong by'):
    trial.measure(library, layer)


def test_what_is_no_library_is_refused(tmp_path, capsys):
  path = tmp_path / 'kernels.so'
  path.write_text('no library')
  assert trial.main(['trial', str(path)]) == 0
  assert str(path) in json.loads(capsys.readouterr().out)['refused']
