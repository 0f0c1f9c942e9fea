r"""How fast a network trains: whole steps (forward, loss, backward, Adam) on synthetic batches.

python -m experiments.perf [--network=shape|color|both] [--batch_size=12,60] \
  [--dtype=float32,mixed] [--json=FILE] [--data=DIR] [--reference] \
  [--peer="COMMAND --net {network} --batch {batch} --dtype {dtype}"]

For every combination: images/s as median and range, the first step (tracing and compiling) without
and with compiled programs at hand, peak memory, and a table of the layers, each alone, with the
least time that the machine's measured peaks allow. With both networks also the reconstruction of
one picture. --peer runs another program in turn with ours, each time in a new process, and reads
'X images/s' from what it prints; --peer_dtypes says what our types are called there. --data trains
on a data set too, and tells what reading it costs. --reference times one step with the plain
library deconvolution, which on a CPU is hundreds of times slower.
"""

import itertools
import json
import shlex
import statistics
import sys
import tempfile
from collections.abc import Sequence
from typing import Any

from absl import flags

from cvn import environment, errors
from cvn.files import atomic_write
from experiments.lib.training import DTYPES
from experiments.perf import layers, measuring, peer

KINDS = ('shape', 'color')
INFERENCES = 20


def define_flags(f: flags.FlagValues) -> None:
  """The program's flags. Not at import: there the names of several programs would collide."""
  own = {'flag_values': f}
  flags.DEFINE_enum('network', 'both', [*KINDS, 'both'], 'Which network.', **own)
  flags.DEFINE_list('batch_size', ['12'], 'Views a step; one size or several.', **own)
  flags.DEFINE_list('dtype', [*DTYPES], 'Of products: float32, mixed or both.', **own)
  flags.DEFINE_integer('steps', 5, 'Timed in a round, after one that is not.', 1, **own)
  flags.DEFINE_integer('rounds', 2, 'New processes for each combination.', 2, **own)
  flags.DEFINE_bool('layers', True, 'Whether to time the layers alone.', **own)
  flags.DEFINE_bool('reference', False, 'Whether to time the plain deconvolution too.', **own)
  flags.DEFINE_string('data', None, 'A data set to train on as well.', **own)
  flags.DEFINE_string('peer', None, "Another program's command, run in turn with ours.", **own)
  flags.DEFINE_list('peer_dtypes', ['float32=f32', 'mixed=bf16'], 'What {dtype} becomes.', **own)
  flags.DEFINE_string('json', None, 'A file for all that is measured.', **own)
  flags.register_validator(
    'batch_size', lambda v: v and all(x.isdecimal() and int(x) for x in v), 'counts above 0', f
  )
  flags.register_validator('dtype', lambda v: v and set(v) <= {*DTYPES}, f'of {DTYPES}', f)
  flags.register_validator(
    'peer_dtypes', lambda v: all(len(x.split('=')) == 2 for x in v), 'must be OURS=THEIRS', f
  )


def main(_) -> None:
  run(flags.FLAGS)


def run(f: flags.FlagValues) -> None:
  """Measures as the flags say; --json is written anew after each combination."""
  kinds = [*KINDS] if f.network == 'both' else [f.network]
  combinations = [*itertools.product(kinds, map(int, f.batch_size), f.dtype)]
  commands = {c: peer_command(f, *c) for c in combinations} if f.peer else {}
  found = {'machine': measuring.alone(measuring.describe_machine), 'training': []}
  say(describe(found['machine']))
  write(f.json, found)
  for c in combinations:
    found['training'].append(measure(f, *c, commands.get(c)))
    write(f.json, found)
  if f.reference:
    found['reference'] = [measure_reference(kind) for kind in kinds]
  if f.network == 'both':
    tell('one picture')
    seconds = measuring.alone(measuring.time_inference, INFERENCES)
    found['inference'] = spread(seconds)
    say(f'one picture, both networks, warm: {show(found["inference"], 1e3)} ms')
  write(f.json, found)


