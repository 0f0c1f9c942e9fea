"""Predictions in the authors' layout: the networks' own volumes, and scores as by their rules."""

import json
import os

import h5py
import numpy as np
import pytest
import synthetic
from PIL import Image
from test_evaluate import save_network

from cvn import dataset, infer
from cvn.errors import UserError
from cvn.networks import ColorNetwork, ShapeNetwork
from datagen import write_release
from experiments import evaluate
from experiments import write_release_predictions as program
from experiments.lib import cli

IMAGE, GRID, AZIMUTHS = 32, 16, (0, 90, 210)
NAMES = ('0.000', '1.570', '3.663')


@pytest.fixture(scope='module')
def given(tmp_path_factory):
  """The flags of a data set of chairs and people, and of two workdirs."""
  root = tmp_path_factory.mktemp('given')
  synthetic.make_dataset(
    root / 'data',
    4,
    splits=('test', 'test', 'test', 'train'),
    categories=('chair', 'human'),
    azimuths=AZIMUTHS,
    image_size=IMAGE,
    grid_size=GRID,
  )
  return {
    'data': str(root / 'data'),
    'shape': save_network(str(root / 'shape'), 'shape', ShapeNetwork(IMAGE, GRID)),
    'color': save_network(str(root / 'color'), 'color', ColorNetwork(IMAGE, GRID)),
  }


def run(module, *arguments, **named):
  argv = [*arguments, *(f'--{k}={v}' for k, v in named.items())]
  if module is write_release:
    return module.run(cli.parse(module.define_flags, argv))
  return module.main(argv)


@pytest.fixture(scope='module')
def output(given, tmp_path_factory):
  folder = tmp_path_factory.mktemp('output')
  run(write_release, data=given['data'], output=folder)
  run(program, output=folder, **given)
  return folder


def read(path):
  with h5py.File(path) as file:
    return file['data'][()]


def files(folder):
  return {
    os.path.join(parent, name): os.stat(os.path.join(parent, name)).st_mtime_ns
    for parent, _, names in os.walk(folder)
    for name in names
  }


PLACES = {0: '{}/03001627/m0', 1: '{}_human/human/m1', 2: '{}/03001627/m2'}


def test_files_hold_the_networks_volumes(given, output):
  sizes = {'image_size': IMAGE, 'grid_size': GRID}
  shape, color = (infer.load(given[kind], kind, **sizes) for kind in ('shape', 'color'))
  for row, place in PLACES.items():
    views = dataset.read_record(dataset.open_dataset(given['data']), row).views
    expected = infer.reconstruct(views, shape=shape).probability
    colors = infer.reconstruct(views, color=color)
    own = infer.reconstruct(views, color=color, alpha=1).weight
    for v, name in enumerate(NAMES):
      probability = read(output / place.format('output_shape') / f'{name}.h5')
      assert (probability.shape, probability.dtype) == ((GRID,) * 3 + (1,), np.float32)
      np.testing.assert_array_equal(probability[..., 0], expected[v])
      volume = read(output / place.format('output_color') / f'{name}.h5')
      assert (volume.shape, volume.dtype) == ((GRID,) * 3 + (9,), np.float32)
      np.testing.assert_array_equal(volume[..., :3], colors.regressed[v])
      np.testing.assert_array_equal(volume[..., 3], 1 - own[v])
      np.testing.assert_array_equal(volume[..., 4:6], colors.flow[v])
      np.testing.assert_array_equal(volume[..., 6:], colors.color[v])


def nearest(points, among):
  """Of each point, the first of the nearest others."""
  return np.square(points[:, None] - among[None]).sum(-1).argmin(1)


