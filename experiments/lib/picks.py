"""Test models and views of them, drawn at random and not chosen: what figures and studies show.

Whoever gives the same seed sees the same ones.
"""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from cvn import data
from cvn.dataset import Dataset, Model
from cvn.errors import UserError


class Pick(NamedTuple):
  """A model and one of its views."""

  row: int  # of the data set
  view: int
  model: Model
  azimuth: float  # of the view, degrees


def of(dataset: Dataset, row: int, view: int) -> Pick:
  """The pick of a row and a view."""
  m = dataset.manifest
  return Pick(int(row), int(view), m.models[row], float(m.azimuths[view]))


def choose(
  dataset: Dataset,
  categories: Iterable[str],
  *,
  sources: Sequence[str] = (),
  per_category: int,
  seed: int,
) -> list[Pick]:
  """Random models of the split test, so many of each category, and a random view of each.

  Args:
    dataset: the open data set.
    categories: in the order of the result.
    sources: of the models; all by default.
    per_category: models of each category, where it has as many.
    seed: of the choice.

  Raises:
    UserError: there is no finished one.
  """
  rng = np.random.default_rng(seed)
  picks = []
  for category in categories:
    rows = data.select_rows(dataset, 'test', categories=[category], sources=sources)
    for row in rng.permutation(rows)[:per_category]:
      picks.append(of(dataset, row, rng.integers(len(dataset.manifest.azimuths))))
  if not picks:
    raise UserError(f'{dataset.root} has no finished model in the split test')
  return picks


def categories_of(picks: Iterable[Pick]) -> list[str]:
  """The categories of some picks, each once."""
  return list(dict.fromkeys(p.model.category for p in picks))


def to_json(pick: Pick) -> dict[str, str | float]:
  """What is told of a pick beside a figure."""
  told = {k: v for k, v in pick.model._asdict().items() if k != 'split'}
  return {'azimuth': pick.azimuth, **told}
