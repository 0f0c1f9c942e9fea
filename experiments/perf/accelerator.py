r"""Times training steps on an accelerator, in turn with PyTorch on the same card.

python -m experiments.perf.accelerator [--network=shape|color|both] [--batch_size=60,256] \
  [--dtype=float32,tf32,mixed] [--nopeer] [--profile=20] [--seconds=S] [--json=FILE]

Compiling for a GPU takes longer than the steps that are timed. So, unlike in experiments.perf, one
process compiles several programs at the same time, and then times one after the other.
PyTorch has a process of its own (the same interpreter must have it, or --nopeer), and the two run
in turn, A B A B. PyTorch's volumes are channels-last, and cuDNN chooses its programs by trial.

The types are those of products: `float32` in full, `tf32` float32 with factors rounded to TF32,
which is JAX's default on a GPU, and `mixed` with bfloat16 volumes (autocast in PyTorch).

--profile prints the operations that take most of the time. --programs keeps the compiled programs
as text, which tell what these operations are.
"""

import contextlib
import importlib
import itertools
import json
import math
import multiprocessing
import os
import pathlib
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from typing import Any, NamedTuple

import jax
from absl import flags

from cvn import errors, train
from cvn.files import atomic_write
from cvn.networks import NETWORKS
from cvn.objectives import OBJECTIVES
from cvn.recipe import PAPER
from experiments.lib import cli
from experiments.perf import measuring, profiling, texts
from experiments.perf.texts import say, show, spread, tell

KINDS = ('shape', 'color')
DTYPES = ('float32', 'tf32', 'mixed')
PRECISIONS = {'float32': 'highest', 'tf32': 'default', 'mixed': 'default'}  # JAX's names
PEER = {  # what torch_peer.time_steps takes for each type
  'float32': {'dtype': 'float32', 'tf32': False},
  'tf32': {'dtype': 'float32', 'tf32': True},
  'mixed': {'dtype': 'bfloat16', 'tf32': True},
}
ROUNDS = 2


class Combination(NamedTuple):
  """What is trained, and how."""

  kind: str  # of network
  batch_size: int
  dtype: str  # of `DTYPES`

  def __str__(self) -> str:
    return f'{self.kind}, batch {self.batch_size}, {self.dtype}'


class Program(NamedTuple):
  """A compiled training step."""

  step: Callable  # (state, batch) -> (state, metrics)
  seconds: float  # that tracing and compiling took
  memory: int  # bytes that it needs on the device
  operations: float  # floating-point operations, as the compiler counts them
  text: str  # the program after the compiler's passes


def define_flags(f: flags.FlagValues) -> None:
  own = {'flag_values': f}
  flags.DEFINE_enum('network', 'both', [*KINDS, 'both'], 'Which network to train.', **own)
  flags.DEFINE_list('batch_size', ['60', '256'], 'Views in a step; one size or several.', **own)
  flags.DEFINE_list('dtype', [*DTYPES], f'Types of products: {DTYPES}.', **own)
  flags.DEFINE_integer('steps', 10, 'Timed steps in a round, after the first one.', 1, **own)
  flags.DEFINE_bool('peer', True, 'Time PyTorch as well.', **own)
  flags.DEFINE_integer('profile', 0, 'Operations to print of each program; 0 for none.', 0, **own)
  flags.DEFINE_float('seconds', None, 'Begin no measurement after this many seconds.', **own)
  flags.DEFINE_string('programs', None, 'Folder for the text of compiled programs.', **own)
  flags.DEFINE_string('json', None, 'File for all that is measured.', **own)
  flags.register_validator(
    'batch_size', lambda v: v and all(x.isdecimal() and int(x) > 1 for x in v), 'counts above 1', f
  )
  flags.register_validator('dtype', lambda v: v and set(v) <= {*DTYPES}, f'of {DTYPES}', f)


