"""How every program of the project starts: flags, process settings, errors in one line.

Flags are defined when a program starts and not when its module is imported, because the flags of
several programs share names.
"""

import functools
from collections.abc import Callable, Sequence

from absl import flags

from cvn import environment, errors


def program(
  define_flags: Callable[[flags.FlagValues], None],
  *,
  computes: bool = True,
  start: Callable[[flags.FlagValues], None] | None = None,
):
  """A decorator that makes a function of parsed flags the `main` of a program.

  `main()` runs the program with the arguments of the process and ends the process. `main(argv)`
  calls the function with flags parsed from `argv`; it returns what the function returns and raises
  what it raises.

  Args:
    define_flags: defines the program's flags in a `FlagValues`.
    computes: whether to apply the process settings of `cvn.environment`.
    start: what the process does first, with the parsed flags; `main(argv)` leaves it out.
  """

  def decorate(body: Callable[[flags.FlagValues], int | None]):
    @functools.wraps(body)
    def main(argv: Sequence[str] | None = None) -> int | None:
      if argv is not None:
        return body(parse(define_flags, argv))
      if computes:
        environment.prepare()
      define_flags(flags.FLAGS)

      def run(_):
        if start is not None:
          start(flags.FLAGS)
        if computes:
          environment.check_platforms()
        return body(flags.FLAGS)

      return errors.run(run)

    return main

  return decorate


def parse(
  define_flags: Callable[[flags.FlagValues], None], argv: Sequence[str] = (), **named: object
) -> flags.FlagValues:
  """The values of a program's flags.

  Args:
    define_flags: defines them.
    argv: arguments of the form --name=value.
    **named: further flags by name.

  Raises:
    absl.flags.Error: an unknown flag, a bad value, or a required flag that is missing.
  """
  f = flags.FlagValues()
  define_flags(f)
  f(['program', *argv, *(f'--{k}={v}' for k, v in named.items())])
  return f
