"""The conventions of cvn's public functions, checked on all of them."""

import ast
import doctest
import importlib
import inspect
import pkgutil
import re
import subprocess
import sys

import pytest

import cvn

PROGRAMS = ('cvn.ops.trial',)  # run by `python -m`, not called
MODULES = [
  importlib.import_module(m.name)
  for m in pkgutil.walk_packages(cvn.__path__, 'cvn.')
  if m.name not in PROGRAMS
]
FUNCTIONS = {
  f'{module.__name__}.{name}': f
  for module in MODULES
  for name, f in vars(module).items()
  if callable(f)
  and not name.startswith('_')
  and not inspect.isclass(f)
  and getattr(f, '__module__', '') == module.__name__
  and hasattr(f, '__name__')
}


def sections(f):
  """The sections of a docstring by name, the text before them by ''."""
  parts = re.split(r'^(Args|Returns|Yields|Raises):\n', inspect.getdoc(f) or '', flags=re.M)
  return {'': parts[0], **dict(zip(parts[1::2], parts[2::2], strict=True))}


def exceptions(f):
  """The names of what a function raises itself."""
  tree = ast.parse(inspect.cleandoc('\n' + inspect.getsource(inspect.unwrap(f))))
  raised = [n.exc for n in ast.walk(tree) if isinstance(n, ast.Raise) and n.exc]
  return {e.func.id for e in raised if isinstance(e, ast.Call) and isinstance(e.func, ast.Name)}


def test_there_are_functions():
  assert len(FUNCTIONS) > 100


def problems(f):
  """Everything about a function that is against the conventions."""
  signature, found = inspect.signature(f), sections(f)
  parameters = signature.parameters.values()
  if not found[''].strip():
    yield 'no docstring'
  for p in parameters:
    if p.default is not p.empty and p.kind != p.KEYWORD_ONLY:
      yield f'{p.name} has a positional default'
    if p.annotation is p.empty:
      yield f'{p.name} has no annotation'
  if signature.return_annotation is signature.empty:
    yield 'no annotation of the result'
  if len(parameters) > 2 or 'Args' in found:
    lines = re.findall(r'^  (\S.*?):', found.get('Args', ''), re.M)
    named = {name.lstrip('*') for line in lines for name in line.split(', ')}
    missing = [p.name for p in parameters if p.name not in named]
    if missing:
      yield f'Args does not name {", ".join(missing)}'
  for e in sorted(exceptions(f)):
    if e not in found.get('Raises', ''):
      yield f'Raises does not name {e}'


@pytest.mark.parametrize('name', FUNCTIONS)
def test_conventions(name):
  assert not list(problems(FUNCTIONS[name]))


def test_the_table_of_contents_has_every_module():
  assert set(cvn.__all__) == {m.name for m in pkgutil.iter_modules(cvn.__path__)}
  words = re.findall(r'\w+', cvn.__doc__)
  assert [name for name in cvn.__all__ if name not in words] == []


def test_modules_are_imported_on_first_use():
  code = (
    'import sys, cvn; assert "jax" not in sys.modules;'
    'assert cvn.grid.GRID_SIZE == 64 and "jax" not in sys.modules; assert "grid" in dir(cvn)'
  )
  subprocess.run([sys.executable, '-c', code], check=True)
  with pytest.raises(AttributeError, match="module 'cvn' has no attribute 'nothing'"):
    cvn.nothing  # noqa: B018


def test_examples_in_docstrings_are_true():
  results = [doctest.testmod(module) for module in MODULES]
  assert sum(r.failed for r in results) == 0
  assert sum(r.attempted for r in results) >= 10
