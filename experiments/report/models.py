"""Models of the report that can be turned: reconstructions of random test views, and the truth."""

import functools
import gzip
import html
import os
import tempfile
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from tqdm import tqdm

from cvn import export, figures, infer, metrics, readouts
from cvn.dataset import Dataset, to_url
from cvn.grid import ColoredVoxels
from experiments.lib import evaluation, markdown, page, picks, pictures, protocol, scoring, viewer
from experiments.lib.assets import to_png
from experiments.lib.page import Block, Picture
from experiments.lib.picks import Pick
from experiments.report.read import Score, Workdir

SHOWN = {'blended_0.2': 'paper’s method', 'best': 'recipe best'}  # methods and their short names
STILL = 192  # size of a still picture in pixels
CANVAS = 560  # pixels; shown smaller, sharp on screens with twice the pixels


class Model(NamedTuple):
  """A model of an example."""

  title: str
  note: str
  voxels: ColoredVoxels


class Example(NamedTuple):
  """A view and the models that belong to it."""

  pick: Pick
  view: np.ndarray  # [H, W, 4] u8
  models: list[Model]


def make_examples(
  workdir: Workdir, dataset: Dataset, *, per_category: int, seed: int, name: str
) -> list[Block]:
  """Random test models of each category: a picture and credits; empty if there are no networks.

  Args:
    workdir: with the evaluations of the networks.
    dataset: the data set that they were evaluated on.
    per_category: models of each category.
    seed: of the choice of models and views.
    name: of the picture.
  """
  chosen = choose(workdir, dataset, per_category=per_category, seed=seed)
  progress = tqdm(chosen, desc=f'models of {workdir.path}', unit='model', disable=None)
  load = functools.cache(functools.partial(_load, dataset=dataset))
  examples = [make_example(dataset, pick, scores, load) for pick, scores in progress]
  if not examples:
    return []
  titles = [m.title for m in max((e.models for e in examples), key=len)]
  still = figures.grid_of_images(
    [
      [figures.enlarge(e.view, STILL)]
      + [pictures.draw(m.voxels, e.pick, tile=STILL) for m in e.models]
      for e in examples
    ],
    column_titles=['input', *titles],
    row_titles=[say_view(e.pick).replace(', ', '\n', 1) for e in examples],
  )
  rows = ''.join(to_html(e, f'{name}-{n}') for n, e in enumerate(examples))
  credits = [f'{say_view(e.pick)}: {say_credit(e.pick)}' for e in examples]
  caption = pictures.say_choice(seed)
  return [Picture(name, to_png(still), caption, rows), markdown.items(credits)]


def say_view(pick: Pick) -> str:
  return f'{pick.model.category}, seen from {pick.azimuth:g}°'


def say_credit(pick: Pick) -> str:
  """Id, creator and licence of a model."""
  return ', '.join(x for x in (pick.model.id, pick.model.creator, pick.model.licence) if x)


def to_html(example: Example, name: str) -> str:
  """A row of a page: the view, and the models as canvases that turn together."""
  azimuth = example.pick.azimuth + pictures.SIDE
  view = page.data_uri(to_png(figures.over(example.view)))
  cells = [f'<div><img class="view" alt="the input view" src="{view}"><span>input</span></div>']
  for n, model in enumerate(example.models):
    canvas = '<div class="viewer"></div>'
    if model.voxels.occupancy.any():
      glb = to_glb(model.voxels)
      canvas = viewer.embed(f'{name}-{n}', glb, size=CANVAS, group=name, azimuth=azimuth)
    note = f'{html.escape(model.title)}<small>{html.escape(model.note)}</small>'
    cells.append(f'<div>{canvas}<span>{note}</span></div>')
  title = html.escape(say_view(example.pick))
  return f'<p><b>{title}</b></p><div class="row">{"".join(cells)}</div>\n'


def choose(
  workdir: Workdir, dataset: Dataset, *, per_category: int, seed: int
) -> list[tuple[Pick, dict[str, Score]]]:
  """Random test models and views of each category that has networks, with evaluations by method.

  Arguments as of `make_examples`.
  """
  manifest = dataset.manifest
  rows = {m.id: n for n, m in enumerate(manifest.models)}
  rng = np.random.default_rng(seed)
  by_category: dict[str, dict[str, Score]] = {}
  for score in workdir.scores:
    here = to_url(score.data) == dataset.root
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
      chosen.append((picks.of(dataset, rows[names[n]], view), own))
  return chosen


def to_glb(voxels: ColoredVoxels) -> bytes:
  """A GLB file, compressed by gzip; the same voxels give the same bytes."""
  with tempfile.TemporaryDirectory() as folder:
    path = os.path.join(folder, 'model.glb')
    export.write_glb(path, voxels)
    with open(path, 'rb') as f:
      return gzip.compress(f.read(), mtime=0)


def make_example(dataset: Dataset, pick: Pick, scores: dict[str, Score], load) -> Example:
  """Reconstructs a view by each method."""
  known = pictures.read(dataset, pick)
  models = []
  for method, score in scores.items():
    predict = protocol.bind(
      method,
      load(score.shape, readouts.SHAPE_KINDS),
      load(score.color, readouts.COLOR_KINDS),
      threshold=score.threshold,
      alpha=score.alpha,
      azimuths=dataset.manifest.azimuths,
    )
    found = infer.to_voxels(predict(known.view[None])[0])
    iou = float(metrics.iou(found.occupancy, known.true.occupancy))
    note = f'threshold {score.threshold:.2f}, IoU {iou:.2f}'
    models.append(Model(SHOWN[method], note, found))
  return Example(pick, known.view, [*models, Model('truth', '', known.true)])


def _networks(workdir: Workdir, score: Score) -> bool:
  """Whether the networks of an evaluation are still as they were evaluated."""
  located = _located(workdir, score)
  folders = {'shape': located.shape, 'color': located.color}
  return all(
    folder
    and os.path.isdir(os.path.join(folder, 'checkpoints'))
    and evaluation.describe_run(folder) == score.runs.get(kind)
    for kind, folder in folders.items()
  )


def _located(workdir: Workdir, score: Score) -> Score:
  """With the present folders of the networks, because the workdir may have been moved."""

  def find(folder):
    here = os.path.join(workdir.path, 'runs', os.path.basename(folder.rstrip('/')))
    return here if os.path.isdir(here) else folder

  return score._replace(shape=find(score.shape), color=find(score.color))


def _load(folder: str, kinds: Sequence[str], *, dataset: Dataset) -> infer.Network:
  return scoring.load(folder, kinds, dataset)
