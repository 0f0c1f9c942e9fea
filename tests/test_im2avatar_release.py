"""The source of released records, on miniatures of both layouts that the tests write."""

import shutil

import h5py
import numpy as np
import pytest
import synthetic
from absl import logging
from PIL import Image

from cvn.errors import UserError
from datagen import pipeline
from datagen.pipeline import Job, Settings
from datagen.quality.examine import flow_stats
from datagen.sources import im2avatar_release as source

SIZES = {'azimuths': (0, 30, 120, 240), 'image_size': 32, 'grid_size': 16}
NAMES = ('0.000', '0.523', '2.093', '4.187')  # of the views at these azimuths


def write(path, array):
  path.parent.mkdir(parents=True, exist_ok=True)
  with h5py.File(path, 'w') as file:
    file['data'] = array


def dense(record, values):
  volume = np.full((16, 16, 16, values.shape[-1]), -1.0)
  volume[tuple(record.surface_index.T)] = values
  return volume


def write_model(folder, record, volume, flow):
  """One model; `volume` and `flow` are the places of its arrays."""
  write(folder / volume, dense(record, record.surface_color / 255))
  (folder / 'views').mkdir()
  for name, rgba, uv in zip(NAMES, record.views, record.flow, strict=True):
    write(folder / flow.format(name), dense(record, uv))
    rgb = np.where(rgba[..., 3:] > 0, rgba[..., :3], np.uint8(245))
    Image.fromarray(rgb).save(folder / 'views' / f'{name}.png')


@pytest.fixture(scope='module')
def record():
  return synthetic.make_record(0, **SIZES)


@pytest.fixture(scope='module')
def shapenet(record, tmp_path_factory):
  root = tmp_path_factory.mktemp('ShapeNetCore_im2avatar')
  for name in ('b2', 'a1'):
    places = 'models/model_normalized_16.h5', 'models/16_{}_coor.h5'
    write_model(root / '03001627' / name, record, *places)
  return root


@pytest.fixture
def model(shapenet, tmp_path):
  """A model of its own, to be damaged."""
  folder = tmp_path / '03001627' / 'a1'
  shutil.copytree(shapenet / '03001627' / 'a1', folder)
  return folder


def read(root, category='chair'):
  return source.read_record(source.list_models(category, str(root))[0], **SIZES)


def check_equal(got, record):
  np.testing.assert_array_equal(got.surface_index, record.surface_index)
  np.testing.assert_array_equal(got.surface_color, record.surface_color)
  np.testing.assert_allclose(got.flow, record.flow, atol=1e-7)
  np.testing.assert_array_equal(got.views[..., 3], record.views[..., 3])
  seen = record.views[..., 3] > 0
  np.testing.assert_array_equal(got.views[seen], record.views[seen])
  assert (got.views[~seen] == (245, 245, 245, 0)).all()
  assert not got.visible.any() and got.visible.shape == record.visible.shape


def test_shapenet(shapenet, record):
  models = source.list_models('chair', str(shapenet))
  assert [m.id for m in models] == ['a1', 'b2']
  assert {m.category for m in models} == {'chair'}
  assert source.list_models('03001627', str(shapenet), limit=1) == models[:1]
  check_equal(read(shapenet), record)


def test_people(record, tmp_path):
  write_model(tmp_path / 'clothes9' / 'mesh8_new', record, 'mesh8_new.h5', 'flow/16_{}_coor.h5')
  (tmp_path / 'clothes9' / 'notes').mkdir()
  assert [m.id for m in source.list_models('human', str(tmp_path))] == ['clothes9_mesh8_new']
  check_equal(read(tmp_path, 'human'), record)


def test_views_of_about_these_azimuths_will_do(model, record):
  (model / 'views/4.187.png').rename(model / 'views/4.189.png')
  (model / 'models/16_4.187_coor.h5').rename(model / 'models/16_4.189_coor.h5')
  Image.new('RGB', (9, 9)).save(model / 'views' / 'thumbnail.png')
  check_equal(read(model.parent.parent), record)


def damage(place, change):
  def damaged(folder):
    with h5py.File(folder / place, 'r+') as file:
      data = file['data'][()]
      change(data)
      file['data'][()] = data

  return damaged


def surface_nan(data):
  data[tuple(np.argwhere(data[..., 0] > -0.5)[0])] = (0.5, np.nan, 0.5)


def surface_bright(data):
  data[data > -0.5] *= 255


def nothing(data):
  data[:] = -1


