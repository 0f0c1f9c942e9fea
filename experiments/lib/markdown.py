"""Markdown: tables, plain text, commands; everything that programs print or write in it."""

import html
import math
import re
from collections.abc import Iterable, Sequence

NONE = '–'  # in a cell that has no number


def table(head: Sequence[object], rows: Iterable[Sequence[object]], *, align: str = '') -> str:
  """A table: a line for the head, a rule, and a line for each row.

  Args:
    head: the names of the columns.
    rows: as many cells each, already Markdown; `str` is applied to anything else.
    align: a character for each column, '>' for right-aligned or '<'; all '<' by default.
  """
  rule = ['---:' if a == '>' else '---' for a in align or '<' * len(head)]
  lines = [head, rule, *rows]
  for line in lines:
    if len(line) != len(head):
      raise ValueError(f'a row of {len(line)} cells in a table of {len(head)} columns')
  cells = [[re.sub(r'(?<!\\)\|', r'\\|', str(cell)) for cell in line] for line in lines]
  return '\n'.join('| ' + ' | '.join(line) + ' |' for line in cells)


def numbers(head: Sequence[object], rows: Iterable[Sequence[object]], *, caption: str = '') -> str:
  """A table with labels in the first column and numbers, right-aligned, in the others."""
  text = table(head, rows, align='<' + '>' * (len(head) - 1))
  return f'{strong(caption)}\n\n{text}' if caption else text


def escape(text: object) -> str:
  """Plain text on one line; only code between backquotes keeps its meaning."""
  parts = re.split('(`[^`]+`)', str(text))
  plain = [p if n % 2 else re.sub(r'([\\`*_\[\]<|&])', r'\\\1', p) for n, p in enumerate(parts)]
  return ' '.join(''.join(plain).split())


def strong(text: object) -> str:
  return f'**{escape(text)}**'


def detail(text: object) -> str:
  """Text that pages set small, such as an error behind a number."""
  return f'*{escape(text)}*' if text else ''


def items(lines: Iterable[str]) -> str:
  """A list of lines of plain text."""
  return '\n'.join(f'* {escape(x)}' for x in lines)


def commands(lines: Iterable[tuple[str, float]]) -> str:
  """Commands, and how many seconds each took (NaN: unknown)."""
  shown = [x if math.isnan(seconds) else f'{x}  # {minutes(seconds)}' for x, seconds in lines]
  return '\n'.join(['```sh', *shown, '```'])


def fold(summary: str, text: str) -> str:
  """Markdown that a page hides below a line of plain text until that is clicked."""
  return f'<details><summary>{html.escape(summary)}</summary>\n\n{text}\n\n</details>'


def minutes(seconds: float) -> str:
  """A duration for people."""
  if seconds >= 3600:
    return f'{seconds / 3600:.1f} h'
  return f'{seconds / 60:.0f} min' if seconds >= 60 else f'{seconds:.0f} s'
