"""The report as HTML and as Markdown: the same content, and nothing of it taken for marks."""

import base64
import math
import re
from html.parser import HTMLParser

import pytest

from experiments.report import markdown as report_markdown
from experiments.report import page as report_page
from experiments.report import plots as report_plots
from experiments.report.blocks import (
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
  Turnable,
)
from experiments.report.results import Line, Lines, Number

EVIL = '<script>alert("1")</script> & | *x* `a<b`'


def plot():
  lines = Lines([Line('a < b', {'car': Number(0.5, 0.1, 4, 0.25)}, [0.5], math.nan)], [])
  return report_plots.bars({'<a>': lines}, 'plot', 'IoU', 'A plot')


def report():
  table = Table(
    'Numbers ' + EVIL,
    [('car', 2), ('avg.', 1)],
    ['here', 'paper', 'here'],
    [
      ('ours', [Cell('0.5', '± 0.1', True), Cell('0.4'), Cell('0.2')]),
      (EVIL, [Cell('0.1'), Cell('–'), Cell(EVIL)]),
    ],
  )
  models = [
    Turnable('ours', 'IoU 0.5', b'glTF'),
    Turnable('nothing', '', b''),
    Turnable('truth', '', b'\x1f\x8b'),
  ]
  example = Example('chair, from 30°', b'view', 60, models, 'Someone & Sons, CC-BY')
  return Report(
    'The report',
    ['About ' + EVIL],
    'Made today.',
    [
      Section('one', 'First', [Heading('Part'), Text(EVIL), Items(['a', EVIL]), table]),
      Section(
        'two',
        'Second',
        [
          Missing('Not made', 'python -m a --b=<c>'),
          Picture('picture', b'png', EVIL, width=300),
          plot(),
          Commands('In order', [('python -m a', math.nan)]),
          Commands('Measured', [('python -m b', 90.0), ('python -m c', 7200.0)]),
          Examples([example], Picture('still', b'still', 'Drawn at random')),
        ],
      ),
    ],
  )


class _Tags(HTMLParser):
  """Collects tags and texts, and complains of tags that are not closed in order."""

  VOID = ('meta', 'img', 'br', 'link')

  def __init__(self, text):
    super().__init__()
    self.tags, self.open, self.texts = [], [], []
    self.feed(text)
    self.close()
    assert self.open == []

  def handle_starttag(self, tag, attrs):
    self.tags.append((tag, dict(attrs)))
    if tag not in self.VOID:
      self.open.append(tag)

  def handle_startendtag(self, tag, attrs):
    self.tags.append((tag, dict(attrs)))

  def handle_endtag(self, tag):
    assert self.open.pop() == tag

  def handle_data(self, data):
    self.texts.append(data)


@pytest.fixture(scope='module')
def page():
  return report_page.render(report())


def test_page_is_well_formed_and_needs_nothing_from_elsewhere(page):
  tags = _Tags(page).tags
  for tag, attributes in tags:
    assert tag != 'link'
    assert attributes.get('src', 'data:').startswith('data:')
    assert attributes.get('href', '#').startswith('#')
    assert not any(name.startswith('on') for name in attributes)
  assert 'http' not in page.replace('http-equiv', '')
  (policy,) = (a['content'] for t, a in tags if a.get('http-equiv') == 'Content-Security-Policy')
  assert policy.startswith("default-src 'none'; ")
  names = [a['id'] for _, a in tags if 'id' in a]
  assert len(names) == len({*names})


def test_page_shows_text_as_text(page):
  tags = _Tags(page)
  scripts = [a for t, a in tags.tags if t == 'script']
  assert len(scripts) == 3  # two models and the viewer
  assert page.count('&lt;script&gt;alert(&quot;1&quot;)&lt;/script&gt;') == 8
  assert '<code>a&lt;b</code>' in page
  assert 'python -m a --b=&lt;c&gt;' in page.replace('<span>', '').replace('</span>', '')


def test_page_numbers_and_their_details_are_columns_of_their_own(page):
  ours = re.search(r'<th scope="row">ours</th>(.*?)</tr>', page).group(1)
  assert ours == (
    '<td class="best start">0.5</td><td class="detail">± 0.1</td><td>0.4</td>'
    '<td class="start">0.2</td>'
  )
  assert '<th class="group" colspan="3" scope="colgroup">car</th>' in page


def test_page_embeds_the_models_of_a_line_as_one_group(page):
  viewers = [a for t, a in _Tags(page).tags if t == 'canvas']
  assert len({a['data-group'] for a in viewers}) == 1 and len(viewers) == 2
  assert [a['data-azimuth'] for a in viewers] == ['60', '60']
  found = [re.search(f'id="{a["data-glb"]}">(.*?)</script>', page).group(1) for a in viewers]
  assert [base64.b64decode(f) for f in found] == [b'glTF', b'\x1f\x8b']


def test_page_folds_commands_that_were_measured(page):
  assert re.search(r'<details><summary>Measured</summary>.*2 min.*2.0 h', page)
  assert page.count('<details>') == 1


def test_plots_take_the_pages_colour_and_have_names_of_their_own(page):
  svg = plot().svg
  assert 'currentColor' in svg and report_plots.INK not in svg
  assert all(name.startswith('plot-') for name in re.findall(r'\bid="([^"]+)"', svg))
  used = re.findall(r'(?:href="#|url\(#)([^")]+)', svg)
  assert used and {*used} <= {*re.findall(r'\bid="([^"]+)"', svg)}
  assert 'a &lt; b' in svg and plot() == plot()


def test_markdown_says_the_same():
  text = report_markdown.render(report())
  assert '## First' in text and '### Part' in text
  assert '|  | car: here | car: paper | avg.: here |\n| --- | ---: | ---: | ---: |' in text
  assert '| ours | **0.5** ± 0.1 | 0.4 | 0.2 |' in text
  assert 'python -m b  # 2 min' in text and 'python -m a\n' in text
  assert '* chair, from 30°: Someone & Sons, CC-BY' in text
  assert '*Not made* `python -m a --b=<c>`' in text


def test_markdown_takes_text_for_text():
  text = report_markdown.render(report())
  assert '<script>' not in text.replace('\\<script>', '')
  assert '\\*x\\*' in text and '`a<b`' in text
  row = next(x for x in text.splitlines() if x.startswith('| \\<script>'))
  assert len(re.findall(r'(?<!\\)\|', row)) == 5


def test_markdown_names_the_pictures_that_are_written():
  text, pictures = report_markdown.render(report()), report_markdown.pictures(report())
  assert {*re.findall(r'\((\w+\.png)\)', text)} == {*pictures}
  assert pictures['still.png'] == b'still' and pictures['plot.png'].startswith(b'\x89PNG')


@pytest.mark.parametrize(
  ('seconds', 'text'), [(0.4, '0 s'), (59, '59 s'), (90, '2 min'), (5400, '1.5 h')]
)
def test_times(seconds, text):
  assert report_page.minutes(seconds) == text
