"""Programs run one after the other: their time adds up, and a failure ends the work."""

import math
from typing import NamedTuple

import pytest

from cvn.errors import UserError
from experiments.lib import stages


def test_running_a_program_adds_up_its_seconds(tmp_path, capfd):
  folder = str(tmp_path / 'new')
  line = stages.run_program(folder, 'calendar', type='text')
  assert line == 'python -m calendar --type=text'
  assert capfd.readouterr().out.startswith(f'\n$ {line}\n')
  first = stages.read_seconds(folder)[line]
  assert first > 0
  stages.run_program(folder, 'calendar', type='text')
  assert stages.read_seconds(folder)[line] > first


def test_a_failing_program_ends_the_work(tmp_path):
  with pytest.raises(UserError, match='no_such_module ended with status 1'):
    stages.run_program(str(tmp_path), 'no_such_module')


def test_files_that_cannot_be_read_are_named(tmp_path):
  with pytest.raises(UserError, match=r'cannot read .*no\.json'):
    stages.read_json(str(tmp_path / 'no.json'))
  (tmp_path / 'half.json').write_text('{"a":')
  with pytest.raises(UserError, match=r'half\.json is damaged'):
    stages.read_json(str(tmp_path / 'half.json'))


def test_results_are_json_values_with_the_command(tmp_path):
  class Pair(NamedTuple):
    x: float
    y: tuple[float, ...]

  path = tmp_path / 'new/results.json'
  stages.write_results(str(path), {'pair': Pair(math.nan, (1.5, math.nan)), 'texts': ['a']})
  found = stages.read_json(str(path))
  assert found == {
    'argv': stages.argv(),
    'pair': {'x': None, 'y': [1.5, None]},
    'texts': ['a'],
  }