@cli.program(define_flags, computes=False)
def main(f: flags.FlagValues) -> None:
  kinds = KINDS if f.network == 'both' else [f.network]
  groups = [[Combination(k, int(n), d) for k in kinds] for n in f.batch_size for d in f.dtype]
  end = time.monotonic() + f.seconds if f.seconds else math.inf
  process = ProcessPoolExecutor(1, multiprocessing.get_context('spawn'))
  with process if f.peer else contextlib.nullcontext() as peer:
    found = measure_all(
      groups, peer, steps=f.steps, profile=f.profile, end=end, path=f.json, programs=f.programs
    )
  say(format_results(found['training']))


def measure_all(
  groups: Sequence[Sequence[Combination]],
  peer: Executor | None,
  *,
  steps: int,
  profile: int,
  end: float,
  path: str | None,
  programs: str | None,
) -> dict[str, Any]:
  """Measures all combinations and prints the figures of each at once.

  Args:
    groups: the combinations, those that are compiled at the same time together.
    peer: a process for PyTorch; None for none.
    steps: timed in a round.
    profile: how many operations to print of each.
    end: no measurement begins after this time of the monotonic clock.
    path: of the JSON file, which is written anew after each combination; None for none.
    programs: folder for the text of the compiled programs; None for none.

  Raises:
    UserError: PyTorch is missing.
  """
  version = peer.submit(describe_peer) if peer else None  # it starts while programs are compiled
  found = {'machine': measuring.describe_machine(), 'training': []}
  say(texts.describe(found['machine'], {}))
  for combinations in groups:
    compiled = compile_all(combinations)
    if version and 'peer' not in found['machine']:
      try:
        found['machine']['peer'] = version.result()
      except ImportError as e:
        raise errors.UserError(f'{e}: install it in this environment, or say --nopeer') from e
      say(found['machine']['peer'])
    for combination in combinations:
      if time.monotonic() > end:
        say(f'{combination}: left out, time is up')
        continue
      try:
        program = compiled.pop(combination).result()
        if programs:
          name = '-'.join(map(str, combination))
          pathlib.Path(programs, f'{name}.txt').write_text(program.text)
        found['training'].append(measure(combination, program, peer, steps, profile))
      except jax.errors.JaxRuntimeError as e:  # such as too little memory
        say(f'{combination}: {str(e).splitlines()[0]}')
      if path:
        with atomic_write(path) as temporary, open(temporary, 'w') as f:
          json.dump(found, f, indent=2)
  return found


def compile_all(combinations: Sequence[Combination]) -> dict[Combination, Any]:
  """Compiles the training steps, all at the same time: a future of a `Program` for each.

  Returns when all are compiled, so that none disturbs what is timed.
  """
  tell(f'compiling {len(combinations)} programs')
  with ThreadPoolExecutor(os.cpu_count()) as threads:
    return {c: threads.submit(compile_step, c) for c in combinations}


def compile_step(combination: Combination) -> Program:
  """Compiles a training step for shapes alone."""
  kind, batch_size, dtype = combination
  start = time.perf_counter()
  network = NETWORKS[kind](mixed=dtype == 'mixed')
  state = jax.eval_shape(lambda: train.create_state(jax.random.key(0), network))
  step = train.make_step(network, OBJECTIVES[kind], PAPER)
  batch = jax.eval_shape(lambda: measuring.make_batch(batch_size))
  with jax.default_matmul_precision(PRECISIONS[dtype]):
    compiled = step.lower(state, batch).compile()
  seconds = time.perf_counter() - start
  m = compiled.memory_analysis()
  memory = m.temp_size_in_bytes + m.argument_size_in_bytes + m.output_size_in_bytes
  memory -= m.alias_size_in_bytes
  tell(f'{combination}: compiled in {seconds:.1f} s')
  operations = (compiled.cost_analysis() or {}).get('flops', 0.0)
  return Program(compiled, seconds, memory, operations, compiled.as_text())


