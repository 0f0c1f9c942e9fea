"""Tables of methods in Markdown, for terminals and for the report.

Our numbers stand beside the paper's, and the best of each column is bold.
"""

import math
import statistics
from collections.abc import Mapping, Sequence

from cvn.evaluation.intervals import Estimate
from experiments.lib import markdown, protocol, results
from experiments.lib.evaluation import ALPHAS
from experiments.lib.markdown import NONE, detail, escape
from experiments.lib.results import AVERAGE, Comparison, Line, Number, Table
from experiments.lib.scoring import METRICS

FEW = 5  # test models: with fewer, a mean says little
# Blends with an alpha other than the paper's final choice; they are not ranked.
VARIANTS = {protocol.METHODS[f'blended_{a:g}'].title for a in ALPHAS[1:]}
# Of harder measures: the forms of numbers, those that are better if lower, those that are compared.
MEASURES = dict.fromkeys(METRICS, '.3f') | dict.fromkeys(
  ('psnr_rgb', 'psnr_ycbcr', 'picture_psnr'), '.2f'
)
LOWER = ('chamfer',)
COMPARED = ('iou', 'f_100', 'chamfer', 'picture_ssim')
FORMS = {'iou': '.3f', 'psnr_rgb': '.2f', 'psnr_ycbcr': '.2f'}  # of numbers, by metric


def methods_table(table: Table, form: str, caption: str) -> str:
  """A table of methods by category, what can be read from it, and the comparisons.

  Args:
    table: the methods.
    form: of numbers, such as '.3f'.
    caption: above the table.
  """
  lines = table.lines
  names = list(dict.fromkeys(c for line in lines for c in line.categories))
  columns = [
    x for c in names for x in _category([line.categories.get(c) for line in lines], c, form)
  ]
  if len(names) > 1:
    columns += _average(lines, form)
  elif max(len(line.seeds) for line in lines) > 1:
    columns += _by_seed(lines, form)
  rows = [[escape(line.title), *(c[n] for _, c in columns)] for n, line in enumerate(lines)]
  parts = [markdown.numbers(['', *(head for head, _ in columns)], rows, caption=caption)]
  if found := remarks(lines, names):
    parts.append(markdown.items(found))
  if table.comparisons:
    caption = f'{table.comparisons[0].better}, compared model by model'
    parts.append(comparisons([(f'− {c.other}', c, form) for c in table.comparisons], caption))
  return '\n\n'.join(parts)


def comparisons(rows: Sequence[tuple[str, Comparison, str]], caption: str) -> str:
  """A table of comparisons: (label, comparison, form of its numbers)."""
  seeds = max(len(c.seeds) for _, c, _ in rows)

  def cells(label, c, form):
    signed = [f'{x:+{form}}'.replace('-', '−') for x in (c.difference, c.median, *c.seeds)]
    first = f'{signed[0]} {detail(f"± {c.error:{form}}")}'
    return [
      escape(label),
      first,
      verdict(c),
      signed[1],
      f'{100 * c.above:.0f} %',
      c.models,
      *signed[2:],
    ]

  head = ['', 'difference', '', 'median', 'above in', 'of models', *(['by seed'] * seeds)]
  return markdown.numbers(head, [cells(*row) for row in rows], caption=caption)


def verdict(c: Comparison) -> str:
  """Whether a difference is more than chance, by two standard errors over models."""
  if abs(c.difference) <= 2 * c.error:
    return 'not told apart'
  return 'above' if c.difference > 0 else 'below'


def remarks(lines: Sequence[Line], names: Sequence[str]) -> list[str]:
  """The order of the methods here and in the paper, and a warning about few models."""
  found = []
  ranked = [x for x in lines if not math.isnan(_published(x)) and x.title not in VARIANTS]
  if len(ranked) > 1:
    here, paper = (sorted(ranked, key=key, reverse=True) for key in (results.overall, _published))
    orders = [' > '.join(line.title for line in order) for order in (here, paper)]
    if here == paper:
      found.append(f'The order of the methods is the paper’s: {orders[0]}.')
    else:
      found.append(f'Order of the methods: {orders[0]}; in the paper: {orders[1]}.')
  few = [f'{c} {n}' for c in names if (n := _count(lines, c)) < FEW]
  if few:
    found.append(f'Few test models ({", ".join(few)}): numbers there say little.')
  return found


