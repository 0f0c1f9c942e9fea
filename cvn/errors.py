"""The exception for problems that the user can solve. Programs print it as one line."""

import sys
from collections.abc import Callable

from absl import app, flags, logging


class UserError(Exception):
  """Bad input; the message names the file or value and the way out, in one line."""


def run(main: Callable[[list[str]], int | None]) -> None:
  """Runs an absl program: `UserError` and an interrupt end it with one line and status 1."""

  def guarded(argv):
    if len(argv) > 1:
      raise app.UsageError(f'unexpected argument: {argv[1]!r} (flags look like --name=value)')
    if not flags.FLAGS['verbosity'].present:
      logging.set_verbosity(logging.WARNING)  # absl's default tells of every backend not found
    try:
      return main(argv)
    except UserError as e:
      line = ' '.join(str(e).split())
      print(f'error: {line}', file=sys.stderr)
    except KeyboardInterrupt:
      print('interrupted', file=sys.stderr)
    return 1

  app.run(guarded)
