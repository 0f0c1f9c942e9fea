r"""Times whole training steps (forward, loss, backward, Adam) on batches of noise.

python -m experiments.perf [--network=shape|color|both] [--batch_size=12,60] \
  [--dtype=float32,mixed] [--limit=none|avx2|avx512] [--peer_python=PATH] \
  [--data=DIR] [--reference] [--json=FILE]

For each combination the program prints images/s as median and range, the seconds of the first step
(tracing and compiling) without and with compiled programs in the cache, peak memory, and a table of
the layers, each timed alone beside the shortest time that the machine's measured peaks allow. With
both networks it also prints the milliseconds in which one picture goes through them.

--peer_python compares with the same networks in PyTorch (torch_peer.py). PATH is a Python that has
it, in an environment of its own:

  python3 -m venv torchenv && torchenv/bin/pip install torch numpy
  python -m experiments.perf --nolayers --peer_python=torchenv/bin/python --limit=avx2

Each setting in --peer_options is tried once, for a mixed network in float32 and in bfloat16. The
fastest one then runs in turn with ours (A B A B), each time in a new process. --limit keeps both
programs to one instruction set (limits.py).

On a GPU, experiments.perf.accelerator does the same in few processes, which saves most of the time.
"""

import itertools
import json
import tempfile
from collections.abc import Sequence
from typing import Any, NamedTuple

from absl import flags

from cvn import environment, errors
from cvn.files import atomic_write
from experiments.lib.training import DTYPES
from experiments.perf import layers, limits, measuring, peer, texts
from experiments.perf.texts import say, show, spread, tell

KINDS = ('shape', 'color')
INFERENCES = 20


class Plan(NamedTuple):
  """What to measure of every combination."""

  steps: int  # timed in a round
  rounds: int  # new processes
  layers: bool
  data: str | None
  peer_python: str | None
  peer_options: Sequence[str]
  platform: str = 'cpu'  # JAX's name


def define_flags(f: flags.FlagValues) -> None:
  """The program's flags. Not at import: there the names of several programs would collide."""
  own = {'flag_values': f}
  flags.DEFINE_enum('network', 'both', [*KINDS, 'both'], 'Which network to train.', **own)
  flags.DEFINE_list('batch_size', ['12'], 'Views in a step; one size or several.', **own)
  flags.DEFINE_list('dtype', [*DTYPES], 'Types of products: float32, mixed or both.', **own)
  flags.DEFINE_integer('steps', 5, 'Timed steps in a round, after the first one.', 1, **own)
  flags.DEFINE_integer('rounds', 2, 'New processes for each combination.', 2, **own)
  flags.DEFINE_bool('layers', True, 'Time the layers alone as well.', **own)
  flags.DEFINE_bool('reference', False, "Time a step with XLA's own convolutions as well.", **own)
  flags.DEFINE_string('data', None, 'Data set to train on as well.', **own)
  flags.DEFINE_enum('limit', 'none', limits.LIMITS, 'Instruction set of all programs.', **own)
  flags.DEFINE_string('peer_python', None, 'Python interpreter that has PyTorch.', **own)
  flags.DEFINE_list(
    'peer_options', ['default', 'channels_last'], f'Settings to try: {peer.OPTIONS}.', **own
  )
  flags.DEFINE_string('json', None, 'File for all that is measured.', **own)
  flags.register_validator(
    'batch_size', lambda v: v and all(x.isdecimal() and int(x) for x in v), 'counts above 0', f
  )
  flags.register_validator('dtype', lambda v: v and set(v) <= {*DTYPES}, f'of {DTYPES}', f)
  flags.register_validator(
    'peer_options', lambda v: v and set(v) <= {*peer.OPTIONS}, f'of {peer.OPTIONS}', f
  )


def main(_) -> None:
  run(flags.FLAGS)


def run(f: flags.FlagValues) -> None:
  """Measures as the flags say."""
  kinds = [*KINDS] if f.network == 'both' else [f.network]
  combinations = [*itertools.product(kinds, map(int, f.batch_size), f.dtype)]
  plan = Plan(f.steps, f.rounds, f.layers, f.data, f.peer_python, f.peer_options)
  variables = limits.find_variables(f.limit)
  with limits.applied(variables):
    measure_all(combinations, plan, variables, reference=f.reference, path=f.json)


def measure_all(
  combinations: Sequence[tuple[str, int, str]],
  plan: Plan,
  variables: dict[str, str],
  *,
  reference: bool,
  path: str | None,
) -> None:
  """Measures every combination and prints all figures.

  Args:
    combinations: network, batch size and dtype of each.
    plan: what to measure of each.
    variables: the environment variables that limit the instruction set.
    reference: whether to time a step with XLA's own convolutions.
    path: of the JSON file, which is written anew after each combination; None for none.
  """
  found = {'machine': measuring.alone(measuring.describe_machine), 'limit': variables}
  found['training'] = []
  plan = plan._replace(platform=found['machine']['platform'])
  say(texts.describe(found['machine'], variables))
  write(path, found)
  for combination in combinations:
    found['training'].append(measure(*combination, plan))
    write(path, found)
  kinds = [*dict.fromkeys(kind for kind, *_ in combinations)]
  if reference:
    found['reference'] = [measure_reference(kind) for kind in kinds]
  if kinds == [*KINDS]:
    tell('one picture')
    found['inference'] = spread(measuring.alone(measuring.time_inference, INFERENCES))
    say(f'one picture, both networks, warm: {show(found["inference"], 1e3)} ms')
  write(path, found)


