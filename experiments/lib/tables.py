"""Numbers of methods, models and seeds as the tables of the paper show them.

A model's number is its mean over views. A cell is the mean over models, and over seeds where there
are several, with the standard error over models; the last column is the mean of the categories'
means, as in the paper.
"""

import json
import os
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from cvn.files import atomic_write
from experiments.lib import differences, markdown, protocol, runs
from experiments.lib.protocol import Plan
from experiments.lib.stages import argv

AVERAGE = 'avg.'


class Scores(NamedTuple):
  """A method's numbers in a category."""

  models: tuple[str, ...]  # their ids
  values: np.ndarray  # [seeds, models], NaN where no view of the model has a number


class Row(NamedTuple):
  """A line of a table."""

  title: str
  scores: Mapping[str, Scores]  # by category
  published: Mapping[str, float]  # the paper's numbers, by category and `AVERAGE`


class Comparison(NamedTuple):
  """How much a method is above another, model by model."""

  better: str  # their titles
  other: str
  difference: float  # the mean over models
  error: float  # standard error over models; 0 for one model
  models: int
  median: float
  above: float  # the share of models in which it is above
  seeds: list[float]  # differences of averages by seed; empty for one seed


class Result(NamedTuple):
  """An evaluation of a method."""

  categories: list[str]  # that its networks are evaluated on
  report: dict[str, Any]  # of experiments.evaluate


def evaluate(
  plan: Plan, method: str, *, split: str = 'test', threshold: str | None = None
) -> list[Result]:
  """A method's evaluations, one for each of its networks and seeds; makes what is missing.

  Args:
    plan: how.
    method: a key of `protocol.METHODS`.
    split: of the models.
    threshold: 'paper' or 'val', instead of the plan's.
  """
  return [
    Result(
      judged,
      protocol.evaluate(plan, method, trained_on, seed, split=split, threshold=threshold),
    )
    for trained_on, judged in protocol.trained_for(plan, protocol.categories(plan))
    for seed in plan.seeds
  ]


def select(results: Iterable[Result], metric: str, *, who: str = 'networks') -> dict[str, Scores]:
  """A method's numbers by category.

  Args:
    results: of `evaluate`.
    metric: a key of `scoring.METRICS`.
    who: 'networks', or 'baselines' for the trivial ones beside the method.
  """
  found: dict[str, list[dict[str, float]]] = {}
  for result in results:
    for category in result.categories:
      means = {
        name: _mean(model[metric])
        for name, model in result.report[who]['by_model'].items()
        if model['category'] == category
      }
      if means:
        found.setdefault(category, []).append(means)
  return {
    category: Scores(tuple(seeds[0]), np.array([[s[name] for name in seeds[0]] for s in seeds]))
    for category, seeds in found.items()
  }


def mean_and_error(scores: Scores) -> tuple[float, float, int]:
  """(mean, standard error over models, number of models); NaN where there are too few."""
  by_model = _nanmean(scores.values, axis=0)
  by_model = by_model[~np.isnan(by_model)]
  count = len(by_model)
  error = np.std(by_model, ddof=1) / np.sqrt(count) if count > 1 else np.nan
  return float(np.mean(by_model)) if count else np.nan, float(error), count


def seed_means(row: Row) -> np.ndarray:
  """The average of the categories' means for each seed, [seeds]."""
  return np.mean([_nanmean(s.values, axis=1) for s in row.scores.values()], axis=0)


def to_markdown(rows: Sequence[Row], form: str) -> str:
  """A table: our numbers, and the paper's in brackets; a line with the number of models.

  Args:
    rows: with the same categories.
    form: of numbers, such as '.3f'.
  """
  names = list(dict.fromkeys(c for row in rows for c in row.scores))
  lines = []
  for row in rows:
    cells = []
    for c in names:
      mean, error, _ = mean_and_error(row.scores[c]) if c in row.scores else (np.nan,) * 3
      cells.append(_cell(mean, error, row.published.get(c), form))
    averages = seed_means(row)
    spread = np.std(averages, ddof=1) if len(averages) > 1 else np.nan
    text = _cell(float(np.mean(averages)), np.nan, row.published.get(AVERAGE), form)
    cells.append(text + (f' (seeds: {spread:{form}})' if len(averages) > 1 else ''))
    lines.append([row.title, *cells])
  counts = [str(len(next(r.scores[c] for r in rows if c in r.scores).models)) for c in names]
  return markdown.table(['', *names, AVERAGE], [*lines, ['test models', *counts, '']])


