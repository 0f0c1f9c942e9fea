"""Random test models and views, for figures and studies. The same seed gives the same ones."""

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
  """Random models of the split test for each category, and a random view of each.

  Args:
    dataset: the open data set.
    categories: in the order of the result.
    sources: of the models; all by default.
    per_category: maximum number of models of each category.
    seed: of the choice.

  Raises:
    UserError: there is no finished model.
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
  """A pick as JSON values, with the creator and the licence of the model."""
  model = {k: v for k, v in pick.model._asdict().items() if k != 'split'}
  return {'azimuth': pick.azimuth, **model}
