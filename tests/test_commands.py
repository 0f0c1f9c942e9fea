"""The commands of a wheel are the programs of `python -m`."""

import importlib.util
import pathlib
import subprocess
import sys
import tomllib

from experiments import commands

ROOT = pathlib.Path(__file__).parent.parent


def test_every_command_has_its_program():
  with open(ROOT / 'pyproject.toml', 'rb') as f:
    scripts = tomllib.load(f)['project']['scripts']
  expected = {f'cvn-{name}': f'experiments.commands:{name}' for name in commands.PROGRAMS}
  assert scripts == expected
  for name, module in commands.PROGRAMS.items():
    assert callable(getattr(commands, name)) and importlib.util.find_spec(module)


def test_a_command_takes_the_flags_of_its_program(tmp_path):
  script = tmp_path / 'cvn-evaluate'
  script.write_text('from experiments.commands import evaluate\nevaluate()\n')
  command = [sys.executable, script, '--data=/nowhere', '--shape=/nowhere']
  done = subprocess.run(
    command, cwd=ROOT, env={'PYTHONPATH': str(ROOT)}, capture_output=True, text=True
  )
  assert done.returncode == 1
  assert done.stderr.startswith('error: /nowhere') and done.stderr.count('\n') == 1
