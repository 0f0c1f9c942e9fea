"""Models to turn: which ones are chosen, and that they are what the networks make of the views."""

import base64
import functools
import gzip
import io
import re
import shutil

import numpy as np
import pages
import pytest
import synthetic
import trimesh
import workdirs
from test_evaluate import save_network

from cvn import data, infer
from cvn.dataset import open_dataset, read_record
from cvn.networks import ColorNetwork, ShapeNetwork
from experiments.lib import evaluation, scoring
from experiments.report import models as report_models
from experiments.report import read as report_read

IMAGE, GRID = 32, 16


@pytest.fixture(scope='module')
def root(tmp_path_factory):
  """A data set of eggs and balls, and a workdir of networks that were judged on it."""
  root = tmp_path_factory.mktemp('models')
  options = {'azimuths': (0, 90), 'image_size': IMAGE, 'grid_size': GRID}
  splits = ('train', 'test', 'test', 'test')
  made = synthetic.make_dataset(
    root / 'data', 8, splits=splits, categories=('egg', 'ball'), **options
  )
  work = root / 'work'
  save_network(str(work / 'runs/msfcel_all_0'), 'shape', ShapeNetwork(IMAGE, GRID))
  save_network(str(work / 'runs/blended_all_0'), 'color', ColorNetwork(IMAGE, GRID))
  workdirs.write_training(root / 'other')  # a log, without which a training has not begun
  for name in ('msfcel_all_0', 'blended_all_0'):
    shutil.copy(root / 'other/runs/msfcel_all_0/log.jsonl', work / 'runs' / name)
    workdirs.write_json(work / 'runs' / name / 'config.json', _config(root, name))
  rows = data.select_rows(made, 'test')
  models = {made.manifest.models[r].id: made.manifest.models[r].category for r in rows}
  workdirs.write_json(work / 'scores/blended_0.2_all_0_test.json', _report(root, models))
  return root


def _config(root, name):
  kind = 'shape' if name.startswith('msfcel') else 'color'
  return workdirs.CONFIG | {'network': kind, 'data': str(root / 'data')}


def _report(root, models):
  return {
    **{'data': str(root / 'data'), 'split': 'test', 'alpha': 0.2, 'threshold': 0.4},
    # As they were named elsewhere, before the workdir was moved here.
    **{'shape': '/elsewhere/runs/msfcel_all_0', 'color': '/elsewhere/runs/blended_all_0/'},
    'networks': {'by_model': {m: {'category': c} for m, c in models.items()}},
    'options': {
      'runs': {
        kind: evaluation.describe_run(str(root / f'work/runs/{name}_all_0'))
        for kind, name in (('shape', 'msfcel'), ('color', 'blended'))
      }
    },
  }


@pytest.fixture
def given(root):
  workdir = report_read.read_workdir(str(root / 'work'))
  return workdir, open_dataset(str(root / 'data'))


def test_chosen_are_test_models_of_each_category_by_seed(given):
  workdir, opened = given
  choices = [
    report_models.choose(workdir, opened, per_category=2, seed=seed) for seed in (0, 0, 1, 2, 3)
  ]
  assert choices[0] == choices[1]
  assert len({str(c) for c in choices}) > 1
  for chosen in choices:
    assert [p.model.category for p, _ in chosen] == ['ball', 'ball', 'egg', 'egg']
    assert len({p.row for p, _ in chosen}) == 4
    assert {p.model.split for p, _ in chosen} == {'test'}


def test_networks_are_found_where_they_were_moved_to(given):
  ((_, scores), *_) = report_models.choose(*given, per_category=1, seed=0)
  assert scores['blended_0.2'].shape == f'{given[0].path}/runs/msfcel_all_0'


def make_example(workdir, opened):
  """The first example."""
  ((pick, scores), *_) = report_models.choose(workdir, opened, per_category=1, seed=0)
  load = functools.partial(scoring.load, dataset=opened)
  return report_models.make_example(opened, pick, scores, load)


def test_examples_are_the_networks_reconstructions(given):
  workdir, opened = given
  example = make_example(workdir, opened)
  record = read_record(opened, example.pick.row)
  np.testing.assert_array_equal(example.view, record.views[example.pick.view])
  shape, color = (
    scoring.load(f'{workdir.path}/runs/{name}', [kind], opened)
    for name, kind in (('msfcel_all_0', 'shape'), ('blended_all_0', 'color'))
  )
  found = infer.reconstruct(example.view, shape=shape, color=color, threshold=0.4)
  occupied = np.asarray(found.occupancy)
  true = scoring.to_voxels(record, GRID).occupancy
  iou = (occupied & true).sum() / (occupied | true).sum()
  ours, truth = example.models
  assert (ours.title, ours.note) == ('paper’s method', f'threshold 0.40, IoU {iou:.2f}')
  np.testing.assert_array_equal(ours.voxels.occupancy, occupied)
  np.testing.assert_array_equal(truth.voxels.occupancy, true)


def test_pages_have_the_models_as_files(given):
  picture, credits = report_models.make_examples(*given, per_category=1, seed=0, name='still')
  example = make_example(*given)
  canvases = [a for t, a in pages.Tags(picture.html).tags if t == 'canvas']
  assert [a['data-group'] for a in canvases] == ['still-0'] * 2 + ['still-1'] * 2
  assert canvases[0]['data-azimuth'] == f'{example.pick.azimuth + 30:g}'
  assert example.pick.model.id in credits and credits.count('\n') == 1
  for canvas, model in zip(canvases, example.models, strict=False):
    (text,) = re.findall(f'id="{canvas["data-glb"]}">(.*?)</script>', picture.html)
    glb = gzip.decompress(base64.b64decode(text))
    low, high = trimesh.load_scene(io.BytesIO(glb), file_type='glb').bounds
    inside = np.argwhere(model.voxels.occupancy)
    np.testing.assert_allclose(low, inside.min(0) / GRID - 0.5, atol=1e-6)
    np.testing.assert_allclose(high, (inside.max(0) + 1) / GRID - 0.5, atol=1e-6)


def test_nothing_is_shown_without_networks_or_their_data(given, tmp_path):
  workdir, opened = given
  options = {'per_category': 1, 'seed': 0, 'name': 'still'}
  moved = workdir._replace(path=str(tmp_path))
  assert report_models.make_examples(moved, opened, **options) == []
  elsewhere = [s._replace(data='/elsewhere') for s in workdir.scores]
  assert report_models.make_examples(workdir._replace(scores=elsewhere), opened, **options) == []


def test_networks_that_were_trained_further_since_are_not_shown(given):
  workdir, opened = given
  stale = [s._replace(runs=s.runs | {'shape': {'step': 1, 'config': {}}}) for s in workdir.scores]
  assert not report_models.choose(workdir._replace(scores=stale), opened, per_category=1, seed=0)


def test_a_result_without_voxels_has_no_canvas(given):
  workdir, opened = given
  empty = workdir._replace(scores=[s._replace(threshold=2.0) for s in workdir.scores])
  assert make_example(empty, opened).models[0].note == 'threshold 2.00, IoU 0.00'
  picture, _ = report_models.make_examples(empty, opened, per_category=1, seed=0, name='still')
  assert picture.html.count('<canvas') == 2  # the truths
