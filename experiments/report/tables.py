"""The report's tables of methods: our numbers, the paper's beside them, the best ones in bold."""

import math
import statistics
from collections.abc import Sequence

from cvn.evaluation.intervals import Estimate
from experiments.lib import protocol
from experiments.lib.evaluation import ALPHAS
from experiments.lib.tables import AVERAGE, Comparison
from experiments.report.blocks import Block, Cell, Items, Table
from experiments.report.results import Line, Lines, Number

FEW = 5  # test models: with fewer, a mean says little
NONE = '–'
# Blends with another alpha than the one that the paper goes on with: not ranked.
VARIANTS = {protocol.METHODS[f'blended_{a:g}'].title for a in ALPHAS[1:]}


def methods_table(lines: Lines, form: str, caption: str) -> list[Block]:
  """A table of methods by category, and what can be read from it.

  Args:
    lines: the methods.
    form: of numbers, such as '.3f'.
    caption: above the table.
  """
  rows = lines.rows
  names = list(dict.fromkeys(c for row in rows for c in row.categories))
  columns = [_column([row.categories.get(c) for row in rows], c, form) for c in names]
  if len(names) > 1:
    columns.append(_average(rows, form))
  elif max(len(row.seeds) for row in rows) > 1:
    columns.append(_by_seed(rows, form))
  table = Table(
    caption,
    [(title, len(parts)) for title, parts in columns],
    [head for _, parts in columns for head, _ in parts],
    [
      (row.title, [cells[n] for _, parts in columns for _, cells in parts])
      for n, row in enumerate(rows)
    ],
  )
  said = remarks(rows, names)
  items = [Items(said)] if said else []
  return [table, *items, *differences_table(lines.comparisons, form)]


def differences_table(comparisons: Sequence[Comparison], form: str) -> list[Table]:
  """What a method is above others, model by model; nothing where nothing was compared.

  Args:
    comparisons: of one method.
    form: of numbers.
  """
  if not comparisons:
    return []
  caption = f'{comparisons[0].better}, compared model by model'
  return [_compared(caption, [(f'− {c.other}', c, form) for c in comparisons])]


def verdict(c: Comparison) -> str:
  """Whether a difference is more than chance, by two standard errors over models."""
  if abs(c.difference) <= 2 * c.error:
    return 'not told apart'
  return 'above' if c.difference > 0 else 'below'


def remarks(rows: Sequence[Line], names: Sequence[str]) -> list[str]:
  """What a reader should see in a table: the order of the methods, and where models are few."""
  said = []
  ranked = [r for r in rows if not math.isnan(_published(r)) and r.title not in VARIANTS]
  if len(ranked) > 1:
    here, paper = (sorted(ranked, key=key, reverse=True) for key in (overall, _published))
    orders = [' > '.join(row.title for row in order) for order in (here, paper)]
    same = 'The order of the methods is the paper’s' if here == paper else 'Order of the methods'
    said.append(
      f'{same}: {orders[0]}' + ('.' if here == paper else f'; in the paper: {orders[1]}.')
    )
  few = [f'{c} {n}' for c in names if (n := _count(rows, c)) < FEW]
  if few:
    said.append(f'Test models are few ({", ".join(few)}): numbers there say little.')
  return said


def overall(row: Line) -> float:
  """The mean over seeds of the mean of the categories' means."""
  return statistics.fmean(row.seeds) if row.seeds else math.nan


def ablation_table(parts: dict[str, Lines], caption: str) -> list[Block]:
  """A line a step: means over all models on val and test, and the gain over the first line.

  Args:
    parts: of `read.Tabled`: '<split> <metric>'.
    caption: above the table.
  """
  columns = []
  for name, lines in parts.items():
    values = [mean_over_models(row) for row in lines.rows]
    percent = name.endswith('iou')
    form = '.3f' if percent else '.2f'
    gains = ['', *(_gain(v, values[0], percent) for v in values[1:])]
    cells = [_plain(v, form)._replace(detail=g) for v, g in zip(values, gains, strict=True)]
    columns.append(_mark_best(cells))
  rows = next(iter(parts.values())).rows
  heads = {'iou': 'IoU', 'psnr_rgb': 'PSNR RGB, dB'}
  splits = [p.split() for p in parts]
  table = Table(
    caption,
    [],
    [f'{heads[metric]}, {split}' for split, metric in splits],
    [(row.title, [c[n] for c in columns]) for n, row in enumerate(rows)],
  )
  compared = [
    (heads[metric], c, '.3f' if metric == 'iou' else '.2f')
    for (_, metric), lines in zip(splits, parts.values(), strict=True)
    for c in lines.comparisons
  ]
  caption = 'The last line minus the first, model by model, on test'
  return [table, *([_compared(caption, compared)] if compared else [])]


