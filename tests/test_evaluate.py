"""The evaluation program, on small networks with random parameters."""

import json
import os
import subprocess
import sys
from typing import Any, NamedTuple

import jax
import numpy as np
import pytest
import synthetic

from cvn import checkpoint, dataset, infer, metrics
from cvn.errors import UserError
from cvn.evaluation import baselines, pictures, surfaces
from cvn.grid import ColoredVoxels
from cvn.networks import ColorNetwork, ShapeNetwork
from experiments import evaluate as program
from experiments.lib import evaluation, scoring

IMAGE, GRID, AZIMUTHS = 32, 16, (0, 90, 200)


class _State(NamedTuple):
  params: Any
  batch_stats: Any
  opt_state: Any
  step: Any


def save_network(folder, kind, network):
  """A workdir with a network of random parameters."""
  image = np.zeros((1, network.image_size, network.image_size, 3), np.float32)
  shapes = jax.eval_shape(lambda: network.init(jax.random.key(0), image, train=False))
  rng = np.random.default_rng(len(kind))

  def draw(path, x):
    noise = rng.standard_normal(x.shape, np.float32)
    return 1 + 0.1 * abs(noise) if path[-1].key in ('var', 'scale') else 0.1 * noise

  variables = jax.tree_util.tree_map_with_path(draw, shapes)
  checkpoint.start(folder, {'network': kind})
  checkpoint.save(folder, _State(**variables, opt_state={}, step=np.zeros((), np.int32)), {})
  return folder


@pytest.fixture(scope='module')
def given(tmp_path_factory):
  """The flags of a data set of two categories and of two workdirs."""
  root = tmp_path_factory.mktemp('given')
  synthetic.make_dataset(
    root / 'data',
    12,
    splits=('train', 'train', 'train', 'train', 'test', 'test'),
    categories=('ball', 'egg'),
    azimuths=AZIMUTHS,
    image_size=IMAGE,
    grid_size=GRID,
    missing=(10,),
  )
  return {
    'data': str(root / 'data'),
    'shape': save_network(str(root / 'shape'), 'shape', ShapeNetwork(IMAGE, GRID)),
    'color': save_network(str(root / 'color'), 'color', ColorNetwork(IMAGE, GRID)),
  }


def _run(*arguments, **named):
  """Runs the program within this process."""
  return program.main([*arguments, *(f'--{k}={v}' for k, v in named.items())])


def _evaluate(tmp_path, *arguments, **named):
  path = tmp_path / 'new' / 'report.json'
  _run(*arguments, json=path, **named)
  with open(path) as f:
    return json.load(f)


def _make_with_val(tmp_path):
  return synthetic.make_dataset(
    tmp_path / 'data',
    4,
    splits=('train', 'val', 'val', 'test'),
    azimuths=AZIMUTHS,
    image_size=IMAGE,
    grid_size=GRID,
  ).root


def _true(record):
  occupancy, color = np.zeros((GRID,) * 3, bool), np.zeros((GRID,) * 3 + (3,))
  at = tuple(record.surface_index.T)
  occupancy[at], color[at] = True, record.surface_color / 255
  return ColoredVoxels(occupancy, color)


