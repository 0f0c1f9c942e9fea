"""Reads tables in Markdown, so that tests compare cells and not lines."""


def read(text: str) -> list[list[list[str]]]:
  """All tables of a text: rows of cells, the head first, without the marks of bold and details."""
  tables, before = [], ''
  for line in text.splitlines():
    if line.startswith('|'):
      cells = [c.strip() for c in line[1:-1].split(' |')]
      if not before.startswith('|'):
        tables.append([])
      if not set(''.join(cells)) <= set('-:'):
        tables[-1].append([c.replace('**', '').replace('*', '') for c in cells])
    before = line
  return tables


def column(table: list[list[str]], name: str) -> dict[str, str]:
  """A column's cells by the labels of the rows; of several columns of a name the first."""
  n = table[0].index(name)
  return {row[0]: row[n] for row in table[1:]}
