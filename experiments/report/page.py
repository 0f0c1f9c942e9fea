"""The report as one HTML page that needs nothing beside it, and no network."""

import base64
import html
import math
import re

from experiments.lib import assets, viewer
from experiments.report.blocks import (
  Block,
  Cell,
  Commands,
  Example,
  Examples,
  Heading,
  Items,
  Missing,
  Picture,
  Report,
  Section,
  Table,
  Text,
)

CANVAS = 560  # pixels; pages show it smaller, screens with twice the pixels as it is


def render(report: Report) -> str:
  """The page."""
  contents = ''.join(f'<a href="#{s.anchor}">{_text(s.title)}</a>' for s in report.sections)
  abstract = ''.join(f'<p>{_text(p)}</p>' for p in report.abstract)
  sections = '\n'.join(_section(s) for s in report.sections)
  return assets.fill(
    'experiments.report',
    'page.html',
    title=_text(report.title),
    style=assets.read('experiments.report', 'page.css'),
    made=_text(report.made),
    abstract=abstract,
    contents=contents,
    sections=sections,
    script=viewer.SCRIPT + assets.read('experiments.report', 'page.js'),
  )


def minutes(seconds: float) -> str:
  """A time for people."""
  if seconds >= 3600:
    return f'{seconds / 3600:.1f} h'
  return f'{seconds / 60:.0f} min' if seconds >= 60 else f'{seconds:.0f} s'


def _section(section: Section) -> str:
  blocks = '\n'.join(_block(section.anchor, n, b) for n, b in enumerate(section.blocks))
  title = f'<h2>{_text(section.title)}</h2>'
  return f'<section id="{section.anchor}">\n{title}\n{blocks}\n</section>'


def _block(anchor: str, index: int, block: Block) -> str:
  match block:
    case Heading(text):
      return f'<h3>{_text(text)}</h3>'
    case Text(text):
      return f'<p>{_text(text)}</p>'
    case Missing(what, command):
      return f'<p class="missing">{_text(what)} <code>{html.escape(command)}</code></p>'
    case Items(lines):
      return '<ul>' + ''.join(f'<li>{_text(x)}</li>' for x in lines) + '</ul>'
    case Table():
      return _table(block)
    case Picture():
      return _picture(block)
    case Commands():
      return _commands(block)
    case Examples():
      shown = [_example(f'{anchor}-{index}-{n}', e) for n, e in enumerate(block.examples)]
      return ''.join(shown) + f'<p class="caption">{_text(block.still.caption)}</p>'


def _table(table: Table) -> str:
  kind = 'words' if table.words else 'numbers'
  # A column's details are a column of their own, so that numbers stay below each other.
  wide = [any(cells[n].detail for _, cells in table.rows) for n in range(len(table.columns))]
  lines = []
  if table.groups:
    heads, at = ['<td></td>'], 0
    for title, count in table.groups:
      span = count + sum(wide[at : at + count])
      heads.append(f'<th class="group" colspan="{span}" scope="colgroup">{_text(title)}</th>')
      at += count
    lines.append(f'<tr>{"".join(heads)}</tr>')
  starts = _starts(table)
  heads = [
    f'<th scope="col"{_classes(start=n in starts)}{" colspan=2" * wide[n]}>{_text(c)}</th>'
    for n, c in enumerate(table.columns)
  ]
  lines.append(f'<tr><td></td>{"".join(heads)}</tr>')
  body = []
  for label, cells in table.rows:
    row = ''.join(_cell(c, wide[n], n in starts) for n, c in enumerate(cells))
    body.append(f'<tr><th scope="row">{_text(label)}</th>{row}</tr>')
  return (
    f'<figure class="table"><figcaption>{_text(table.caption)}</figcaption><div class="scroll">'
    f'<table class="{kind}"><thead>{"".join(lines)}</thead><tbody>{"".join(body)}</tbody></table>'
    '</div></figure>'
  )


def _starts(table: Table) -> set[int]:
  """The columns with which groups begin."""
  starts, at = set(), 0
  for _, count in table.groups:
    starts.add(at)
    at += count
  return starts


def _cell(cell: Cell, wide: bool, start: bool) -> str:
  text = f'<td{_classes(best=cell.best, start=start)}>{_text(cell.text)}</td>'
  return text + (f'<td class="detail">{_text(cell.detail)}</td>' if wide else '')


def _classes(**named: bool) -> str:
  kept = ' '.join(name for name, there in named.items() if there)
  return f' class="{kept}"' if kept else ''


def _picture(picture: Picture) -> str:
  label = html.escape(picture.caption)
  if picture.svg:
    kind, drawn = 'plot', picture.svg.replace('<svg', f'<svg role="img" aria-label="{label}"', 1)
  else:
    limit = f' style="max-width: min(100%, {picture.width}px)"' if picture.width else ''
    source = f'src="{_data_uri(picture.png)}" loading="lazy"'
    kind, drawn = 'picture', f'<img alt="{label}" {source}{limit}>'
  return f'<figure class="{kind}">{drawn}<figcaption>{_text(picture.caption)}</figcaption></figure>'


def _commands(commands: Commands) -> str:
  lines = [
    f'<li><code>{_command(line)}</code>'
    + ('' if math.isnan(seconds) else f' <span class="time">{minutes(seconds)}</span>')
    + '</li>'
    for line, seconds in commands.lines
  ]
  listed = f'<ol class="commands">{"".join(lines)}</ol>'
  if not all(math.isnan(seconds) for _, seconds in commands.lines):
    return f'<details><summary>{_text(commands.title)}</summary>{listed}</details>'
  return f'<p>{_text(commands.title)}</p>{listed}'


def _command(line: str) -> str:
  """With its arguments kept whole where lines break."""
  return ' '.join(f'<span>{html.escape(part)}</span>' for part in line.split(' '))


def _example(name: str, example: Example) -> str:
  cells = [
    f'<div><img class="view" alt="the input view" src="{_data_uri(example.view)}">'
    '<span>input</span></div>'
  ]
  for n, model in enumerate(example.models):
    canvas = (
      viewer.embed(f'{name}-{n}', model.glb, size=CANVAS, group=name, azimuth=example.azimuth)
      if model.glb
      else '<div class="viewer"></div>'
    )
    note = f'<small>{_text(model.note)}</small>'
    cells.append(f'<div>{canvas}<span>{_text(model.title)}{note}</span></div>')
  return (
    f'<figure class="example"><div class="row">{"".join(cells)}</div>'
    f'<figcaption><b>{_text(example.title)}.</b> {_text(example.credit)}</figcaption></figure>'
  )


def _text(text: str) -> str:
  """Escaped; a part of a command or path between backquotes is set as code."""
  return re.sub(r'`([^`]+)`', r'<code>\1</code>', html.escape(text))


def _data_uri(png: bytes) -> str:
  return f'data:image/png;base64,{base64.b64encode(png).decode()}'