def mean_over_models(row: Line) -> float:
  """The mean over the models of all categories."""
  known = [c for c in row.categories.values() if c.models]
  return sum(c.mean * c.models for c in known) / sum(c.models for c in known) if known else math.nan


def estimate_cell(e: Estimate, form: str) -> Cell:
  """A number and its interval."""
  if math.isnan(e.value):
    return Cell(NONE)
  return Cell(
    f'{e.value:{form}}', '' if math.isnan(e.low) else f'[{e.low:{form}}, {e.high:{form}}]'
  )


def _compared(caption: str, rows: Sequence[tuple[str, Comparison, str]]) -> Table:
  """A table of comparisons, each with its label and the form of its numbers."""
  seeds = max(len(c.seeds) for _, c, _ in rows)

  def cells(c, form):
    signed = [f'{x:+{form}}'.replace('-', '−') for x in (c.difference, c.median, *c.seeds)]
    first = [Cell(signed[0], f'± {c.error:{form}}'), Cell('', verdict(c))]
    told = [signed[1], f'{100 * c.above:.0f} %', str(c.models), *signed[2:]]
    return [*first, *map(Cell, told)]

  return Table(
    caption,
    [('', 5), ('by seed', seeds)] if seeds else [],
    ['difference', '', 'median', 'above in', 'of models', *([''] * seeds)],
    [(label, cells(c, form)) for label, c, form in rows],
  )


def _gain(value: float, first: float, percent: bool) -> str:
  """Over the first value; empty where there is no such number."""
  if math.isnan(value - first) or (percent and not first):
    return ''
  return f'{value / first - 1:+.0%}' if percent else f'{value - first:+.2f}'


def _column(numbers: Sequence[Number | None], name: str, form: str):
  """(title, [(head, cells), ...]) of a category: ours and, where there is one, the paper's."""
  known = [n for n in numbers if n and n.models]
  count = max((n.models for n in known), default=0)
  ours = [
    Cell(NONE)
    if n is None or not n.models
    else Cell(
      f'{n.mean:{form}}',
      ('' if math.isnan(n.error) else f'± {n.error:{form}}')
      + ('' if n.models == count else f' ({n.models} models)'),
    )
    for n in numbers
  ]
  parts = [('here', _mark_best(ours))]
  published = [math.nan if n is None else n.published for n in numbers]
  if not all(map(math.isnan, published)):
    parts.append(('paper', _mark_best([_plain(x, form) for x in published])))
  return f'{name} ({count})', parts


def _average(rows: Sequence[Line], form: str):
  ours = [_plain(overall(row), form)._replace(detail=_spread(row.seeds, form)) for row in rows]
  parts = [('here', _mark_best(ours))]
  if not all(math.isnan(row.published) for row in rows):
    parts.append(('paper', _mark_best([_plain(row.published, form) for row in rows])))
  return AVERAGE, parts


def _by_seed(rows: Sequence[Line], form: str):
  count = max(len(row.seeds) for row in rows)
  padded = [[*row.seeds, *[math.nan] * (count - len(row.seeds))] for row in rows]
  return 'by seed', [('', [_plain(p[n], form) for p in padded]) for n in range(count)]


def _spread(values: Sequence[float], form: str) -> str:
  """The standard deviation over seeds; empty for one."""
  return f'± {statistics.stdev(values):{form}}' if len(values) > 1 else ''


def _plain(x: float, form: str) -> Cell:
  return Cell(NONE if math.isnan(x) else f'{x:{form}}')


def _mark_best(cells: Sequence[Cell]) -> list[Cell]:
  """Bold where the number, as it is printed, is the highest."""
  known = [float(c.text) for c in cells if c.text != NONE]
  return [c._replace(best=c.text != NONE and float(c.text) == max(known)) for c in cells]


def _published(row: Line) -> float:
  """The paper's mean, or its number where there is one category."""
  if len(row.categories) > 1:
    return row.published
  return next(iter(row.categories.values())).published if row.categories else math.nan


def _count(rows: Sequence[Line], category: str) -> int:
  return max((r.categories[category].models for r in rows if category in r.categories), default=0)
