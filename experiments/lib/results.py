"""Numbers of methods, models and seeds: from evaluations to the lines of the paper's tables.

A model's number is its mean over views. A method's number in a category is the mean over models,
and over seeds if there are several, with the standard error over models. Its average is the mean of
the categories' means, as in the paper.
"""

import math
import os
import statistics
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from experiments.lib import differences, protocol, runs, stages
from experiments.lib.protocol import Plan

AVERAGE = 'avg.'


class Scores(NamedTuple):
  """A method's numbers in a category."""

  models: tuple[str, ...]  # ids
  values: np.ndarray  # [seeds, models], NaN if no view of the model has a number


class Row(NamedTuple):
  """A method with all its numbers."""

  title: str
  scores: Mapping[str, Scores]  # by category
  published: Mapping[str, float]  # the paper's numbers, by category and `AVERAGE`


class Number(NamedTuple):
  """A method's number in a category; NaN if there is none."""

  mean: float
  error: float  # standard error over models
  models: int
  published: float  # the paper's number


class Line(NamedTuple):
  """A line of a table."""

  title: str
  categories: dict[str, Number]
  seeds: list[float]  # the mean of the categories' means for each seed
  published: float  # the paper's mean of the categories


class Comparison(NamedTuple):
  """The difference between two methods, model by model."""

  better: str  # title of the first method
  other: str  # title of the second
  difference: float  # first minus second, mean over models
  error: float  # standard error over models; 0 for one model
  models: int
  median: float
  above: float  # share of the models in which the first method is above
  seeds: list[float]  # differences of averages by seed; empty for one seed


class Table(NamedTuple):
  """Methods, and one of them compared with others."""

  lines: list[Line]
  comparisons: list[Comparison]


class Result(NamedTuple):
  """An evaluation of a method."""

  categories: list[str]  # on which its networks are evaluated
  report: dict[str, Any]  # of experiments.evaluate


def evaluate(
  plan: Plan,
  method: str,
  *,
  split: str = 'test',
  threshold: str | None = None,
  measures: bool = False,
) -> list[Result]:
  """A method's evaluations, one for each of its networks and seeds; makes what is missing.

  Args:
    plan: how networks are trained and evaluated.
    method: a key of `protocol.METHODS`.
    split: of the models.
    threshold: 'paper' or 'val', instead of the plan's.
    measures: as of `protocol.evaluate`.
  """
  options = {'split': split, 'threshold': threshold, 'measures': measures}
  return [
    Result(judged, protocol.evaluate(plan, method, trained_on, seed, **options))
    for trained_on, judged in protocol.trained_for(plan, protocol.categories(plan))
    for seed in plan.seeds
  ]


def select(results: Iterable[Result], metric: str, *, who: str = 'networks') -> dict[str, Scores]:
  """A method's numbers by category.

  Args:
    results: of `evaluate`.
    metric: a key of `scoring.METRICS`.
    who: 'networks', 'baselines' for the trivial baselines, or one of memory.WAYS.
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


def tabulate(rows: Mapping[str, Row], ours: str) -> Table:
  """The table of some methods.

  Args:
    rows: by name.
    ours: name of the method that is compared with the others; without it nothing is compared.
  """
  others = [name for name in rows if ours in rows and name != ours]
  comparisons = [compare(rows[ours], rows[name]) for name in others]
  return Table([summarize(row) for row in rows.values()], comparisons)


def summarize(row: Row) -> Line:
  """A method as a line of a table."""
  numbers = {
    c: Number(*mean_and_error(s), row.published.get(c, math.nan)) for c, s in row.scores.items()
  }
  published = row.published.get(AVERAGE, math.nan)
  return Line(row.title, numbers, seed_means(row).tolist(), published)


def mean_and_error(scores: Scores) -> tuple[float, float, int]:
  """(mean, standard error over models, number of models); NaN if there are too few."""
  by_model = _nanmean(scores.values, axis=0)
  by_model = by_model[~np.isnan(by_model)]
  count = len(by_model)
  error = np.std(by_model, ddof=1) / np.sqrt(count) if count > 1 else math.nan
  return float(np.mean(by_model)) if count else math.nan, float(error), count


def seed_means(row: Row) -> np.ndarray:
  """The mean of the categories' means for each seed, [seeds]."""
  return np.mean([_nanmean(s.values, axis=1) for s in row.scores.values()], axis=0)


def overall(line: Line) -> float:
  """The mean over seeds of the mean of the categories' means."""
  return statistics.fmean(line.seeds) if line.seeds else math.nan


def mean_over_models(line: Line) -> float:
  """The mean over the models of all categories."""
  known = [c for c in line.categories.values() if c.models]
  return sum(c.mean * c.models for c in known) / sum(c.models for c in known) if known else math.nan


def compare(better: Row, other: Row) -> Comparison:
  """How far a method is above another, model by model."""
  by_model = [
    _nanmean(better.scores[c].values, axis=0) - _nanmean(other.scores[c].values, axis=0)
    for c in better.scores
  ]
  found = np.concatenate(by_model)
  found = found[~np.isnan(found)]
  count = len(found)
  error = np.std(found, ddof=1) / np.sqrt(count) if count > 1 else 0
  by_seed = seed_means(better) - seed_means(other)
  return Comparison(
    better.title,
    other.title,
    *(float(x) for x in (np.mean(found), error)),
    count,
    *(float(x) for x in (np.median(found), np.mean(found > 0))),
    by_seed.tolist() if len(by_seed) > 1 else [],
  )


def write(workdir: str, name: str, results: Iterable[Result], found: Mapping[str, Any]) -> None:
  """Writes WORKDIR/tables/NAME.json and prints the deviations from the paper's protocol.

  Args:
    workdir: the folder.
    name: of the table.
    results: all evaluations behind the numbers; they say how the numbers were made.
    found: the numbers; {'parts': {name: Table}} for tables of methods.
  """
  path = os.path.join(workdir, 'tables', f'{name}.json')
  source = describe(results)
  stages.write_results(path, {**source, **found})
  print(f'\n{differences.to_text(source["differences"])}\n\n{path}')


def describe(results: Iterable[Result]) -> dict[str, Any]:
  """The data set, the runs of all networks, and their deviations from the paper; JSON values."""
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


def read_table(found: Mapping[str, Any]) -> Table:
  """A table from its JSON values; any exception of reading means that they are of another form."""
  kinds = {'models': int, 'title': str, 'better': str, 'other': str}
  kinds |= {'seeds': lambda x: [*map(_float, x)]}
  kinds |= {'categories': lambda x: {c: read(Number, n) for c, n in x.items()}}

  def read(tuple_type, values):
    return tuple_type(*(kinds.get(k, _float)(values[k]) for k in tuple_type._fields))

  lines = [read(Line, x) for x in found['lines']]
  comparisons = [read(Comparison, x) for x in found['comparisons']]
  if not lines:
    raise ValueError(found)
  return Table(lines, comparisons)


def _float(x) -> float:
  return math.nan if x is None else float(x)


def _mean(values):
  numbers = [v for v in values if v is not None]
  return float(np.mean(numbers)) if numbers else np.nan


def _nanmean(values, axis):
  """np.nanmean, without a warning if there is no number at all."""
  count = np.sum(~np.isnan(values), axis=axis)
  return np.where(count, np.nansum(values, axis=axis) / np.maximum(count, 1), np.nan)
