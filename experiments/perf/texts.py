"""Figures of the benchmark as text: medians with ranges, lines of results and of progress."""

import statistics
import sys
from collections.abc import Mapping, Sequence
from typing import Any

from experiments.perf import measuring

DISTURBED = 0.7  # of PyTorch's best rate: what is below it was not measured on an idle machine


def describe(machine: Mapping[str, Any], variables: Mapping[str, str]) -> str:
  """The machine in one line, and the limits on its instruction set in another if there are any.

  Args:
    machine: of `measuring.describe_machine`.
    variables: of `limits.find_variables`.
  """
  versions = ', '.join(f'{name} {version}' for name, version in machine['versions'].items())
  kernels = machine['compiled kernels']
  settings = ''.join(
    f'; {name}={value}' for name, value in machine['settings'].items() if name not in variables
  )
  line = (
    f'{machine["processor"]}, {machine["cores"]} cores; {machine["devices"]};'
    f' {f"kernels for {kernels}" if kernels else "no compiled kernels"}; {versions}{settings}'
  )
  if variables:
    line += f'\nlimit: {" ".join(f"{name}={value}" for name, value in variables.items())}'
  return line


def report_steps(name: str, batch_size: int, rounds: Sequence[measuring.Steps]) -> dict[str, Any]:
  """Prints and returns speed, first steps and memory.

  The first round had no compiled programs in the cache.
  """
  rates = spread([batch_size / s for steps in rounds for s in steps.seconds])
  again, peak = min(r.first for r in rounds[1:]), max(r.peak for r in rounds)
  say(
    f'{name}: {show(rates)} images/s, first step {rounds[0].first:.1f} s ({again:.1f} s with'
    f' compiled programs in the cache), peak memory {peak / 2**30:.2f} GiB'
  )
  if rounds[0].device_peak is not None:
    of_device = max(r.device_peak for r in rounds)
    say(f'{name}: {of_device / 2**30:.2f} GiB of device memory')
  return {
    'images/s': rates,
    'first step': {'compiling': rounds[0].first, 'compiled': again},
    'peak memory': peak,
    'rounds': [r._asdict() for r in rounds],
  }


def report_peer(
  name: str,
  batch_size: int,
  ours: Sequence[measuring.Steps],
  theirs: Sequence[float],
  *,
  tried: float,
) -> dict[str, Any]:
  """Prints and returns PyTorch's images/s, and how many times as fast our median step is.

  Args:
    name: of the combination.
    batch_size: views in a step.
    ours: our rounds.
    theirs: PyTorch's images/s in the same rounds.
    tried: its images/s when its settings were tried. If the rounds are far slower, another program
      disturbed them: PyTorch's threads wait for one another all the time, and can lose much more
      than their share of a busy machine. A line says so.
  """
  ratios = [
    batch_size / statistics.median(r.seconds) / t for r, t in zip(ours, theirs, strict=True)
  ]
  figures, ratio = spread(theirs), spread(ratios)
  say(f'{name}: PyTorch {show(figures)} images/s, ours is {show(ratio)} times as fast')
  disturbed = figures['low'] < DISTURBED * max(tried, figures['high'])
  if disturbed:
    say(
      f'{name}: not a fair comparison: PyTorch had {max(tried, figures["high"]):.2f} images/s in'
      ' another run, so other programs disturbed this one; repeat it on an idle machine'
    )
  return {'images/s': figures, 'ratio': ratio, 'disturbed': disturbed}


def spread(values: Sequence[float]) -> dict[str, float]:
  """Median and range."""
  return {'median': statistics.median(values), 'low': min(values), 'high': max(values)}


def show(values: Mapping[str, float], unit: float = 1) -> str:
  """Median and range as text."""
  median, low, high = (f'{unit * values[name]:.2f}' for name in ('median', 'low', 'high'))
  return f'{median} ({low} to {high})'


def plain(value: Any) -> Any:
  """Named tuples as dictionaries, all the way down."""
  return {k: plain(v) for k, v in value._asdict().items()} if hasattr(value, '_asdict') else value


def say(text: str) -> None:
  """Prints a result at once."""
  print(text, flush=True)


def tell(text: str) -> None:
  """Prints a line of progress."""
  print(f'... {text}', file=sys.stderr, flush=True)