def measure(
  f: flags.FlagValues, kind: str, batch_size: int, dtype: str, command: list[str] | None
) -> dict[str, Any]:
  """All figures of one combination, which it prints."""
  name, network = f'{kind}, batch {batch_size}, {dtype}', (kind, batch_size, dtype == 'mixed')
  ours, theirs = [], []
  with tempfile.TemporaryDirectory() as programs:
    for n in range(f.rounds):
      tell(f'{name}: round {n + 1} of {f.rounds}')
      ours.append(measuring.alone(measuring.time_steps, *network, f.steps, programs=programs))
      if command:
        tell(f'{name}: peer, round {n + 1} of {f.rounds}')
        theirs.append(peer.measure(command))
  found = {'network': kind, 'batch size': batch_size, 'dtype': dtype}
  found |= report_steps(name, batch_size, ours)
  if command:
    found['peer'] = report_peer(name, batch_size, ours, theirs, command)
  if f.data:
    tell(f'{name}: steps on {f.data}')
    times = measuring.alone(measuring.time_data, *network, f.steps, f.data)
    found['data'] = times._asdict()
    say(
      f'{name}: {times.real:.3f} s a step on {f.data}, {times.synthetic:.3f} s on one batch of it'
      f' over and over ({times.real / times.synthetic - 1:+.1%}), peak memory'
      f' {times.peak / 2**30:.2f} GiB'
    )
  if f.layers:
    tell(f'{name}: layers')
    peaks, rows = measuring.alone(measuring.time_layers, *network)
    found |= {'peaks': peaks._asdict(), 'layers': [plain(row) for row in rows]}
    say(
      f'\nPeaks: {peaks.float32 / 1e9:.0f} GFLOP/s float32, {peaks.bfloat16 / 1e9:.0f} bfloat16,'
      f' {peaks.bandwidth / 1e9:.1f} GB/s\n\n{layers.format_rows(rows, peaks)}\n'
    )
  return found


def report_steps(name: str, batch_size: int, rounds: list[measuring.Steps]) -> dict[str, Any]:
  """Speed, first steps and memory; the first round had no compiled programs at hand."""
  rates = spread([batch_size / s for steps in rounds for s in steps.seconds])
  again, peak = min(r.first for r in rounds[1:]), max(r.peak for r in rounds)
  say(
    f'{name}: {show(rates)} images/s, first step {rounds[0].first:.1f} s ({again:.1f} s with'
    f' compiled programs at hand), peak memory {peak / 2**30:.2f} GiB'
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
  ours: list[measuring.Steps],
  theirs: list[float],
  command: list[str],
) -> dict[str, Any]:
  """The peer's speed, and round by round how many times as fast our median step is."""
  ratios = [
    batch_size / statistics.median(r.seconds) / t for r, t in zip(ours, theirs, strict=True)
  ]
  figures, ratio = spread(theirs), spread(ratios)
  say(f'{name}: peer {show(figures)} images/s, ours is {show(ratio)} times as fast')
  return {'command': shlex.join(command), 'images/s': figures, 'ratio': ratio}


def measure_reference(kind: str) -> dict[str, Any]:
  """One step with the library's deconvolution, which it prints."""
  tell(f'{kind}: one step with the library deconvolution')
  steps, size = measuring.alone(measuring.time_reference, kind), measuring.REFERENCE_BATCH
  rate = size / steps.seconds[0]
  say(f'{kind}, library deconvolution, batch {size}, float32: {rate:.2f} images/s (one step)')
  return {'network': kind, 'batch size': size, 'images/s': rate, **steps._asdict()}


def peer_command(f: flags.FlagValues, kind: str, batch_size: int, dtype: str) -> list[str]:
  """The peer's command for a combination.

  Raises:
    UserError: --peer or --peer_dtypes does not tell it.
  """
  names = dict(x.split('=') for x in f.peer_dtypes)
  if dtype not in names:
    raise errors.UserError(f'--peer_dtypes does not say what {dtype} is called: {dtype}=NAME')
  return peer.make_command(f.peer, network=kind, batch=batch_size, dtype=names[dtype])


def describe(machine: dict[str, Any]) -> str:
  """The machine in one line."""
  versions = ', '.join(f'{name} {version}' for name, version in machine['versions'].items())
  kernels = 'compiled kernels' if machine['compiled kernels'] else 'no compiled kernels'
  tiles = ', tile units' if machine['tile units'] else ''
  settings = ''.join(f'; {name}={value}' for name, value in machine['settings'].items())
  return (
    f'{machine["processor"]}, {machine["cores"]} cores; {machine["devices"]}; {kernels}{tiles};'
    f' {versions}{settings}'
  )


def spread(values: Sequence[float]) -> dict[str, float]:
  """Median and range."""
  return {'median': statistics.median(values), 'low': min(values), 'high': max(values)}


def show(values: dict[str, float], unit: float = 1) -> str:
  """Median and range as text."""
  median, low, high = (f'{unit * values[name]:.2f}' for name in ('median', 'low', 'high'))
  return f'{median} ({low} to {high})'


def plain(value: Any) -> Any:
  """Named tuples as dictionaries, all the way down."""
  return {k: plain(v) for k, v in value._asdict().items()} if hasattr(value, '_asdict') else value


def say(text: str) -> None:
  """A result, at once."""
  print(text, flush=True)


def tell(text: str) -> None:
  """A line of progress."""
  print(f'... {text}', file=sys.stderr, flush=True)


def write(path: str | None, found: dict[str, Any]) -> None:
  """The file of --json, if there is to be one."""
  if path:
    with atomic_write(path) as temporary, open(temporary, 'w') as f:
      json.dump(found, f, indent=2)


if __name__ == '__main__':
  environment.prepare()
  define_flags(flags.FLAGS)
  errors.run(main)
