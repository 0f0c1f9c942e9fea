"""Tables in Markdown."""

from collections.abc import Iterable, Sequence


def table(head: Sequence[object], rows: Iterable[Sequence[object]], *, align: str = '') -> str:
  """A table, a line for the head, one for the rule, and one for each row.

  Args:
    head: the columns' names.
    rows: of as many cells; what is no text is printed as `str` does.
    align: a character for each column, '>' to the right or '<' as usual; as usual by default.
  """
  rule = ['---:' if a == '>' else '---' for a in align or '<' * len(head)]
  lines = [head, rule, *rows]
  for line in lines:
    if len(line) != len(head):
      raise ValueError(f'a row of {len(line)} cells in a table of {len(head)} columns')
  return '\n'.join('| ' + ' | '.join(map(str, line)) + ' |' for line in lines)
