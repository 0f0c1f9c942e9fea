"""The same training step in PyTorch (torch_peer.py), to be timed in turn with ours.

It runs in an environment of its own: PyTorch is no dependency of this project.
"""

import itertools
import pathlib
import re
import shlex
import subprocess
from collections.abc import Sequence
from typing import NamedTuple

from cvn.errors import UserError

PROGRAM = pathlib.Path(__file__).with_name('torch_peer.py')
OPTIONS = ('default', 'channels_last', 'compile', 'channels_last+compile')
# What may be the fastest for each of our types: without fast bfloat16, float32 is.
DTYPES = {'float32': ('float32',), 'mixed': ('float32', 'bfloat16')}
TIMEOUT = 180  # s; without fast bfloat16 instructions a bfloat16 step takes minutes
_FIGURE = re.compile(r'([0-9]+(?:\.[0-9]+)?) images/s')


class Setting(NamedTuple):
  """How PyTorch runs the step."""

  dtype: str  # 'float32' or 'bfloat16'
  options: str  # one of `OPTIONS`

  def __str__(self) -> str:
    return f'{self.dtype}, {self.options}'


class Trial(NamedTuple):
  """A process of the peer."""

  rate: float  # images/s
  version: str  # of PyTorch, with what it says of the processor


def list_settings(dtype: str, options: Sequence[str]) -> list[Setting]:
  """The settings to try.

  Args:
    dtype: ours, 'float32' or 'mixed'.
    options: of `OPTIONS`.
  """
  return [Setting(*pair) for pair in itertools.product(DTYPES[dtype], options)]


def make_command(
  python: str,
  setting: Setting,
  *,
  network: str,
  batch_size: int,
  steps: int,
  platform: str = 'cpu',
) -> list[str]:
  """The command that times a setting.

  Args:
    python: an interpreter that has PyTorch.
    setting: how PyTorch runs the step.
    network: 'shape' or 'color'.
    batch_size: views in a step.
    steps: timed after the first.
    platform: JAX's name of ours. On a 'gpu' both may round float32 factors to TF32, as JAX does.
  """
  chosen = [] if setting.options == 'default' else setting.options.split('+')
  return [
    python,
    str(PROGRAM),
    f'--network={network}',
    f'--batch_size={batch_size}',
    f'--steps={steps}',
    f'--dtype={setting.dtype}',
    *(f'--{option}' for option in chosen),
    *(('--device=cuda', '--tf32') if platform == 'gpu' else ()),
  ]


def run(command: Sequence[str], *, timeout: float | None = None) -> Trial | None:
  """Runs a command of `make_command`; None if time is up before it ends.

  Args:
    command: the interpreter and its arguments.
    timeout: seconds; None for no limit.

  Raises:
    UserError: it cannot be run, fails, or prints no 'X images/s', the last of which counts.
  """
  shown = shlex.join(command)
  try:
    done = subprocess.run(
      command, capture_output=True, text=True, errors='replace', timeout=timeout
    )
  except subprocess.TimeoutExpired:
    return None
  except OSError as e:
    raise UserError(f'--peer_python cannot be run ({e.strerror}): {shown}') from e
  last = (done.stderr.strip() or done.stdout.strip() or 'no output').splitlines()[-1]
  if done.returncode != 0:
    raise UserError(f'PyTorch ended with status {done.returncode} ({last}): {shown}')
  figures = [float(x) for x in _FIGURE.findall(done.stdout)]
  if not figures or figures[-1] <= 0:
    raise UserError(f"PyTorch prints no figure such as '8.5 images/s' ({last}): {shown}")
  return Trial(figures[-1], done.stdout.splitlines()[0])