def compare(better: Row, other: Row) -> Comparison:
  """How much a method is above another, model by model."""
  differences = np.concatenate(
    [
      _nanmean(better.scores[c].values, axis=0) - _nanmean(other.scores[c].values, axis=0)
      for c in better.scores
    ]
  )
  differences = differences[~np.isnan(differences)]
  count = len(differences)
  error = np.std(differences, ddof=1) / np.sqrt(count) if count > 1 else 0
  by_seed = seed_means(better) - seed_means(other)
  return Comparison(
    better.title,
    other.title,
    *(float(x) for x in (np.mean(differences), error)),
    count,
    *(float(x) for x in (np.median(differences), np.mean(differences > 0))),
    by_seed.tolist() if len(by_seed) > 1 else [],
  )


def to_line(c: Comparison, form: str) -> str:
  """A comparison for people.

  Args:
    c: the comparison.
    form: of numbers, such as '.3f'.
  """
  seeds = f'; by seed {", ".join(f"{d:+{form}}" for d in c.seeds)}' if c.seeds else ''
  return (
    f'{c.better} - {c.other}: {c.difference:+{form}} ± {c.error:{form}} over {c.models} models,'
    f' median {c.median:+{form}}, above in {c.above:.0%}{seeds}'
  )


def tell(heading: str, rows: Mapping[str, Row], ours: str, form: str) -> dict[str, Any]:
  """Prints a table and how much our method is better than each other; the same as JSON values.

  Args:
    heading: above the table.
    rows: by name.
    ours: the name of our method; without it among the rows nothing is compared.
    form: of numbers, such as '.3f'.
  """
  others = [name for name in rows if ours in rows and name != ours]
  comparisons = [compare(rows[ours], rows[name]) for name in others]
  print(f'\n{heading}\n')
  print(to_markdown([*rows.values()], form))
  print('\n' + '\n'.join(to_line(c, form) for c in comparisons))
  return to_part([*rows.values()], comparisons)


def finish(workdir: str, name: str, table: Mapping[str, Any], results: Iterable[Result]) -> None:
  """Writes WORKDIR/tables/NAME.json, and says how its numbers differ from the paper's.

  Args:
    workdir: the folder.
    name: of the table.
    table: JSON values.
    results: all evaluations that its numbers are from: what is told of the numbers is read there.
  """
  path = os.path.join(workdir, 'tables', f'{name}.json')
  told = describe(results)
  with atomic_write(path) as temporary, open(temporary, 'w') as out:
    out.write(json.dumps({'argv': argv(), **told, **table}, indent=1) + '\n')
  print(f'\n{differences.to_text(told["differences"])}\n\n{path}')


def describe(results: Iterable[Result]) -> dict[str, Any]:
  """The data set, the runs of all networks, and how they differ from the paper's; JSON values."""
  reports = [r.report for r in results]
  used = [run for report in reports for run in runs.of_report(report)]
  tested = {
    f'{report["data"]} {name}': model
    for report in reports
    if report['split'] == 'test'
    for name, model in report['networks']['by_model'].items()
  }
  return {
    'data': next(iter(report['data'] for report in reports)),
    'runs': runs.to_json(used),
    'differences': differences.find_differences(used, tested),
  }


def to_part(rows: Sequence[Row], comparisons: Sequence[Comparison]) -> dict[str, Any]:
  """A table as JSON values."""
  return {'rows': to_json(rows), 'comparisons': [c._asdict() for c in comparisons]}


def to_json(rows: Sequence[Row]) -> list[dict[str, Any]]:
  """Rows as JSON values: None where there is no number."""

  def number(x):
    return None if x is None or np.isnan(x) else float(x)

  return [
    {
      'title': row.title,
      'categories': {
        c: {
          **dict(zip(('mean', 'error', 'models'), map(number, mean_and_error(s)), strict=True)),
          'seeds': [number(x) for x in _nanmean(s.values, axis=1)],
          'published': row.published.get(c),
        }
        for c, s in row.scores.items()
      },
      'average': {
        'seeds': [number(x) for x in seed_means(row)],
        'published': row.published.get(AVERAGE),
      },
    }
    for row in rows
  ]


def _cell(mean, error, published, form):
  if np.isnan(mean):
    return '-'
  text = f'{mean:{form}}' + ('' if np.isnan(error) else f' ± {error:{form}}')
  return text + (f' [{published}]' if published is not None else '')


def _mean(values):
  numbers = [v for v in values if v is not None]
  return float(np.mean(numbers)) if numbers else np.nan


def _nanmean(values, axis):
  """np.nanmean, without a warning where there is no number at all."""
  count = np.sum(~np.isnan(values), axis=axis)
  return np.where(count, np.nansum(values, axis=axis) / np.maximum(count, 1), np.nan)
