"""Which program computes an operation, and what is refused at the door."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from operations import IMPLEMENTATIONS, KERNELS, OPERATIONS, draw, make, operation

from cvn.networks import ShapeNetwork
from cvn.ops import conv2d, deconv, dispatch, native
from cvn.ops.normalization import ELU

needs_kernels = pytest.mark.skipif(not native.available(), reason='no compiled kernels here')
SMALL = {'image_size': 32, 'grid_size': 16}  # the smallest that the networks can have


def initialize(image, **options):
  network = ShapeNetwork(**SMALL, **options)
  return jax.eval_shape(lambda k, x: network.init(k, x, train=False), jax.random.key(0), image)


@pytest.mark.parametrize('name', KERNELS)
def test_each_implementation_is_what_it_says(name, monkeypatch):
  def text(implementation):
    return jax.jit(operation(name, implementation)).lower(*make(name)).as_text()

  assert 'cvn_' not in text('xla') and 'cvn_' not in text('plain')
  assert ('cvn_' in text('auto')) == native.available()
  if native.available():
    assert 'cvn_' in text('kernels')
    monkeypatch.setattr(native, 'wins', lambda *_, **__: False)
    assert 'cvn_' not in text('auto')
    assert 'cvn_' in text('kernels')


@pytest.mark.parametrize('name', OPERATIONS)
def test_an_unknown_implementation_is_refused(name):
  with pytest.raises(
    ValueError, match=r"must be one of \('auto', 'kernels', 'plain', 'xla'\): 'fast'"
  ):
    operation(name, 'fast')(*make(name))


def test_an_unknown_implementation_of_a_network_is_refused():
  with pytest.raises(
    ValueError, match=r"must be one of \('auto', 'kernels', 'plain', 'xla'\): 'fast'"
  ):
    initialize(jnp.zeros((1, 32, 32, 3)), implementation='fast')


@pytest.mark.parametrize('name', KERNELS)
def test_kernels_that_are_missing_are_an_error_that_says_why(name, monkeypatch):
  monkeypatch.setattr(native, '_choose', lambda: (None, 'no C++ compiler: c++'))
  with pytest.raises(RuntimeError, match=r"'kernels': .*no C\+\+ compiler"):
    operation(name, 'kernels')(*make(name))


@pytest.mark.parametrize('name', KERNELS)
def test_no_library_is_looked_for_on_an_accelerator(name, monkeypatch):
  def refuse():
    raise AssertionError('a library is looked for')

  monkeypatch.setattr(native, 'library', refuse)
  run = jax.jit(operation(name, 'auto'))
  with pytest.raises(AssertionError, match='a library is looked for'):
    run.trace(*make(name))
  monkeypatch.setattr(jax, 'default_backend', lambda: 'gpu')
  assert 'cvn_' not in run.trace(*make(name)).lower(lowering_platforms=('cuda',)).as_text()


@needs_kernels
def test_a_cpu_beside_an_accelerator_has_its_kernels(monkeypatch):
  monkeypatch.setattr(jax, 'default_backend', lambda: 'gpu')
  with jax.default_device(jax.devices('cpu')[0]):
    assert 'cvn_' in jax.jit(operation('conv', 'auto')).lower(*make('conv')).as_text()


@needs_kernels
def test_kernels_that_do_not_take_a_shape_are_an_error():
  with pytest.raises(ValueError, match=r'no multiple of 16: 5'):
    conv2d.conv2d(draw(0, 1, 4, 4, 3), draw(1, 3, 3, 3, 5), implementation='kernels')


@needs_kernels
def test_kernels_on_an_accelerator_are_an_error():
  run = jax.jit(operation('deconv', 'kernels'))
  with pytest.raises(NotImplementedError, match='cuda'):
    jax.export.export(run, platforms=['cuda'])(*make('deconv'))


@pytest.mark.parametrize('name', KERNELS)
def test_shapes_that_do_not_fit_are_refused(name):
  x, p = make(name)
  for wrong in (x[..., :-1], x[0, 0]):
    with pytest.raises(ValueError, match=f'{name} takes x'):
      operation(name, 'auto')(wrong, p)


@pytest.mark.parametrize('implementation', IMPLEMENTATIONS)
@pytest.mark.parametrize('name', OPERATIONS)
def test_integers_are_refused_and_the_types_are_named(name, implementation):
  x, p = make(name)
  run = operation(name, implementation)
  named = 'must be float32 or bfloat16 .*: int32'
  with pytest.raises(TypeError, match=f'x {named}'):
    run(x.astype(np.int32), p)
  with pytest.raises(TypeError, match=named):
    run(x, (*p[:-1], p[-1].astype(np.int32)))


def test_a_result_of_another_type_is_refused():
  x, p = make('deconv')
  with pytest.raises(TypeError, match='the result can be float32 or bfloat16: float16'):
    deconv.deconv(x, *p, ELU, dtype=jnp.float16)


def test_images_of_integers_are_refused():
  with pytest.raises(TypeError, match=r'images must be float32 .*: uint8'):
    initialize(jnp.zeros((1, 32, 32, 3), jnp.uint8))


def test_benchmarks_can_have_xlas_convolution_on_a_cpu():
  def text():
    return jax.jit(operation('deconv', 'xla')).lower(*make('deconv')).as_text()

  with dispatch.convolutions_everywhere():
    assert 'stablehlo.convolution' in text()
  assert 'stablehlo.convolution' not in text()
