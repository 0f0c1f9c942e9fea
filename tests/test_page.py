"""Pages of Markdown: as text with pictures beside it, and as HTML that needs nothing beside it."""

import base64
import re

import matplotlib
import matplotlib.figure
import pages
import pytest

from experiments.lib import charts, markdown, page, viewer
from experiments.lib.page import Picture

EVIL = '<script>alert("1")</script> & | *x* [y](z) `a<b|c`'
SHOWN = '&lt;script&gt;alert(&quot;1&quot;)&lt;/script&gt; &amp; | *x* [y](z) <code>a&lt;b|c</code>'
EVIL_PICTURE = Picture('evil', b'png', EVIL, width=300)


def chart():
  with matplotlib.rc_context(charts.STYLE):
    figure = matplotlib.figure.Figure()
    axes = figure.subplots()
    axes.plot([0, 1], label='a < b')
    axes.legend()
  return charts.to_picture(figure, 'chart', 'A "chart" & more')


def blocks():
  model = viewer.embed('m', b'glTF', size=10)
  return [
    '# The page\n\nAbout it.',
    f'## First: {markdown.escape(EVIL)}',
    markdown.escape(EVIL),
    markdown.items([EVIL]),
    markdown.numbers(['', markdown.escape(EVIL)], [[markdown.escape(EVIL), 1]], caption=EVIL),
    EVIL_PICTURE,
    chart(),
    '## Second',
    Picture('models', b'still', '', f'<div class="row">{model}</div>'),
    markdown.fold('Measured <b>', markdown.commands([('python -m a --b="<c>"', 90.0)])),
  ]


@pytest.fixture(scope='module')
def html():
  return page.to_html(blocks())


def test_the_page_needs_nothing_from_elsewhere(html):
  pages.check_alone(html)


def test_text_is_shown_as_text(html):
  assert html.count(SHOWN) == 8  # contents, heading, paragraph, item, caption, head, cell, picture
  assert 'python -m a --b=&quot;&lt;c&gt;&quot;  # 2 min' in html
  assert '<summary>Measured &lt;b&gt;</summary>' in html


def test_sections_are_listed(html):
  links = [a['href'] for t, a in pages.Tags(html).tags if t == 'a']
  assert len(links) == 2 and links[1] == '#second'
  assert all(f'<h2 id="{link[1:]}">' in html for link in links)


def test_pictures_have_captions_and_better_forms(html):
  tags = pages.Tags(html).tags
  images = [a for t, a in tags if t == 'img']
  assert [base64.b64decode(a['src'].partition(',')[2]) for a in images] == [b'png']
  assert images[0]['alt'] == EVIL and '300px' in images[0]['style']
  names = [t for t, _ in tags if t in ('figure', 'figcaption', 'svg', 'canvas')]
  assert names == ['figure', 'figcaption', 'figure', 'svg', 'figcaption', 'figure', 'canvas']


def test_the_text_names_the_pictures_that_are_written():
  text, files = page.to_markdown(blocks()), page.pictures(blocks())
  assert re.findall(r'\]\((\S+\.png)\)', text) == [*files]
  assert [*files] == ['evil.png', 'chart.png', 'models.png']
  assert files['models.png'] == b'still' and files['chart.png'].startswith(b'\x89PNG')


def test_charts_take_the_colour_of_the_page_and_have_names_of_their_own():
  svg = chart().html
  assert 'currentColor' in svg and charts.INK not in svg
  assert all(name.startswith('chart-') for name in re.findall(r'\bid="([^"]+)"', svg))
  used = re.findall(r'(?:href="#|url\(#)([^")]+)', svg)
  assert used and {*used} <= {*re.findall(r'\bid="([^"]+)"', svg)}
  assert 'a &lt; b' in svg and chart() == chart()
