"""The demonstration's report: one HTML file that needs nothing beside it, and no network.

Pictures are data URIs, and the models' GLB files are embedded whole for experiments.viewer.
"""

import base64
import html
import io
from collections.abc import Sequence
from typing import NamedTuple

import matplotlib.figure

from experiments.lib import assets, viewer


class Example(NamedTuple):
  """One held-out picture and what became of it."""

  name: str
  panel: bytes  # PNG
  truth: bytes  # PNG
  glb: bytes
  links: Sequence[str]  # files to offer, relative to the page


class Curve(NamedTuple):
  """A quantity in the course of training."""

  title: str
  training: Sequence[tuple[float, float]]  # (epoch, value)
  validation: Sequence[tuple[float, float]]  # likewise


class Table(NamedTuple):
  """Numbers with a head above and a label before each row."""

  head: Sequence[str]
  rows: Sequence[tuple[str, Sequence[str]]]
  best: Sequence[int]  # the row to set in bold, one a column


class Page(NamedTuple):
  """All that the report shows."""

  about: str
  verdict: str
  success: bool
  examples: Sequence[Example]
  table: Table
  curves: Sequence[Curve]
  contact_sheet: bytes  # PNG
  commands: Sequence[tuple[str, float]]  # and the seconds each took


def render(page: Page) -> str:
  """The report as HTML."""
  total = sum(seconds for _, seconds in page.commands)
  kind = 'good' if page.success else 'bad'
  parts = [
    f'<p>{html.escape(page.about)}</p>',
    f'<p class="verdict {kind}">{html.escape(page.verdict)}</p>',
    '<h2>Held-out pictures and the models made from them</h2>',
    '<p>Drag to turn, scroll to zoom. The weight is yellow where the sampled colour counts and blue'
    ' where the regressed one does. The truth is drawn from the same directions.</p>',
    *(_example(i, e) for i, e in enumerate(page.examples)),
    '<h2>Evaluation on the held-out split</h2>',
    _table(page.table),
    '<h2>Training</h2>',
    f'<div class="curves">{"".join(_curve(c) for c in page.curves)}</div>',
    '<h2>The first objects of the data set</h2>',
    f'<img class="wide" alt="contact sheet" src="{_data_uri(page.contact_sheet)}">',
    f'<h2>Commands, {_minutes(total)} in all</h2>',
    *(f'<pre>{html.escape(c)}   # {_minutes(s)}</pre>' for c, s in page.commands),
  ]
  return assets.fill(
    'experiments',
    'demo.html',
    style=assets.read('experiments', 'demo.css'),
    body='\n'.join(parts),
    script=viewer.SCRIPT,
  )


def _example(index: int, example: Example) -> str:
  links = ' '.join(
    f'<a href="{html.escape(link)}" download>{html.escape(link.rsplit("/", 1)[-1])}</a>'
    for link in example.links
  )
  return f"""<section>
<h3>{html.escape(example.name)} <small>{links}</small></h3>
<div class="example">
{viewer.embed(f'glb{index}', example.glb, size=800)}
<div><img class="wide" alt="reconstruction" src="{_data_uri(example.panel)}">
<img class="wide" alt="truth" src="{_data_uri(example.truth)}"></div>
</div>
</section>"""


def _table(table: Table) -> str:
  head = ''.join(f'<th>{html.escape(h)}</th>' for h in ('', *table.head))
  lines = []
  for r, (label, values) in enumerate(table.rows):
    cells = ''.join(
      f'<td class="best">{html.escape(v)}</td>'
      if table.best[c] == r
      else f'<td>{html.escape(v)}</td>'
      for c, v in enumerate(values)
    )
    lines.append(f'<tr><th>{html.escape(label)}</th>{cells}</tr>')
  return f'<table><tr>{head}</tr>{"".join(lines)}</table>'


def _curve(curve: Curve) -> str:
  """A small line chart as inline SVG."""
  figure = matplotlib.figure.Figure(figsize=(4.4, 2.8), layout='constrained')
  axes = figure.subplots()
  if curve.training:
    axes.plot(*zip(*curve.training, strict=True), color='#4a7fc1', linewidth=1, label='training')
  if curve.validation:
    at = tuple(zip(*curve.validation, strict=True))
    axes.plot(*at, 'o-', color='#d9822b', markersize=3, label='validation')
  axes.set(title=curve.title, xlabel='epoch')
  axes.grid(alpha=0.3)
  axes.legend(frameon=False)
  text = io.StringIO()
  figure.savefig(text, format='svg', metadata={'Date': None})
  svg = text.getvalue()
  return svg[svg.index('<svg') :]


def _data_uri(png: bytes) -> str:
  return f'data:image/png;base64,{base64.b64encode(png).decode()}'


def _minutes(seconds: float) -> str:
  return f'{seconds / 60:.1f} min' if seconds >= 60 else f'{seconds:.0f} s'
