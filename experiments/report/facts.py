"""What the report tells of data sets, machine, versions and commands."""

import importlib.metadata
import os
import platform
import re
from collections import Counter, defaultdict
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cvn.dataset import SPLITS, Dataset, Model, open_dataset, read_json, surface_counts, to_url
from cvn.ops import compile as compiling
from experiments.report.blocks import Cell, Table
from experiments.report.results import Workdir

PACKAGES = (
  *('cvn', 'jax', 'jaxlib', 'flax', 'optax', 'orbax-checkpoint', 'grain', 'tensorstore', 'numpy'),
  *('scipy', 'scikit-image', 'mitsuba', 'trimesh', 'pillow', 'matplotlib'),
)


class Data(NamedTuple):
  """A data set and which of its models are finished."""

  name: str
  dataset: Dataset
  finished: np.ndarray  # [N] bool


def data_of(workdir: Workdir) -> list[str]:
  """The places of the data sets that a folder's results are of."""
  found = [s.data for s in workdir.scores] + [t.source.data for t in workdir.tables.values()]
  found += [workdir.people.source.data] if workdir.people else []
  found += [t.config['data'] for t in workdir.trainings if 'data' in t.config]
  return list(dict.fromkeys(to_url(d) for d in found))


def open_data(url: str) -> Data | None:
  """The data set; None where it is no longer there.

  Raises:
    UserError: it is damaged.
  """
  if read_json(url, 'manifest.json') is None:
    return None
  dataset = open_dataset(url)
  return Data(os.path.basename(url.rstrip('/')), dataset, surface_counts(dataset) > 0)


def counts_table(data: Data) -> Table:
  """How many models each source has for each split, by category."""
  counts = Counter((m.source, m.category, m.split) for m in _finished(data))
  sources = list(dict.fromkeys(source for source, *_ in counts))
  rows = []
  for c in sorted({category for _, category, _ in counts}):
    rows.append((c, [Cell(str(counts[s, c, split])) for s in sources for split in SPLITS]))
  totals = [sum(int(row[n].text) for _, row in rows) for n in range(len(sources) * len(SPLITS))]
  rows.append(('all', [Cell(str(n)) for n in totals]))
  return Table(
    f'Data set “{data.name}”: finished models by source and split,'
    f' {len(data.dataset.manifest.azimuths)} views each',
    [(s, len(SPLITS)) for s in sources],
    list(SPLITS) * len(sources),
    rows,
  )


def licence_table(data: Data) -> Table:
  """Models by source and licence, with the names of those who made them."""
  creators = defaultdict(Counter)
  for m in _finished(data):
    creators[m.source, m.licence or 'not stated'][m.creator or 'not stated'] += 1
  rows = []
  for (source, licence), names in sorted(creators.items()):
    ranked = sorted(names.items(), key=lambda x: (-x[1], x[0].lower()))
    listed = ', '.join(f'{name} ({n})' if n > 1 else name for name, n in ranked)
    cells = [Cell(str(sum(names.values()))), Cell(licence), Cell(listed)]
    rows.append((source, cells))
  return Table(
    f'Data set “{data.name}”: licences and creators as the sources state them, and how many models',
    [],
    ['models', 'licence', 'creators'],
    rows,
    words=True,
  )


def versions_table() -> Table:
  """Packages and the machine that made the report."""
  system = f'{platform.system()} {platform.machine()}, Python {platform.python_version()}'
  rows = [
    ('machine', [Cell(f'{compiling.processor_name()}, {os.cpu_count()} cores')]),
    ('system', [Cell(system)]),
  ]
  for package in PACKAGES:
    rows.append((package, [Cell(_version(package))]))
  return Table('Versions and machine, of this report', [], ['version'], rows, words=True)


def finished_in(data: Data, split: str) -> list[Model]:
  """The finished models of a split."""
  return [m for m in _finished(data) if m.split == split]


def shorten(line: str, folders: Sequence[str]) -> str:
  """A command with its places below those of known folders, and nothing else of the machine's.

  Args:
    line: the command.
    folders: absolute paths; what lies in one is told from its last name on.
  """

  def short(match):
    path = match.group(0).removeprefix('file://').rstrip('/')
    for folder in sorted(folders, key=len, reverse=True):
      if path == folder or path.startswith(folder + '/'):
        return os.path.relpath(path, os.path.dirname(folder))
    return os.path.basename(path)

  return re.sub(r'(?<=[=,])(file://)?/[^\s,\'"]+', short, line)


def _finished(data: Data) -> list[Model]:
  return [m for m, f in zip(data.dataset.manifest.models, data.finished, strict=True) if f]


def _version(package: str) -> str:
  try:
    return importlib.metadata.version(package)
  except importlib.metadata.PackageNotFoundError:
    return 'not installed'
