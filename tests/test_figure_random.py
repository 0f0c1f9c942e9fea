"""Figures of models drawn at random, and what all figures share: choice, tiles, files."""

import json
import os

import numpy as np
import pytest
import synthetic
import workdirs
from absl import flags
from PIL import Image
from test_evaluate import save_network

from cvn import dataset, figures
from cvn.errors import UserError
from cvn.infer import Reconstruction
from cvn.networks import NETWORKS
from experiments.lib import cli, pictures, protocol, scoring
from experiments.lib.runs import Run
from experiments.paper.figures import random as figure_random

IMAGE, GRID, AZIMUTHS = 32, 16, (0, 90, 200)


def make_workdir(root, monkeypatch):
  """The flags of a data set of two categories whose networks all predict a ball."""
  synthetic.make_dataset(
    root / 'data',
    8,
    splits=('train', 'train', 'test', 'test'),
    categories=('car', 'zebra'),
    azimuths=AZIMUTHS,
    image_size=IMAGE,
    grid_size=GRID,
  )
  ball = np.linalg.norm(np.indices((GRID,) * 3) - (GRID - 1) / 2, axis=0) < GRID / 3
  rng = np.random.default_rng(0)
  volumes = {k: rng.random((*ball.shape, 3)) for k in ('color', 'regressed', 'sampled')}
  volumes |= {'flow': rng.random((*ball.shape, 2)), 'weight': rng.random(ball.shape)}
  found = Reconstruction(occupancy=ball, probability=None, **volumes)

  def train(plan, training, category, seed):
    config = workdirs.CONFIG | {'seed': int(seed)}
    config['category'] = [] if category == protocol.ALL else [category]
    folder = os.path.join(plan.workdir, 'runs', f'{training}_{category}_{seed}')
    return Run(folder, config, 2 * plan.epochs)

  def evaluate(plan, method, category, seed, **_):
    del plan, category, seed
    joint = protocol.METHODS[method].shape == 'r2n2'
    return {'threshold': -0.1 if joint else 0.5, 'alpha': protocol.METHODS[method].alpha}

  def make_predictor(plan, method, category, seed):
    del plan, category, seed
    own = found._replace(color=1 - found.color) if method == 'r2n2' else found
    return lambda views: [own] * len(views)

  monkeypatch.setattr(protocol, 'train', train)
  monkeypatch.setattr(protocol, 'evaluate', evaluate)
  monkeypatch.setattr(protocol, 'make_predictor', make_predictor)
  return {'data': str(root / 'data'), 'workdir': str(root / 'work')}


def save_networks(given, category, *trainings):
  """Networks of random parameters in the folders of trainings."""
  for training in trainings:
    kind = protocol.TRAININGS[training]['network']
    folder = os.path.join(given['workdir'], 'runs', f'{training}_{category}_0')
    save_network(folder, kind, NETWORKS[kind](IMAGE, GRID))


def run(program, *arguments, **named):
  """Runs a program."""
  program.main([*arguments, *(f'--{k}={v}' for k, v in named.items())])


def read_figure(given, name):
  """A figure's pixels, and what is said of it."""
  stem = os.path.join(given['workdir'], 'figures', name)
  with open(f'{stem}.json') as f:
    return np.asarray(Image.open(f'{stem}.png')), json.load(f)


@pytest.fixture
def given(tmp_path, monkeypatch):
  return make_workdir(tmp_path, monkeypatch)


def test_the_figure_tells_what_it_shows(given, capsys):
  run(figure_random, methods='r2n2,flow', tile=48, figure_seed=7, **given)
  image, facts = read_figure(given, 'random')
  assert image.ndim == 3 and (image < 100).any()
  assert facts['figure_seed'] == 7 and 'seed 7' in facts['caption']
  assert [r['category'] for r in facts['rows']] == ['car', 'car', 'zebra', 'zebra']
  assert {r['id'] for r in facts['rows']} == {'m2', 'm3', 'm6', 'm7'}
  assert {r['azimuth'] for r in facts['rows']} <= {*AZIMUTHS}
  assert facts['networks']['zebra'] == {
    t: os.path.join('runs', f'{t}_zebra_0') for t in ('flow', 'msfcel', 'r2n2')
  }
  written = os.path.join(given['workdir'], 'figures', 'random')
  assert capsys.readouterr().out.splitlines() == [f'{written}.png', f'{written}.json']
  assert sorted(os.listdir(os.path.dirname(written))) == ['random.json', 'random.png']


def test_one_model_of_all_categories(given):
  options = {'methods': 'flow', 'tile': 48, 'name': 'x', 'seeds': '3'}
  run(figure_random, '--models=all', '--quick', **options, **given)
  _, facts = read_figure(given, 'x')
  assert facts['networks']['car'] == facts['networks']['zebra']
  assert facts['networks']['car']['flow'] == os.path.join('runs', 'flow_all_3')
  shown = facts['runs']['flow_all_3']
  assert (shown['category'], shown['epochs'], shown['seed']) == ([], 1, 3)


def plan_of(given, **named):
  return protocol.read_flags(cli.parse(protocol.define_flags, **given, **named))


def test_a_seed_means_a_choice(given):
  opened = dataset.open_dataset(given['data'])

  def choose(seed=0, per_category=2, **named):
    options = {'seed': seed, 'per_category': per_category}
    return pictures.choose(plan_of(given, **named), opened, **options)

  assert choose(1) == choose(1)
  assert len({tuple(choose(n)) for n in range(8)}) > 4
  assert [e.row for e in choose(per_category=1, category='zebra')] in ([3], [7])
  assert sorted(e.row for e in choose(per_category=9)) == [2, 3, 6, 7]
  for e in choose():
    assert e.model == opened.manifest.models[e.row] and e.azimuth == AZIMUTHS[e.view]


def test_results_are_the_predictors(given, monkeypatch):
  """A predictor that knows the truth draws what the truth's column shows."""
  opened = dataset.open_dataset(given['data'])
  by_view = {}
  for row in (2, 3, 6, 7):
    record = dataset.read_record(opened, row)
    for view in record.views:
      by_view[view.tobytes()] = scoring.to_voxels(record, GRID)

  def make_predictor(plan, method, category, seed):
    return lambda views: [by_view[v.tobytes()] for v in views]

  monkeypatch.setattr(protocol, 'make_predictor', make_predictor)
  shown = []
  monkeypatch.setattr(figures, 'grid_of_images', lambda rows, **_: shown.extend(rows))
  plan = plan_of(given)
  chosen = pictures.choose(plan, opened, seed=0, per_category=1)
  pictures.draw_results(plan, opened, chosen, ['flow'], tile=64)
  for row in shown:
    assert len(row) == 5
    for side in (1, 2):
      np.testing.assert_array_equal(row[side], row[side + 2])
    assert not np.array_equal(row[1], row[2])


def test_bad_input_is_named(given, tmp_path):
  for methods in ('msfcel', 'fly', ''):
    with pytest.raises(flags.Error, match='methods'):
      run(figure_random, methods=methods, **given)
  synthetic.make_dataset(tmp_path / 'few', 1, image_size=IMAGE, grid_size=GRID, azimuths=(0,))
  with pytest.raises(UserError, match='no finished model in the split test'):
    run(figure_random, **given | {'data': str(tmp_path / 'few')})
  with pytest.raises(UserError, match='no data set'):
    run(figure_random, **given | {'data': str(tmp_path)})