def test_numbers_are_the_means_over_views(tmp_path, given, capsys):
  report = _evaluate(tmp_path, '--baselines', alpha=0.5, **given)
  assert (report['models'], report['views'], report['alpha']) == (3, 3, 0.5)
  opened = dataset.open_dataset(given['data'])
  sizes = {'image_size': IMAGE, 'grid_size': GRID}
  shape, color = (infer.load(given[kind], kind, **sizes) for kind in ('shape', 'color'))
  rows = {4: 'ball', 5: 'egg', 11: 'egg'}  # 10 was never made
  scores = np.zeros((3, 3, 3))
  beaten = np.zeros((3, 3, 3))
  for n, row in enumerate(rows):
    record = dataset.read_record(opened, row)
    true = _true(record)
    own = [r for r in (0, 1, 2, 3, 6, 7, 8, 9) if r % 2 == row % 2]
    trained = [dataset.read_record(opened, r) for r in own]
    mean_shape = baselines.mean_shape([t.surface_index for t in trained], GRID)
    mean_color = np.concatenate([t.surface_color for t in trained]).mean(0) / 255
    results = infer.reconstruct(record.views, shape=shape, color=color, alpha=0.5)
    for v, one in enumerate(infer.split(results)):
      voxels = infer.to_voxels(one)
      assert voxels.occupancy.any()
      iou = metrics.iou(one.probability > 0.8, true.occupancy)
      scores[:, n, v] = (iou, *metrics.surface_psnr(voxels, true))
      plain = voxels._replace(color=np.broadcast_to(mean_color, voxels.color.shape))
      iou = metrics.iou(mean_shape, true.occupancy)
      beaten[:, n, v] = (iou, *metrics.surface_psnr(plain, true))
  for who, x in (('networks', scores), ('baselines', beaten)):
    found = report[who]
    for k, name in enumerate(program.DETAILED):
      near = pytest.approx
      assert found['total'][name] == near(x[k].mean(), rel=1e-4)
      assert found['by_view']['90'][name] == near(x[k, :, 1].mean(), rel=1e-4)
      assert found['by_category']['ball'][name] == near(x[k, 0].mean(), rel=1e-4)
      assert found['by_category']['egg'][name] == near(x[k, 1:].mean(), rel=1e-4)
      both = (x[k, 0].mean() + x[k, 1:].mean()) / 2
      assert found['mean_of_categories'][name] == near(both, rel=1e-4)
    assert list(found['by_view']) == ['0', '90', '200']
    assert found['views_without_voxels'] == 0
  lines = capsys.readouterr().out.splitlines()
  rows = [[x.strip() for x in line.strip('|').split('|')] for line in lines if line[:1] == '|']
  labels = ['', '---', 'networks', 'mean shape, mean colour']
  labels += ['', '---', 'all', 'mean of categories', 'ball', 'egg', '0°', '90°', '200°']
  assert [row[0] for row in rows] == labels
  means = [f'{scores[0].mean():.3f}', f'{beaten[0].mean():.3f}']
  assert rows[6][1:3] == means and [row[1].split()[0] for row in rows[2:4]] == means
  error = np.std(scores[0].mean(1), ddof=1) / np.sqrt(3)
  assert report['networks']['error']['iou'] == pytest.approx(error, rel=1e-4)


def test_shapes_are_measured_by_distances_and_pictures_too(tmp_path, given):
  report = _evaluate(tmp_path, '--baselines', '--pictures', category='ball', **given)
  opened = dataset.open_dataset(given['data'])
  sizes = {'image_size': IMAGE, 'grid_size': GRID}
  shape, color = (infer.load(given[kind], kind, **sizes) for kind in ('shape', 'color'))
  record = dataset.read_record(opened, 4)
  true, results = _true(record), infer.reconstruct(record.views, shape=shape, color=color)
  trained = [dataset.read_record(opened, r) for r in (0, 2, 6, 8)]
  mean_shape = baselines.mean_shape([t.surface_index for t in trained], GRID)
  seen = pictures.draw_all(true, azimuths=AZIMUTHS)
  expected = {k: [] for k in ('f_50', 'f_20', 'chamfer', 'picture_psnr', 'picture_ssim')}
  for one in infer.split(results):
    distances = surfaces.measure(one.occupancy, true.occupancy)
    f_scores = surfaces.f_scores(distances, tolerances=(1 / 50, 1 / 20))
    likeness = pictures.compare(infer.to_voxels(one), seen)
    values = (*f_scores, surfaces.chamfer(distances), likeness.psnr, likeness.ssim)
    for k, value in zip(expected, values, strict=True):
      expected[k].append(value)
  own = report['networks']['by_model']['m4']
  for k, values in expected.items():
    np.testing.assert_allclose(own[k], values, rtol=1e-4)
  distances = surfaces.measure(mean_shape, true.occupancy)
  trivial = report['baselines']['by_model']['m4']
  np.testing.assert_allclose(trivial['chamfer'], [surfaces.chamfer(distances)] * 3)
  assert len({*trivial['picture_ssim']}) == 1 and trivial['picture_ssim'][0] < 1


