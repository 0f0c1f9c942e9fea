"""Markdown: tables, text that stays text, durations."""

import pytest

from experiments.lib import markdown


def test_rows_stand_below_their_head():
  text = markdown.table(('', 'IoU'), [('ours', 0.5), ('theirs', '-')])
  assert [[c.strip() for c in line.strip('|').split('|')] for line in text.splitlines()] == [
    ['', 'IoU'],
    ['---', '---'],
    ['ours', '0.5'],
    ['theirs', '-'],
  ]


def test_numbers_are_set_to_the_right_where_it_is_asked_for():
  assert markdown.table('ab', [], align='<>').splitlines()[1] == '| --- | ---: |'


def test_bars_in_cells_are_text():
  text = markdown.table('ab', [('`x|y`', r'\|')])
  assert text.splitlines()[-1] == r'| `x\|y` | \| |'


def test_a_row_of_another_length_is_an_error():
  with pytest.raises(ValueError, match='3 cells in a table of 2'):
    markdown.table('ab', ['xyz'])


@pytest.mark.parametrize(
  'text, escaped',
  [
    ('a_b *c* <d> & e|f', r'a\_b \*c\* \<d> \& e\|f'),
    ('of `a_b|c` and\nd', 'of `a_b|c` and d'),
    ('a ` b_c', r'a \` b\_c'),
    ('[0, 1]', r'\[0, 1\]'),
  ],
)
def test_only_code_keeps_its_meaning(text, escaped):
  assert markdown.escape(text) == escaped


@pytest.mark.parametrize(
  ('seconds', 'text'), [(0.4, '0 s'), (59, '59 s'), (90, '2 min'), (5400, '1.5 h')]
)
def test_durations(seconds, text):
  assert markdown.minutes(seconds) == text
