"""The benchmark runs and says what it measured; how fast that was is no test's business."""

import re

from absl import flags

from experiments import benchmark


def test_prints_machine_and_rates(capsys):
  f = flags.FlagValues()
  benchmark.define_flags(f)
  f(['benchmark', '--network=shape', '--batch_size=2', '--steps=2'])
  benchmark.run(f)
  machine, line = capsys.readouterr().out.strip().split('\n')
  assert 'jax' in machine and 'cores' in machine
  found = re.fullmatch(
    r'shape, batch 2, float32: (\S+) images/s \((\S+) to (\S+) over 2 steps\), first step \S+ s',
    line,
  )
  median, low, high = (float(x) for x in found.groups())
  assert 0 < low <= median <= high
