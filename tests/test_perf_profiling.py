"""Profiles: events of the device's streams, summed by operation."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp

from experiments.perf import profiling


def event(name, milliseconds, **stats):
  return SimpleNamespace(name=name, duration_ns=1e6 * milliseconds, stats=stats.items())


def test_events_of_streams_alone_are_summed():
  stream = SimpleNamespace(
    name='Stream #14(Compute)',
    events=[
      event('cudnn_k', 2, hlo_op='conv.1'),
      event('k', 3),
      event('cudnn_k', 4, hlo_op='conv.1'),
    ],
  )
  other = SimpleNamespace(name='XLA Ops', events=[event('conv.1', 9)])
  planes = [
    SimpleNamespace(name='/host:CPU', lines=[stream]),
    SimpleNamespace(name='/device:GPU:0', lines=[other, stream]),
  ]
  events = profiling.device_events(SimpleNamespace(planes=planes))
  rows = profiling.summarize(events, repeats=2)
  assert [(r['operation'], r['kernel'], r['calls']) for r in rows] == [
    ('conv.1', 'cudnn_k', 1),
    ('', 'k', 0.5),
  ]
  assert [round(1e3 * r['seconds'], 6) for r in rows] == [3, 1.5]
  first, _ = profiling.format_operations(rows).splitlines()
  assert first.split() == ['3.000', 'ms', '1.0', 'x', 'conv.1', 'cudnn_k']


def test_a_cpu_has_no_streams():
  double = jax.jit(lambda x: 2 * x)
  assert profiling.profile(lambda: jax.block_until_ready(double(jnp.ones(3))), repeats=1) == []