def test_training_models_are_looked_up(tmp_path, given):
  """A test model's twin among the training models is found by its outline and by its code."""
  folder = str(tmp_path / 'data')
  made = synthetic.make_dataset(
    folder,
    5,
    splits=('train', 'train', 'train', 'train', 'test'),
    azimuths=AZIMUTHS,
    image_size=IMAGE,
    grid_size=GRID,
    missing=(4,),
  )
  dataset.write_record(made.arrays, 4, dataset.read_record(made, 2))
  report = _evaluate(tmp_path, '--retrieval', '--pictures', **given | {'data': folder})
  for way in ('outline', 'code', 'oracle'):
    assert report[way]['total']['iou'] == report[way]['total']['f_200'] == 1
    assert report[way]['total']['chamfer'] == 0
    assert report[way]['total']['psnr_rgb'] == pytest.approx(scoring.PSNR_CEILING)
    assert report[way]['total']['picture_ssim'] == pytest.approx(1)
  assert report['networks']['total']['iou'] < 1


def test_what_lookups_and_pictures_need(tmp_path, given):
  color = {k: given[k] for k in ('data', 'color')}
  for flag in ('--retrieval', '--pictures'):
    with pytest.raises(UserError, match=f'{flag} needs --shape=WORKDIR'):
      _run(flag, **color)
  synthetic.make_dataset(
    tmp_path / 'few', 1, splits=('test',), image_size=IMAGE, grid_size=GRID, azimuths=(0,)
  )
  with pytest.raises(UserError, match='no finished model in the split train: no --retrieval'):
    _run('--retrieval', **given | {'data': tmp_path / 'few'})


def test_the_options_are_known_before_the_evaluation(tmp_path, given):
  named = {'alpha': 0.5, 'split': 'test', 'category': 'ball', **given}
  report = _evaluate(tmp_path, **named)
  assert report['options'] == evaluation.options(**named)
  runs = report['options']['runs']
  assert (runs['color']['step'], runs['shape']['config']['network']) == (0, 'shape')
  assert report['options']['data_digest'] != evaluation.options(**given)['data_digest']


def test_shape_alone_has_no_psnr(tmp_path, given, capsys):
  report = _evaluate(tmp_path, data=given['data'], shape=given['shape'])
  assert report['networks']['total']['psnr_rgb'] is None
  assert report['networks']['total']['iou'] > 0 and report['color'] is None
  assert 'baselines' not in report
  assert 'PSNR' not in capsys.readouterr().out


def test_color_alone_is_judged_on_the_true_shapes(tmp_path, given, capsys):
  report = _evaluate(tmp_path, data=given['data'], color=given['color'], category='ball', alpha=0.5)
  assert 'true shapes' in capsys.readouterr().out
  assert report['models'] == 1 and report['networks']['total']['iou'] is None
  record = dataset.read_record(dataset.open_dataset(given['data']), 4)
  color = infer.load(given['color'], 'color', image_size=IMAGE, grid_size=GRID)
  blended = infer.reconstruct(record.views, color=color, alpha=0.5).color
  true = _true(record)
  expected = [metrics.surface_psnr(true._replace(color=np.asarray(b)), true).rgb for b in blended]
  assert report['networks']['total']['psnr_rgb'] == pytest.approx(np.mean(expected), rel=1e-4)


def test_views_without_voxels_are_counted_and_left_out(tmp_path, given, capsys, monkeypatch):
  def nothing_at_90(views, **options):
    probability = np.ones((len(views),) + (GRID,) * 3, np.float32)
    probability[1] = 0
    found = inner(views, **options)
    return found._replace(probability=probability, occupancy=probability > 0)

  inner = infer.reconstruct
  monkeypatch.setattr(infer, 'reconstruct', nothing_at_90)
  report = _evaluate(tmp_path, alpha=0.5, **given)
  found = report['networks']
  assert found['views_without_voxels'] == 3
  at_90 = found['by_view']['90']
  assert (at_90['iou'], at_90['psnr_rgb'], at_90['psnr_ycbcr']) == (0, None, None)
  assert (at_90['f_20'], at_90['chamfer']) == (0, None)
  others = [found['by_view'][a]['psnr_rgb'] for a in ('0', '200')]
  assert found['total']['psnr_rgb'] == pytest.approx(np.mean(others))
  text = capsys.readouterr().out
  assert '3 views have no occupied voxel' in text and '90°' in text


