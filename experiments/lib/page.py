"""Pages: Markdown with pictures, and the same as one HTML file that needs nothing beside it.

In Markdown a picture is a file beside the text. In HTML it is part of the page, and something
better may take its place: an SVG drawing, or models that can be turned.
"""

import base64
import html
import re
from collections.abc import Iterable
from typing import NamedTuple

from markdown_it import MarkdownIt

from experiments.lib import assets, markdown, viewer


class Picture(NamedTuple):
  """A picture in a page."""

  name: str  # of its file, without the suffix
  png: bytes
  caption: str  # plain text below the picture
  html: str = ''  # shown in HTML in place of the PNG
  width: int = 0  # CSS pixels in HTML at most; 0 for no limit


Block = str | Picture  # Markdown, or a picture


def to_markdown(blocks: Iterable[Block]) -> str:
  """The text of a page; `pictures` are its files."""
  return '\n\n'.join(_reference(b) if isinstance(b, Picture) else b for b in blocks) + '\n'


def pictures(blocks: Iterable[Block]) -> dict[str, bytes]:
  """The PNG files that the Markdown names."""
  return {f'{b.name}.png': b.png for b in blocks if isinstance(b, Picture)}


def to_html(blocks: Iterable[Block]) -> str:
  """The page as HTML: title and text before the first section, contents, sections (`##`)."""
  blocks = list(blocks)
  shown = {f'{b.name}.png': b.html or image(b) for b in blocks if isinstance(b, Picture)}
  parser = MarkdownIt('commonmark', {'html': True}).enable('table')
  parser.add_render_rule('image', lambda _, tokens, n, *__: shown[tokens[n].attrs['src']])
  parser.add_render_rule('table_open', lambda *_: '<div class="scroll"><table>\n')
  parser.add_render_rule('table_close', lambda *_: '</table></div>\n')
  tokens = parser.parse(to_markdown(blocks))
  sections = []
  for n, token in enumerate(tokens):
    if token.type == 'heading_open' and token.tag == 'h2':
      title = parser.renderInline(tokens[n + 1].content)
      name = re.sub(r'\W+', '-', tokens[n + 1].content.lower()).strip('-')
      token.attrSet('id', name)
      sections.append((n, f'<a href="#{name}">{title}</a>'))
    elif token.type == 'inline' and token.children and token.children[0].type == 'image':
      tokens[n - 1].tag = tokens[n + 1].tag = 'figure'
      for child in token.children:
        if child.type in ('em_open', 'em_close'):
          child.tag = 'figcaption'
  first = sections[0][0] if sections else len(tokens)
  (title,) = re.findall('^# (.*)', blocks[0] if isinstance(blocks[0], str) else '', re.MULTILINE)
  return assets.fill(
    'experiments.lib',
    'page.html',
    title=parser.renderInline(title),
    style=assets.read('experiments.lib', 'page.css'),
    header=parser.renderer.render(tokens[:first], parser.options, {}),
    contents=' '.join(link for _, link in sections),
    body=parser.renderer.render(tokens[first:], parser.options, {}),
    script=viewer.SCRIPT,
  )


def image(picture: Picture) -> str:
  """A picture as an <img> that holds its own data."""
  limit = f' style="max-width: min(100%, {picture.width}px)"' if picture.width else ''
  return f'<img alt="{html.escape(picture.caption)}" src="{data_uri(picture.png)}"{limit}>'


def data_uri(png: bytes) -> str:
  return f'data:image/png;base64,{base64.b64encode(png).decode()}'


def _reference(picture: Picture) -> str:
  caption = markdown.escape(picture.caption)
  return f'![{caption}]({picture.name}.png)\n' + (f'*{caption}*' if caption else '')