def measure(kind: str, batch_size: int, dtype: str, plan: Plan) -> dict[str, Any]:
  """All figures of one combination, which it prints."""
  name, network = f'{kind}, batch {batch_size}, {dtype}', (kind, batch_size, dtype == 'mixed')
  found = {'network': kind, 'batch size': batch_size, 'dtype': dtype}
  command = None
  if plan.peer_python:
    found['peer'], command = try_settings(name, kind, batch_size, dtype, plan)
  ours, theirs = [], []
  with tempfile.TemporaryDirectory() as programs:
    for n in range(plan.rounds):
      tell(f'{name}: round {n + 1} of {plan.rounds}')
      ours.append(measuring.alone(measuring.time_steps, *network, plan.steps, programs=programs))
      if command:
        tell(f'{name}: PyTorch, round {n + 1} of {plan.rounds}')
        theirs.append(peer.run(command).rate)
  found |= texts.report_steps(name, batch_size, ours)
  if command:
    tried = max(filter(None, found['peer']['tried'].values()))
    found['peer'] |= texts.report_peer(name, batch_size, ours, theirs, tried=tried)
  if plan.data:
    tell(f'{name}: steps on {plan.data}')
    times = measuring.alone(measuring.time_data, *network, plan.steps, plan.data)
    found['data'] = times._asdict()
    say(
      f'{name}: {times.real:.3f} s a step on {plan.data}, {times.synthetic:.3f} s on one batch of'
      f' it over and over ({times.real / times.synthetic - 1:+.1%}), peak memory'
      f' {times.peak / 2**30:.2f} GiB'
    )
  if plan.layers:
    tell(f'{name}: layers')
    peaks, rows = measuring.alone(measuring.time_layers, *network)
    found |= {'peaks': peaks._asdict(), 'layers': [texts.plain(row) for row in rows]}
    say(
      f'\nPeaks: {peaks.float32 / 1e9:.0f} GFLOP/s float32, {peaks.bfloat16 / 1e9:.0f} bfloat16,'
      f' {peaks.bandwidth / 1e9:.1f} GB/s\n\n{layers.format_rows(rows, peaks)}\n'
    )
  return found


def try_settings(
  name: str, kind: str, batch_size: int, dtype: str, plan: Plan
) -> tuple[dict[str, Any], list[str]]:
  """Tries PyTorch's settings, each once: (what is found, the command of the fastest).

  Raises:
    UserError: PyTorch fails, or no setting ends in time.
  """
  found, best = {'tried': {}}, (0, None, [])
  for setting in peer.list_settings(dtype, plan.peer_options):
    tell(f'{name}: PyTorch, {setting}')
    command = peer.make_command(
      plan.peer_python,
      setting,
      network=kind,
      batch_size=batch_size,
      steps=plan.steps,
      platform=plan.platform,
    )
    trial = peer.run(command, timeout=peer.TIMEOUT)
    rate = trial.rate if trial else None
    found['tried'][str(setting)] = rate
    figure = f'{rate:.2f} images/s' if trial else f'none in {peer.TIMEOUT} s'
    say(f'{name}: {trial.version if trial else "PyTorch"}, {setting}: {figure}')
    if trial and rate > best[0]:
      best = rate, setting, command
  rate, setting, command = best
  if not command:
    raise errors.UserError(f'no setting of PyTorch ended in {peer.TIMEOUT} s: try --batch_size=2')
  return found | {'setting': str(setting)}, command


def measure_reference(kind: str) -> dict[str, Any]:
  """One step with XLA's own convolutions, which it prints."""
  tell(f"{kind}: one step with XLA's convolutions")
  steps, size = measuring.alone(measuring.time_reference, kind), measuring.REFERENCE_BATCH
  rate = size / steps.seconds[0]
  say(f"{kind}, XLA's convolutions, batch {size}, float32: {rate:.2f} images/s (one step)")
  return {'network': kind, 'batch size': size, 'images/s': rate, **steps._asdict()}


def write(path: str | None, found: dict[str, Any]) -> None:
  """Writes the file of --json, if there is one."""
  if path:
    with atomic_write(path) as temporary, open(temporary, 'w') as f:
      json.dump(found, f, indent=2)


if __name__ == '__main__':
  environment.prepare()
  define_flags(flags.FLAGS)
  errors.run(main)