def measure(
  combination: Combination, program: Program, peer: Executor | None, steps: int, profile: int
) -> dict[str, Any]:
  """All figures of one combination, which it prints."""
  kind, batch_size, dtype = combination
  found = {
    **combination._asdict(),
    'compiling': program.seconds,
    'memory': program.memory,
    'operations': program.operations,
    'seconds': [],
    'peer': [],
  }
  options = {'batch_size': batch_size, 'steps': steps, **PEER[dtype]}
  for _ in range(ROUNDS):
    found['seconds'].append(time_steps(program.step, kind, batch_size, steps))
    if peer:
      try:
        found['peer'].append(peer.submit(time_peer, kind, **options).result()[1:])
      except RuntimeError as e:  # PyTorch's own, such as too little memory
        say(f'{combination}: PyTorch: {str(e).splitlines()[0]}')
        peer = None
  rate = spread([batch_size / s for seconds in found['seconds'] for s in seconds])
  line = (
    f'{combination}: {show(rate)} images/s, {1e3 * batch_size / rate["median"]:.2f} ms a step,'
    f' {program.memory / 2**30:.2f} GiB, compiled in {program.seconds:.1f} s'
  )
  if found['peer']:
    theirs = spread([batch_size / s for seconds in found['peer'] for s in seconds])
    line += f'; PyTorch {show(theirs)}, ours is {rate["median"] / theirs["median"]:.2f} times as'
    line += ' fast'
  say(line)
  if profile:
    found['profile'] = profile_steps(program.step, kind, batch_size)
    say(profiling.format_operations(found['profile'][:profile]))
  return found


def time_steps(step: Callable, kind: str, batch_size: int, steps: int) -> list[float]:
  """Seconds of each step after the first."""
  run, seconds = run_steps(step, kind, batch_size), []
  next(run)
  for _ in range(steps):
    start = time.perf_counter()
    next(run)
    seconds.append(time.perf_counter() - start)
  return seconds


def profile_steps(step: Callable, kind: str, batch_size: int) -> list[dict[str, Any]]:
  """The operations of a step, the longest first."""
  run = run_steps(step, kind, batch_size)
  next(run)
  return profiling.profile(lambda: next(run), repeats=3)


def run_steps(step: Callable, kind: str, batch_size: int) -> Iterator[None]:
  """Takes a step at each `next`, and waits for its end."""
  state = train.create_state(jax.random.key(0), NETWORKS[kind]())
  batch = measuring.make_batch(batch_size)
  jax.block_until_ready((state, batch))
  while True:
    state, _ = jax.block_until_ready(step(state, batch))
    yield


def describe_peer() -> str:
  """PyTorch's version, in its process."""
  return importlib.import_module('experiments.perf.torch_peer').describe('cuda')


def time_peer(kind: str, **options) -> list[float]:
  """Seconds of PyTorch's steps, in its process; memory goes back to the card after them."""
  peer = importlib.import_module('experiments.perf.torch_peer')
  try:
    return peer.time_steps(kind, channels_last=True, device='cuda', **options)
  finally:
    importlib.import_module('torch').cuda.empty_cache()


def format_results(training: Sequence[dict[str, Any]]) -> str:
  """All combinations as a table in Markdown."""
  lines = [
    '| network | batch | products | images/s | PyTorch | ratio | memory, GiB | MiB an image |',
    '| --- | --- | --- | --- | --- | --- | --- | --- |',
  ]
  for f in training:
    size = f['batch_size']

    def rate(rounds, size=size):
      return spread([size / s for s in itertools.chain(*rounds)])['median'] if rounds else 0

    ours, theirs = rate(f['seconds']), rate(f['peer'])
    ratio = f'{ours / theirs:.2f}' if theirs else ''
    lines.append(
      f'| {f["kind"]} | {size} | {f["dtype"]} | {ours:.0f} | {theirs:.0f} | {ratio}'
      f' | {f["memory"] / 2**30:.1f} | {f["memory"] / 2**20 / size:.0f} |'
    )
  return '\n'.join(lines)


if __name__ == '__main__':
  os.environ.setdefault('XLA_PYTHON_CLIENT_PREALLOCATE', 'false')  # PyTorch is on the card, too
  main()