def test_means_of_nothing_and_of_infinities():
  assert program.mean(np.array([1.0, np.nan, 3.0])) == 2
  assert program.mean(np.array([np.nan])) is None
  assert program.mean(np.array([1.0, np.inf])) is None


@pytest.mark.parametrize('value', ['0', 'nan', '2', 'x'])
def test_alpha_is_in_its_range_or_chosen(value):
  assert not evaluation.is_alpha(value)
  assert evaluation.is_alpha('1') and evaluation.is_alpha('val')


def test_bad_input_is_named(tmp_path, given):
  with pytest.raises(UserError, match='give --shape'):
    _run(data=given['data'])
  with pytest.raises(UserError, match='no data set'):
    _run(**given | {'data': tmp_path})
  with pytest.raises(UserError, match='no category'):
    _run(category='car', **given)
  with pytest.raises(UserError, match='no finished model in the split val'):
    _run(split='val', **given)
  with pytest.raises(UserError, match='holds a shape network'):
    _run(**given | {'color': given['shape']})
  with pytest.raises(UserError, match='cannot write'):
    _run(json=os.path.join(given['data'], 'manifest.json', 'x.json'), **given)


def test_data_of_another_size_is_refused(tmp_path, given):
  synthetic.make_dataset(tmp_path / 'big', 1, splits=('test',), image_size=64, grid_size=32)
  with pytest.raises(UserError, match=r'64-pixel views and a grid of 32'):
    _run(**given | {'data': tmp_path / 'big'})


def test_baselines_need_training_models(tmp_path, given):
  synthetic.make_dataset(
    tmp_path / 'few', 1, splits=('test',), image_size=IMAGE, grid_size=GRID, azimuths=(0,)
  )
  report = tmp_path / 'report.json'
  with pytest.raises(UserError, match='no finished ball in the split train'):
    _run('--baselines', json=report, **given | {'data': tmp_path / 'few'})
  assert os.listdir(tmp_path) == ['few']


def test_program_ends_in_one_line():
  command = [sys.executable, '-m', 'experiments.evaluate', '--data=/nowhere', '--shape=/nowhere']
  done = subprocess.run(command, capture_output=True, text=True)
  assert done.returncode == 1
  assert done.stderr.startswith('error: /nowhere') and done.stderr.count('\n') == 1


def test_no_view_counts_for_more_than_rounding_allows():
  found = {'psnr_rgb': [], 'psnr_ycbcr': []}
  for rgb, ycbcr in ((20.0, 25.0), (np.inf, 177.0), (np.nan, np.nan)):
    scoring.append_psnr(found, metrics.SurfacePsnr(rgb, ycbcr))
  ceiling = -10 * np.log10(1 / 12 / 255**2)
  np.testing.assert_allclose(found['psnr_rgb'], [20, ceiling, np.nan])
  np.testing.assert_allclose(found['psnr_ycbcr'], [25, ceiling, np.nan])


def test_a_threshold_is_chosen_on_val_or_given(tmp_path, given, capsys):
  """The chosen one is the best of those tried, on the models that the split val has."""
  data = _make_with_val(tmp_path)
  shape = {'data': data, 'shape': given['shape']}
  chosen = _evaluate(tmp_path, threshold='val', **shape)['threshold']
  scores = {
    t: _evaluate(tmp_path, split='val', threshold=t, **shape)['networks']['total']['iou']
    for t in scoring.PROBABILITIES
  }
  assert scores[chosen] == pytest.approx(max(scores.values()))
  assert f'above {chosen:g}' in capsys.readouterr().out
  with pytest.raises(UserError, match='no finished model in the split val: give a --threshold'):
    _run(threshold='val', **given)
  assert not evaluation.is_threshold('high')