@pytest.mark.parametrize(
  'change, message',
  [
    (lambda m: shutil.rmtree(m / 'views'), r'no file views/0.000.png, its view at 0 degrees'),
    (lambda m: (m / 'views/0.523.png').unlink(), r'no file views/0.523.png, its view at 30'),
    (lambda m: (m / 'models/16_0.523_coor.h5').unlink(), 'no file models/16_0.523_coor.h5'),
    (lambda m: (m / 'models/model_normalized_16.h5').unlink(), 'model_normalized_16.h5'),
    (lambda m: (m / 'models/model_normalized_16.h5').write_text('?'), 'cannot be read as HDF5'),
    (lambda m: write(m / 'models/model_normalized_16.h5', np.zeros((8, 8, 8, 3))), 'not numbers'),
    (damage('models/model_normalized_16.h5', surface_nan), ' 1 of .* outside .* as nan'),
    (damage('models/model_normalized_16.h5', surface_bright), r'values outside \[0, 1\]'),
    (damage('models/model_normalized_16.h5', nothing), '0 surface voxels'),
    (damage('models/16_0.523_coor.h5', nothing), '16_0.523_coor.h5: .* outside .* as -1'),
    (lambda m: (m / 'views/0.000.png').write_text('?'), 'cannot be read as PNG'),
    (lambda m: Image.new('RGB', (9, 9)).save(m / 'views/0.000.png'), '9 x 9 pixels, not 32 x 32'),
    (lambda m: (m / 'views/0.000.png').unlink() or Image.new('RGB', (32, 32), (245,) * 3).save(
      m / 'views/0.000.png'), 'only its background'),
  ],
)  # fmt: skip
def test_damaged_models_fail_in_one_line(model, change, message):
  change(model)
  with pytest.raises(UserError, match=message) as e:
    read(model.parent.parent)
  assert str(model) in str(e.value) and '\n' not in str(e.value)


def test_a_link_out_of_the_folder_is_refused(model, tmp_path):
  place = model / 'models/model_normalized_16.h5'
  place.rename(tmp_path / 'elsewhere.h5')
  place.symlink_to(tmp_path / 'elsewhere.h5')
  with pytest.raises(UserError, match='leads out'):
    read(model.parent.parent)


@pytest.mark.parametrize(
  'category, place, message',
  [
    ('chair', None, '--input=DIR'),
    ('chair', 'nowhere', 'nowhere is none'),
    ('car', '', 'no folder 02958343; it has 03001627'),
    ('human', '', 'no model of category human'),
  ],
)
def test_input_that_is_none(shapenet, category, place, message):
  with pytest.raises(UserError, match=message):
    source.list_models(category, place if place is None else str(shapenet / place))


def test_the_run_gets_the_flows_quality(shapenet, tmp_path):
  made = synthetic.make_dataset(
    tmp_path / 'data', 1, missing=(0,), capacity=4096, splits=('train',), **SIZES
  )
  model = source.list_models('chair', str(shapenet))[0]
  settings = Settings(similarity=0.2, **SIZES)
  outcome = pipeline.run_job(Job(made.root, 0, model, 'im2avatar_release', settings, 60.0))
  assert outcome.reason == ''
  assert outcome.stats == flow_stats(read(shapenet), 0.2) != flow_stats(read(shapenet), 0.1)
  assert 0 == outcome.stats.visible < outcome.stats.fallback < outcome.stats.matched


@pytest.fixture
def warnings(monkeypatch):
  said = []
  monkeypatch.setattr(logging, 'warning', lambda text, *values: said.append(text % values))
  monkeypatch.setattr(source, 'GRID_SIZE', 16)
  monkeypatch.setattr(source, 'AZIMUTHS', SIZES['azimuths'])
  return said


def turn_volumes(folder, turn):
  for path in (folder / 'models').iterdir():
    with h5py.File(path, 'r+') as file:
      file['data'][()] = turn(file['data'][()])


def test_volumes_with_our_axes_are_taken_without_a_word(shapenet, warnings):
  source.list_models('chair', str(shapenet))
  assert warnings == []


def test_other_axes_are_kept_and_named(model, record, warnings):
  turn_volumes(model, lambda v: v.transpose(2, 1, 0, 3)[:, :, ::-1])
  got = read(model.parent.parent)
  assert len(warnings) == 1 and 'run along (z, y, -x)' in warnings[0]
  assert 'mirrored' not in warnings[0]
  x, y, z = record.surface_index.T.astype(int)
  kept = {tuple(i) for i in got.surface_index.astype(int)}
  assert kept == set(zip(z, y, 15 - x, strict=True))
  turn_volumes(model, lambda v: v[:, :, ::-1])
  source.list_models('chair', str(model.parent.parent))
  assert 'run along (z, y, x)' in warnings[1] and 'mirrored, unless azimuths' in warnings[1]


def test_flows_that_do_not_follow_the_voxels(model, warnings):
  for path in (model / 'models').glob('*_coor.h5'):
    with h5py.File(path, 'r+') as file:
      file['data'][()] = file['data'][()][..., ::-1]  # (v, u)
  source.list_models('chair', str(model.parent.parent))
  assert len(warnings) == 1 and 'do not follow the voxels' in warnings[0]


def test_broken_first_models_are_no_reason_to_stop(model, warnings):
  (model / 'models/model_normalized_16.h5').write_text('?')
  assert len(source.list_models('chair', str(model.parent.parent))) == 1
  assert warnings == []
