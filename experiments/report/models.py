"""Models of the report that can be turned: reconstructions of random test views, and the truth."""

import functools
import gzip
import os
import tempfile
from collections.abc import Sequence

import numpy as np
from tqdm import tqdm

from cvn import export, figures, infer, metrics, readouts
from cvn.dataset import Dataset, read_record, to_url
from cvn.grid import ColoredVoxels
from experiments.lib import evaluation, picks, protocol, scoring
from experiments.lib.assets import to_png
from experiments.lib.picks import Pick
from experiments.report.blocks import Example, Examples, Picture, Turnable
from experiments.report.facts import Data
from experiments.report.results import Score, Workdir

SHOWN = {'blended_0.2': 'paper’s method', 'best': 'recipe best'}  # the methods, and short names
BESIDE = 30  # degrees from the input's camera: where models are first seen from
STILL = 192  # pixels of a still picture


def make_examples(
  workdir: Workdir, data: Data, *, per_category: int, seed: int, name: str
) -> Examples | None:
  """Random test models of each category; None where no networks are there for any.

  Args:
    workdir: with the evaluations of the networks.
    data: the data set that they were judged on.
    per_category: how many models.
    seed: of the choice of models and views.
    name: of the pictures.
  """
  chosen = choose(workdir, data, per_category=per_category, seed=seed)
  progress = tqdm(chosen, desc=f'models of {workdir.path}', unit='model', disable=None)
  load = functools.cache(functools.partial(_load, dataset=data.dataset))
  made = [_make(data.dataset, pick, scores, load) for pick, scores in progress]
  if not made:
    return None
  titles = [m.title for m in max((example.models for example, _ in made), key=len)]
  still = figures.grid_of_images(
    [tiles for _, tiles in made],
    column_titles=['input', *titles],
    row_titles=[e.title.replace(', ', '\n', 1) for e, _ in made],
  )
  caption = f'Test models and views drawn at random, not chosen: seed {seed}.'
  return Examples([e for e, _ in made], Picture(name, to_png(still), caption))


def choose(
  workdir: Workdir, data: Data, *, per_category: int, seed: int
) -> list[tuple[Pick, dict[str, Score]]]:
  """Test models and views at random, of each category that some networks were evaluated on, with
  the evaluations by method.

  Arguments as of `make_examples`.
  """
  manifest = data.dataset.manifest
  rows = {m.id: n for n, m in enumerate(manifest.models)}
  rng = np.random.default_rng(seed)
  by_category: dict[str, dict[str, Score]] = {}
  for score in workdir.scores:
    here = to_url(score.data) == data.dataset.root
    if score.method in SHOWN and here and _networks(workdir, score):
      for category in dict.fromkeys(score.models.values()):
        by_category.setdefault(category, {}).setdefault(score.method, score)
  chosen = []
  for category, scores in sorted(by_category.items()):
    names = sorted(
      name
      for name in next(iter(scores.values())).models
      if all(s.models.get(name) == category for s in scores.values()) and name in rows
    )
    for n in rng.permutation(len(names))[:per_category]:
      view = int(rng.integers(len(manifest.azimuths)))
      own = {m: _located(workdir, scores[m]) for m in SHOWN if m in scores}
      chosen.append((picks.of(data.dataset, rows[names[n]], view), own))
  return chosen


def to_glb(voxels: ColoredVoxels) -> bytes:
  """A GLB file, compressed by gzip; the same voxels give the same bytes."""
  with tempfile.TemporaryDirectory() as folder:
    path = os.path.join(folder, 'model.glb')
    export.write_glb(path, voxels)
    with open(path, 'rb') as f:
      return gzip.compress(f.read(), mtime=0)


def _make(
  dataset: Dataset, pick: Pick, scores: dict[str, Score], load
) -> tuple[Example, list[np.ndarray]]:
  """An example, and still pictures of its view and models."""
  manifest, model = dataset.manifest, pick.model
  record = read_record(dataset, pick.row)
  view = record.views[pick.view]
  true = scoring.to_voxels(record, manifest.grid_size)
  shown: list[tuple[str, str, ColoredVoxels]] = []
  for method, score in scores.items():
    predict = protocol.bind(
      method,
      load(score.shape, readouts.SHAPE_KINDS),
      load(score.color, readouts.COLOR_KINDS),
      threshold=score.threshold,
      alpha=score.alpha,
      azimuths=manifest.azimuths,
    )
    found = infer.to_voxels(predict(view[None])[0])
    iou = float(metrics.iou(found.occupancy, true.occupancy))
    shown.append((SHOWN[method], f'threshold {score.threshold:.2f}, IoU {iou:.2f}', found))
  shown.append(('truth', '', true))
  start = pick.azimuth + BESIDE
  models = [
    Turnable(title, note, to_glb(voxels) if voxels.occupancy.any() else b'')
    for title, note, voxels in shown
  ]
  tiles = [figures.enlarge(view, STILL)]
  tiles += [figures.draw_voxels(voxels, start, size=STILL) for *_, voxels in shown]
  credit = ', '.join(x for x in (model.id, model.creator, model.licence) if x)
  title = f'{model.category}, seen from {pick.azimuth:g}°'
  example = Example(title, to_png(figures.over(view)), start, models, f'{credit}.')
  return example, tiles


def _networks(workdir: Workdir, score: Score) -> bool:
  """Whether the networks of an evaluation are still there, as they were evaluated."""
  located = _located(workdir, score)
  folders = {'shape': located.shape, 'color': located.color}
  return all(
    folder
    and os.path.isdir(os.path.join(folder, 'checkpoints'))
    and evaluation.describe_run(folder) == score.runs.get(kind)
    for kind, folder in folders.items()
  )


def _located(workdir: Workdir, score: Score) -> Score:
  """With the networks' folders where they lie now: the workdir may have been moved."""

  def find(folder):
    here = os.path.join(workdir.path, 'runs', os.path.basename(folder.rstrip('/')))
    return here if os.path.isdir(here) else folder

  return score._replace(shape=find(score.shape), color=find(score.color))


def _load(folder: str, kinds: Sequence[str], *, dataset: Dataset) -> infer.Network:
  return scoring.load(folder, kinds, dataset)