def test_a_data_set_with_a_test_split_alone_is_measured_by_another_one(tmp_path, given):
  """Threshold, alpha and baselines are the other data set's; models and scores are not."""
  only_test = synthetic.make_dataset(
    tmp_path / 'only_test', 2, splits=('test',), azimuths=AZIMUTHS, image_size=IMAGE, grid_size=GRID
  ).root
  whole = _make_with_val(tmp_path)
  chosen = {'threshold': 'val', 'alpha': 'val'}
  with pytest.raises(UserError, match='or another data set as --reference_data'):
    _run(**given | chosen | {'data': only_test})
  own = _evaluate(tmp_path, '--baselines', **given | chosen | {'data': whole})
  far = given | chosen | {'data': only_test, 'reference_data': whole}
  report = _evaluate(tmp_path, '--baselines', **far)
  assert report['models'] == 2 and report['baselines']['total']['iou'] is not None
  assert (report['threshold'], report['alpha']) == (own['threshold'], own['alpha'])
  assert report['options']['reference_data'] == dataset.to_url(whole)
  with pytest.raises(UserError, match='has no source'):
    _run(**far | {'reference_source': 'nowhere'})
  big = synthetic.make_dataset(tmp_path / 'big', 1, splits=('val',), image_size=64, grid_size=32)
  with pytest.raises(UserError, match='must be of the same sizes'):
    _run(**far | {'reference_data': big.root})


def test_an_alpha_is_chosen_on_val_or_given(tmp_path, given, capsys):
  data = _make_with_val(tmp_path)
  whose = {k: given[k] for k in ('shape', 'color')} | {'data': data, 'threshold': 0.3}
  options = '--flip', '--carve'
  chosen = _evaluate(tmp_path, *options, alpha='val', **whose)['alpha']
  scores = {
    a: _evaluate(tmp_path, *options, split='val', alpha=a, **whose)['networks']['total']['psnr_rgb']
    for a in program.ALPHAS
  }
  assert len(set(scores.values())) == len(scores)
  assert chosen == max(scores, key=scores.get)
  assert f'alpha: {chosen:g}' in capsys.readouterr().out
  with pytest.raises(UserError, match='no finished model in the split val: give a --alpha'):
    _run(alpha='val', **given)


def test_the_mirrored_view_may_count_too(tmp_path, given):
  plain = _evaluate(tmp_path, **given)
  flipped = _evaluate(tmp_path, '--flip', **given)
  assert flipped['options']['flip'] and not plain['options']['flip']
  assert flipped['networks']['total']['psnr_rgb'] != plain['networks']['total']['psnr_rgb']


def test_shapes_may_be_carved_by_the_silhouettes(tmp_path, given):
  plain = _evaluate(tmp_path, **given)['networks']['total']
  report = _evaluate(tmp_path, '--carve', **given)
  assert report['options']['carve'] and report['networks']['total']['iou'] != plain['iou']


def test_carving_warns_where_the_camera_is_not_known(tmp_path, given, monkeypatch, caplog):
  monkeypatch.setattr(program, 'UNKNOWN_CAMERA', 'synthetic')
  _evaluate(tmp_path, '--carve', data=given['data'], shape=given['shape'])
  assert 'camera' in caplog.text
  caplog.clear()
  _evaluate(tmp_path, data=given['data'], shape=given['shape'])
  assert 'camera' not in caplog.text


def test_models_of_one_source(tmp_path, given):
  with pytest.raises(UserError, match="no source 'shapenet'; it has synthetic"):
    _run('--source=shapenet', **given)
  report = _evaluate(tmp_path, '--source=synthetic', **given)
  models = report['networks']['by_model']
  assert len(models) == report['models'] and {m['source'] for m in models.values()} == {'synthetic'}
  means = [np.mean(m['iou']) for m in models.values()]
  assert np.mean(means) == pytest.approx(report['networks']['total']['iou'])
