"""Training models to look up: what a network that only remembers would answer."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from cvn import readouts
from cvn.dataset import Dataset, read_record
from cvn.evaluation import retrieval
from cvn.infer import Network

# How a training model is chosen for a view; 'oracle' is told the truth.
WAYS = {
  'outline': 'training model of the most similar outline',
  'code': 'training model of the most similar code',
  'oracle': 'training model nearest to the truth',
}


class Memory(NamedTuple):
  """N training models with V views each."""

  rows: np.ndarray  # [N] of the data set
  surfaces: Sequence[np.ndarray]  # [S, 3] indices of each model
  outlines: np.ndarray  # [N * V, H * W] bool
  codes: np.ndarray  # [N * V, F] of the network


def remember(dataset: Dataset, rows: Iterable[int], network: Network) -> Memory:
  """What can be looked up.

  Args:
    dataset: the open data set.
    rows: of the models.
    network: its encoder makes the codes.
  """
  numbers, surfaces, outlines, codes = [], [], [], []
  for row in rows:
    record = read_record(dataset, row)
    numbers.append(row)
    surfaces.append(record.surface_index)
    outlines.append(_outlines(record.views))
    codes.append(retrieval.codes(network, record.views))
  return Memory(np.array(numbers), surfaces, np.concatenate(outlines), np.concatenate(codes))


def look_up(
  memory: Memory, views: np.ndarray, true: np.ndarray, network: Network
) -> dict[str, np.ndarray]:
  """The row of the training model that each of `WAYS` chooses for each view, [V] each.

  Args:
    memory: of `remember`.
    views: [V, H, W, 4] u8.
    true: [X, X, X] bool, the views' object.
    network: as of `remember`.
  """
  per_model = len(memory.outlines) // len(memory.rows)
  outlines = retrieval.ious(_outlines(views), memory.outlines)
  codes = retrieval.cosines(retrieval.codes(network, views), memory.codes)
  nearest = np.argmax(retrieval.surface_ious(true, memory.surfaces))
  return {
    'outline': memory.rows[outlines.argmax(1) // per_model],
    'code': memory.rows[codes.argmax(1) // per_model],
    'oracle': np.full(len(views), memory.rows[nearest]),
  }


def _outlines(views):
  return np.asarray(readouts.foreground_of(views)).reshape(len(views), -1)