def score(truth, view, probability, color):
  """(IoU, PSNR RGB, PSNR YCbCr) of one view, from the files alone, by the authors' rules."""
  occupied = truth[..., 0] > -0.5
  shape = probability[..., 0] > 0.8
  iou = (shape & occupied).sum() / (shape | occupied).sum()
  voxels = np.argwhere(probability[..., 0] >= 0.8)
  regressed, confidence, flow, _ = np.split(color[tuple(voxels.T)], (3, 4, 6), axis=1)
  weight = np.minimum((1 - confidence) / 0.2, 1)
  size = len(view)
  column, row = np.minimum((flow * size).astype(int), size - 1).T
  ground = (np.abs(view - view[0, 0, 0]) < 1e-3).all(-1)
  foreground = np.argwhere(~ground)
  at = np.stack([row, column], 1)
  lost = ground[row, column]
  at[lost] = foreground[nearest(at[lost], foreground)]
  blended = regressed * (1 - weight) + view[tuple(at.T)] * weight
  surface = np.argwhere(occupied)
  partner = truth[tuple(surface[nearest(voxels, surface)].T)]
  difference = 255 * (blended - partner).astype(np.float64)
  r, g, b = difference.T
  ycbcr = (
    0.299 * r + 0.587 * g + 0.114 * b,
    -0.168736 * r - 0.331264 * g + 0.5 * b,
    0.5 * r - 0.418688 * g - 0.081312 * b,
  )
  errors = np.mean(difference**2), np.mean(np.square(ycbcr))
  return iou, *(20 * np.log10(255) - 10 * np.log10(error) for error in errors)


def test_scores_from_the_files_are_ours(given, output, tmp_path):
  run(evaluate, category='chair', json=tmp_path / 'report.json', **given)
  ours = json.loads((tmp_path / 'report.json').read_text())['networks']['by_view']
  scores = np.zeros((2, len(NAMES), 3))
  for n, model in enumerate(('m0', 'm2')):
    folder = output / 'data/ShapeNetCore_im2avatar/03001627' / model
    truth = read(folder / f'models/model_normalized_{GRID}.h5')
    for v, name in enumerate(NAMES):
      with Image.open(folder / 'views' / f'{name}.png') as image:
        view = np.asarray(image) / 255
      volumes = [
        read(output / f'output_{k}/03001627/{model}/{name}.h5') for k in ('shape', 'color')
      ]
      scores[n, v] = score(truth, view, *volumes)
  for v, azimuth in enumerate(AZIMUTHS):
    iou, rgb, ycbcr = scores[:, v].mean(0)
    assert ours[str(azimuth)]['iou'] == pytest.approx(iou, abs=1e-12) and iou > 0
    assert ours[str(azimuth)]['psnr_rgb'] == pytest.approx(rgb, abs=1e-3)  # dB
    assert ours[str(azimuth)]['psnr_ycbcr'] == pytest.approx(ycbcr, abs=1e-3)


def test_only_what_is_missing_is_written(given, output, capsys):
  before = files(output)
  lost = output / 'output_color/03001627/m0/1.570.h5'
  content = lost.read_bytes()
  lost.unlink()
  run(program, output=output, **given)
  assert lost.read_bytes() == content
  after = files(output)
  assert {path for path in before if after[path] != before[path]} == {str(lost)}
  assert capsys.readouterr().out.splitlines() == [
    f'{output}: shape of 3 models; written 0, already there 3',
    f'{output}: color of 3 models; written 1, already there 2',
  ]


@pytest.mark.parametrize('change', [{'alpha': 0.5}, {'split': 'train'}])
def test_predictions_of_another_kind_do_not_mix(given, output, change):
  before = files(output)
  with pytest.raises(UserError, match='something else'):
    run(program, output=output, **given | change)
  assert files(output) == before


def test_one_network_alone(given, tmp_path):
  run(program, output=tmp_path, data=given['data'], shape=given['shape'], category='human')
  folders = {os.path.relpath(os.path.dirname(path), tmp_path) for path in files(tmp_path)}
  assert folders == {'.', 'output_shape_human/human/m1'}


def test_bad_input_is_named(given, tmp_path):
  with pytest.raises(UserError, match='give --shape'):
    run(program, data=given['data'], output=tmp_path)
  with pytest.raises(UserError, match='no finished model in the split val'):
    run(program, output=tmp_path, split='val', **given)
  with pytest.raises(UserError, match='holds a shape network'):
    run(program, output=tmp_path, **given | {'color': given['shape']})
  with pytest.raises(UserError, match='no category'):
    run(program, output=tmp_path, category='car', **given)
  assert os.listdir(tmp_path) == []