def ablation_table(parts: Mapping[str, Table], caption: str) -> str:
  """A line for each step: means over all models, and the gain over the first line.

  Args:
    parts: tables by '<split> <metric>'.
    caption: above the table.
  """
  heads = {'iou': 'IoU', 'psnr_rgb': 'PSNR RGB, dB'}
  head, columns, compared = [''], [], []
  for name, table in parts.items():
    split, metric = name.split()
    values = [results.mean_over_models(line) for line in table.lines]
    gains = ['', *(_gain(v, values[0], metric == 'iou') for v in values[1:])]
    columns.append(_cells(values, FORMS[metric], gains))
    head.append(f'{heads[metric]}, {split}')
    compared += [(heads[metric], c, FORMS[metric]) for c in table.comparisons]
  titles = [escape(line.title) for line in next(iter(parts.values())).lines]
  text = markdown.numbers(head, zip(titles, *columns, strict=True), caption=caption)
  if not compared:
    return text
  caption = 'The last line minus the first, model by model, on test'
  return f'{text}\n\n{comparisons(compared, caption)}'


def measures_table(parts: Mapping[str, Table], caption: str) -> str:
  """A line for each method and a column for each metric; the best of a column is bold.

  Args:
    parts: tables by metric, with the models of all categories in one.
    caption: above the table.
  """
  head, columns, compared = [''], [], []
  for metric, table in parts.items():
    numbers = [next(iter(line.categories.values())) for line in table.lines]
    details = ['' if math.isnan(n.error) else f'± {n.error:{MEASURES[metric]}}' for n in numbers]
    sign = -1 if metric in LOWER else 1
    head.append(METRICS[metric])
    columns.append(_cells([n.mean for n in numbers], MEASURES[metric], details, sign=sign))
    rows = [(f'{METRICS[metric]} − {c.other}', c, MEASURES[metric]) for c in table.comparisons]
    compared += rows if metric in COMPARED else []
  titles = [escape(line.title) for line in next(iter(parts.values())).lines]
  text = markdown.numbers(head, zip(titles, *columns, strict=True), caption=caption)
  if not compared:
    return text
  caption = f'{compared[0][1].better}, compared model by model'
  return f'{text}\n\n{comparisons(compared, caption)}'


def estimate_cell(e: Estimate, form: str) -> str:
  """A number and its interval."""
  if math.isnan(e.value):
    return NONE
  interval = '' if math.isnan(e.low) else f'[{e.low:{form}}, {e.high:{form}}]'
  return f'{e.value:{form}} {detail(interval)}'.rstrip()


def _gain(value: float, first: float, percent: bool) -> str:
  """The gain over the first value; empty if there is none."""
  if math.isnan(value - first) or (percent and not first):
    return ''
  return f'{value / first - 1:+.0%}' if percent else f'{value - first:+.2f}'


def _category(numbers: Sequence[Number | None], name: str, form: str):
  """The columns of a category, (head, cells): ours and, if there is one, the paper's."""
  count = max((n.models for n in numbers if n), default=0)
  none = Number(math.nan, math.nan, count, math.nan)
  numbers = [n if n and n.models else none for n in numbers]
  details = [
    ('' if math.isnan(n.error) else f'± {n.error:{form}}')
    + ('' if n.models == count else f' ({n.models} models)')
    for n in numbers
  ]
  columns = [(f'**{escape(name)} ({count})**', _cells([n.mean for n in numbers], form, details))]
  return columns + _paper([n.published for n in numbers], form)


def _average(lines: Sequence[Line], form: str):
  spread = [f'± {statistics.stdev(x.seeds):{form}}' if len(x.seeds) > 1 else '' for x in lines]
  columns = [(f'**{AVERAGE}**', _cells([results.overall(x) for x in lines], form, spread))]
  return columns + _paper([x.published for x in lines], form)


def _by_seed(lines: Sequence[Line], form: str):
  count = max(len(x.seeds) for x in lines)
  padded = [[*x.seeds, *[math.nan] * (count - len(x.seeds))] for x in lines]
  return [('by seed', _cells([p[n] for p in padded], form)) for n in range(count)]


def _paper(values: Sequence[float], form: str):
  return [] if all(map(math.isnan, values)) else [('paper', _cells(values, form))]


def _cells(
  values: Sequence[float], form: str, details: Sequence[str] = (), *, sign: int = 1
) -> list[str]:
  """Numbers and their details; the highest, as it is printed, is bold (the lowest for sign -1)."""
  texts = [NONE if math.isnan(x) else f'{x:{form}}' for x in values]
  best = sign * max((sign * float(t) for t in texts if t != NONE), default=math.nan)
  bold = [f'**{t}**' if t != NONE and float(t) == best else t for t in texts]
  return [
    f'{t} {detail(d.strip())}'.rstrip()
    for t, d in zip(bold, details or [''] * len(bold), strict=True)
  ]


def _published(line: Line) -> float:
  """The paper's mean, or its number if there is one category."""
  if len(line.categories) > 1:
    return line.published
  return next(iter(line.categories.values())).published if line.categories else math.nan


def _count(lines: Sequence[Line], category: str) -> int:
  return max((x.categories[category].models for x in lines if category in x.categories), default=0)
