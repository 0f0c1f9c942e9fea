"""Counts of operations and bytes, floors and the table; times are no test's business."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import linen as nn

from cvn import layers
from cvn.networks import ShapeNetwork
from experiments.perf import layers as perf_layers
from experiments.perf.layers import Cost, Layer, Peaks, Row

PEAKS = Peaks(float32=1e9, bfloat16=4e9, bandwidth=1e9)


class Small(nn.Module):
  """A layer of each kind, in place of a network."""

  mixed: bool = False

  @nn.compact
  def __call__(self, image, train):
    x = layers.Conv2D(8, 3, self.mixed, name='conv')(image, train)
    x = layers.Collect(8, name='collect')(x, train)
    x = layers.Dense(16, name='dense')(x, train)
    x = layers.as_pending(x.reshape(-1, 2, 2, 2, 2))
    x = layers.Deconv3D(3, name='deconv')(x, train)
    return layers.materialize(layers.Conv3D(1, name='conv3')(x, train))


def array(*shape, dtype=jnp.float32):
  return jax.ShapeDtypeStruct(shape, dtype)


def test_layers_come_in_the_order_of_the_forward_pass():
  found = perf_layers.layers_of(ShapeNetwork(), 2)
  names = [layer.name for layer in found]
  assert names[:2] == ['encoder/conv0', 'encoder/conv0/norm']
  assert names[-2:] == ['head/deconv', 'head/conv']
  assert len(names) == 2 * (6 + 2) + 3 + 2
  sizes = {layer.name: layer.output.shape for layer in found}
  assert sizes['head/deconv'] == (2, 64, 64, 64, 24)
  assert sizes['encoder/latent1/norm'] == (2, 8192)


def test_operations_by_hand():
  found = {x.name: x for x in perf_layers.layers_of(ShapeNetwork(), 3)}
  count = perf_layers.count_operations
  assert count(found['encoder/conv0']) == 2 * 3 * 64**2 * 7**2 * 3 * 64
  assert count(found['encoder/latent0']) == 2 * 3 * 512 * 512
  assert count(found['head/deconv']) == 2 * 3 * 32**3 * 27 * 32 * 24
  assert count(found['head/conv']) == 2 * 3 * 64**3 * 27 * 24
  assert count(found['encoder/conv0/norm']) == 0


@pytest.mark.parametrize('dtype, size', [(jnp.float32, 4), (jnp.bfloat16, 2)])
def test_bytes_by_hand(dtype, size):
  x, y = array(2, 4, 4, 4, 5, dtype=dtype), array(2, 8, 8, 8, 3, dtype=dtype)
  volume = layers.PendingNorm(x, array(5), array(5), layers.ELU)
  layer = Layer('', layers.Deconv3D(3), (volume,), y)
  read, kernel, written = size * 2 * 64 * 5, 4 * 27 * 5 * 3, size * 2 * 512 * 3
  assert perf_layers.count_bytes(layer, True) == (
    read + kernel + written,
    2 * read + 2 * kernel + 2 * written,
  )
  assert perf_layers.count_bytes(layer, False)[1] == read + kernel + 2 * written
  norm = Layer('', layers.Norm(layers.ELU), (y, array(3)), y)
  assert perf_layers.count_bytes(norm, True) == (3 * written, 5 * written)


def test_rows_of_a_network():
  rows = perf_layers.time_layers(Small(), 2, PEAKS)
  with_norm = [f'{name}{end}' for name in ('conv', 'collect', 'dense') for end in ('', '/norm')]
  names = [*with_norm, 'deconv', 'conv3']
  assert [r.name for r in rows] == names
  first, dense = rows[0], rows[4]
  assert first.backward.operations == first.forward.operations  # a picture needs no gradient
  assert dense.backward.operations == 2 * dense.forward.operations == 4 * 2 * 8 * 16
  for row in rows:
    for cost in (row.forward, row.backward):
      assert cost.seconds > 0
      assert cost.floor == max(cost.operations / 1e9, cost.bytes / 1e9)


def test_convolutions_of_a_mixed_network_are_measured_by_the_peak_of_bfloat16():
  first, norm = perf_layers.time_layers(Small(mixed=True), 2, PEAKS)[:2]
  assert (first.dtype, norm.dtype) == ('bfloat16', 'float32')


def test_a_layer_with_weights_is_timed_without_its_normalisation():
  module = layers.Dense(4)
  x, kernel = jnp.ones((2, 3)), jnp.arange(12.0).reshape(3, 4)
  found = perf_layers._alone(module)({'kernel': kernel, 'bias': jnp.ones(4)}, x)
  np.testing.assert_allclose(found, x @ kernel)


def test_peaks_are_measured():
  assert all(p > 0 for p in perf_layers.measure_peaks(size=64, megabytes=1))


def test_table():
  cost = Cost(operations=2 * 10**6, bytes=10**6, floor=0.002, seconds=0.004)
  norm = Cost(operations=0, bytes=10**6, floor=0.001, seconds=0.003)
  rows = [
    Row('a', (2, 8, 8, 3), 'float32', cost, cost),
    Row('b', (2, 8, 8, 3), 'bfloat16', cost, norm),
  ]
  lines = perf_layers.format_rows(rows, PEAKS).split('\n')
  assert len({line.count('|') for line in lines}) == 1
  assert lines[2].startswith('| a | 8x8x3 | 0.00 | 1.0 | 2.00 | 4.00 | 2.0 | 50% |')
  assert lines[3].startswith('| b | 8x8x3 | 0.00 | 1.0 | 2.00 | 4.00 | 2.0 | 12% | 1.00 | 3.00 |')
  assert '| 4.00 | 8.00 | 2.0 |' in lines[4] and '| 3.00 | 7.00 | 2.3 |' in lines[4]
