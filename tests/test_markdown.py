"""Tables in Markdown."""

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


def test_a_row_of_another_length_is_an_error():
  with pytest.raises(ValueError, match='3 cells in a table of 2'):
    markdown.table('ab', ['xyz'])
