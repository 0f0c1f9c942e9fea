"""Another program that trains the same networks, to be timed in turn with ours."""

import os
import re
import shlex
import subprocess

from cvn.errors import UserError

FIGURE = re.compile(r'([0-9]+(?:\.[0-9]+)?) images/s')


def make_command(template: str, *, network: str, batch: int, dtype: str) -> list[str]:
  """Fills in {network}, {batch} and {dtype}.

  Raises:
    UserError: there is another field, a brace that is none, or a quote without its end.
  """
  try:
    words = shlex.split(template)
    return [word.format(network=network, batch=batch, dtype=dtype) for word in words]
  except (KeyError, IndexError, ValueError) as e:
    raise UserError(
      f'--peer={template!r} cannot be read ({e}): its fields are {{network}}, {{batch}}, {{dtype}}'
    ) from e


def measure(command: list[str]) -> float:
  """Runs it and returns the images/s it prints; the last such figure counts.

  It does not get the library that our own processes are started under (see cvn.environment).

  Raises:
    UserError: it cannot be run, fails, or prints none.
  """
  shown = shlex.join(command)
  try:
    environment = {k: v for k, v in os.environ.items() if k != 'LD_PRELOAD'}
    done = subprocess.run(
      command, capture_output=True, text=True, errors='replace', env=environment
    )
  except OSError as e:
    raise UserError(f'the peer cannot be run ({e.strerror}): {shown}') from e
  last = (done.stderr.strip() or done.stdout.strip() or 'no output').splitlines()[-1]
  if done.returncode != 0:
    raise UserError(f'the peer ended with status {done.returncode} ({last}): {shown}')
  figures = [float(x) for x in FIGURE.findall(done.stdout)]
  if not figures or figures[-1] <= 0:
    raise UserError(f"the peer prints no figure such as '8.5 images/s' ({last}): {shown}")
  return figures[-1]
