"""The report as Markdown, with its pictures as files beside it."""

import math

from experiments.lib import markdown
from experiments.report.blocks import (
  Block,
  Cell,
  Commands,
  Examples,
  Heading,
  Items,
  Missing,
  Picture,
  Report,
  Table,
  Text,
)
from experiments.report.page import minutes


def render(report: Report) -> str:
  """The text; pictures are named as `pictures` gives them."""
  parts = [f'# {_text(report.title)}', _text(report.made), *map(_text, report.abstract)]
  for section in report.sections:
    parts.append(f'## {_text(section.title)}')
    parts += [_block(b) for b in section.blocks]
  return '\n\n'.join(parts) + '\n'


def pictures(report: Report) -> dict[str, bytes]:
  """The PNG files that the text names."""
  found = {}
  for block in (b for section in report.sections for b in section.blocks):
    picture = block.still if isinstance(block, Examples) else block
    if isinstance(picture, Picture):
      found[f'{picture.name}.png'] = picture.png
  return found


def _block(block: Block) -> str:
  match block:
    case Heading(text):
      return f'### {_text(text)}'
    case Text(text):
      return _text(text)
    case Missing(what, command):
      return f'*{_text(what)}* `{command}`'
    case Items(lines):
      return '\n'.join(f'* {_text(x)}' for x in lines)
    case Table():
      return _table(block)
    case Picture(name, _, caption):
      return f'![{_text(caption)}]({name}.png)\n\n*{_text(caption)}*'
    case Commands(title, lines):
      shown = [
        line if math.isnan(seconds) else f'{line}  # {minutes(seconds)}' for line, seconds in lines
      ]
      return f'{_text(title)}\n\n```sh\n' + '\n'.join(shown) + '\n```'
    case Examples(examples, still):
      credits = '\n'.join(f'* {_text(e.title)}: {_text(e.credit)}' for e in examples)
      return f'{_block(still)}\n\n{credits}'


def _table(table: Table) -> str:
  groups = [title for title, count in table.groups for _ in range(count)]
  heads = [
    ': '.join(x for x in pair if x)
    for pair in zip(groups or [''] * len(table.columns), table.columns, strict=True)
  ]
  rows = [[_text(label), *map(_cell, cells)] for label, cells in table.rows]
  align = '<' + ('<' if table.words else '>') * len(heads)
  shown = markdown.table(['', *heads], rows, align=align)
  return f'**{_text(table.caption)}**\n\n{shown}'


def _cell(cell: Cell) -> str:
  text = f'**{_text(cell.text)}**' if cell.best else _text(cell.text)
  return f'{text} {_text(cell.detail)}' if cell.detail else text


def _text(text: str) -> str:
  """With what Markdown or HTML would take for marks made harmless."""
  parts = text.split('`')
  plain = [_plain(p) if n % 2 == 0 else p for n, p in enumerate(parts)]
  return '`'.join(plain).replace('|', '\\|').replace('\n', ' ')


def _plain(text: str) -> str:
  for mark in ('\\', '*', '_', '[', ']', '<'):
    text = text.replace(mark, f'\\{mark}')
  return text
