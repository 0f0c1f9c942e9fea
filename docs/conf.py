"""Sphinx configuration: the Markdown pages of this folder and an API reference (`make docs`)."""

import inspect
import pathlib
import re
import sys

sys.path.insert(0, str(pathlib.Path(__file__).parent.parent))  # document this checkout

project = 'CVN'
author = 'The CVN authors'
project_copyright = author
html_title = 'Colorful Voxel Network'
html_theme = 'sphinx_book_theme'
html_copy_source = False

extensions = [
  'myst_parser',
  'sphinx.ext.apidoc',
  'sphinx.ext.autodoc',
  'sphinx.ext.napoleon',
  'sphinx.ext.viewcode',
]
myst_heading_anchors = 3
default_role = 'code'

apidoc_modules = [
  {
    'path': f'../{package}',
    'destination': f'api/{package}',
    'separate_modules': True,
    'module_first': True,
    'automodule_options': {'members', 'undoc-members'},
  }
  for package in ('cvn', 'datagen')
]
autodoc_member_order = 'bysource'
napoleon_use_rtype = False

_SECTION = re.compile(r'(Args|Attributes|Raises|Returns|Yields):$')
_CODE = re.compile(r'(`[^`]*`)')


def setup(app):
  """Connects the translation of docstrings; it runs before napoleon's, which has priority 500."""
  app.connect('autodoc-process-docstring', _translate, priority=400)
  app.connect('autodoc-skip-member', _skip)


def _translate(app, what, name, obj, options, lines):
  """Turns a plain-text docstring into reStructuredText, and appends the fields of a NamedTuple.

  An indented block keeps its layout, unless it belongs to a section such as "Args". Characters that
  mean something in reStructuredText are escaped.
  """
  found, literal, section = [], False, False
  for line in lines:
    if line and not line.startswith(' '):
      section = bool(_SECTION.match(line))
    indented = line.startswith(' ') and not section
    if line and indented != literal:
      found += ['', '::', ''] if indented else ['']
      literal = indented
    found.append(line if literal else _escape(line))
  if what == 'class' and _is_named_tuple(obj):
    found += ['', '.. code-block:: python', '', *_fields(obj)]
  lines[:] = found


def _escape(line):
  parts = _CODE.split(line)
  for n in range(0, len(parts), 2):
    text = re.sub(r'([*|\\]|_(?=\W|$))', r'\\\1', parts[n])
    # Code must be separated from a word; a backslash and a space do that invisibly.
    if n and re.match(r'[\w^]', text):
      text = '\\ ' + text
    if n + 1 < len(parts) and re.search(r'\w$', text):
      text += '\\ '
    parts[n] = text
  return ''.join(parts)


def _is_named_tuple(obj):
  return issubclass(obj, tuple) and hasattr(obj, '_fields')


def _fields(cls):
  """The source lines of the fields, whose comments explain them."""
  lines = inspect.getsource(cls).splitlines()
  first = next(n for n, line in enumerate(lines) if re.match(rf'\s+{cls._fields[0]}\s*:', line))
  return [line for line in lines[first:] if not line.strip().startswith('@')]


def _skip(app, what, name, obj, skip, options):
  """Leaves out the fields of a NamedTuple as members of their own."""
  return skip or (inspect.getdoc(obj) or '').startswith('Alias for field number')
