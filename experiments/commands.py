"""The commands of an installed wheel: `cvn-train` is `python -m experiments.train`, and so on.

pyproject.toml lists them. Each runs its program's module as `python -m` does, so that there is one
way into a program.
"""

import runpy

PROGRAMS = {
  'generate': 'datagen.generate',
  'inspect': 'datagen.inspect',
  'train': 'experiments.train',
  'evaluate': 'experiments.evaluate',
  'reconstruct': 'experiments.reconstruct',
  'demo': 'experiments.demo',
}


def generate() -> None:
  """Meshes to a data set."""
  _run('generate')


def inspect() -> None:
  """What a data set holds."""
  _run('inspect')


def train() -> None:
  """Trains a network."""
  _run('train')


def evaluate() -> None:
  """Evaluates trained networks."""
  _run('evaluate')


def reconstruct() -> None:
  """Images to coloured meshes."""
  _run('reconstruct')


def demo() -> None:
  """The whole system at work."""
  _run('demo')


def _run(name):
  runpy.run_module(PROGRAMS[name], run_name='__main__', alter_sys=True)
