"""A program's function gets its flags, from the process or from a list."""

import pytest
from absl import flags

from cvn.errors import UserError
from experiments.lib import cli


def define_flags(f):
  flags.DEFINE_integer('count', 1, 'A number.', flag_values=f)


@cli.program(define_flags)
def main(f):
  """Doubles a number."""
  if f.count < 0:
    raise UserError('no')
  return 2 * f.count


def test_arguments_may_be_a_list():
  assert main([]) == 2 and main(['--count=4']) == 8
  assert main.__doc__ == 'Doubles a number.'
  with pytest.raises(UserError):
    main(['--count=-1'])
  with pytest.raises(flags.Error):
    main(['--size=1'])


def test_the_process_ends_with_the_status(monkeypatch, capsys):
  """Without a list the arguments are the process's, and errors are one line."""
  monkeypatch.setattr(flags, 'FLAGS', flags.FlagValues())
  seen = []

  def run(guarded):
    seen.append(flags.FLAGS['count'].value)
    return guarded([])

  monkeypatch.setattr(cli.errors, 'run', run)
  monkeypatch.setattr(cli.environment, 'prepare', lambda: seen.append('prepared'))
  monkeypatch.setattr(cli.environment, 'check_platforms', lambda: seen.append('checked'))
  flags.FLAGS.mark_as_parsed()
  assert main() == 2 and seen == ['prepared', 1, 'checked']


def test_a_process_joins_others_before_anything_looks_at_the_devices(monkeypatch):
  monkeypatch.setattr(flags, 'FLAGS', flags.FlagValues())
  seen = []
  start = cli.program(define_flags, start=lambda f: seen.append(f['count'].value))
  joined = start(lambda f: seen.append('body') or 0)
  monkeypatch.setattr(cli.errors, 'run', lambda guarded: guarded([]))
  monkeypatch.setattr(cli.environment, 'prepare', lambda: seen.append('prepared'))
  monkeypatch.setattr(cli.environment, 'check_platforms', lambda: seen.append('checked'))
  flags.FLAGS.mark_as_parsed()
  assert joined() == 0 and seen == ['prepared', 1, 'checked', 'body']
  assert joined([]) == 0 and seen[4:] == ['body']
