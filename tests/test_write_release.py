"""A data set written in the released layout, and read back from it."""

import os
from concurrent.futures import ThreadPoolExecutor

import h5py
import numpy as np
import pytest
import synthetic
from absl import flags
from PIL import Image

from cvn import camera, data, dataset
from cvn.errors import UserError
from cvn.grid import GRID_SIZE
from datagen import generate, release
from datagen import write_release as program
from datagen.pipeline import make_record
from datagen.sources import procedural

AZIMUTHS = (0, 90, 330)


@pytest.fixture(scope='module')
def made(tmp_path_factory):
  """Two categories; a model of the second was never made."""
  return synthetic.make_dataset(
    tmp_path_factory.mktemp('made') / 'data',
    6,
    splits=('train', 'test'),
    categories=('chair', 'human'),
    azimuths=AZIMUTHS,
    image_size=32,
    grid_size=16,
    missing=(3,),
  )


def run(module, *arguments, **named):
  f = flags.FlagValues()
  module.define_flags(f)
  f(['program', *arguments, *(f'--{k}={v}' for k, v in named.items())])
  return module.run(f)


def files(folder):
  return sorted(
    os.path.relpath(os.path.join(parent, name), folder)
    for parent, _, names in os.walk(folder)
    for name in names
  )


def test_everything_has_its_place(made, tmp_path, capsys):
  run(program, data=made.root, output=tmp_path)
  assert capsys.readouterr().out == f'{tmp_path}: 5 models; written 5, already there 0\n'
  names, expected = ('0.000', '1.570', '5.757'), ['written_data.json']
  for m in ('m0', 'm2', 'm4'):
    at = f'data/ShapeNetCore_im2avatar/03001627/{m}/'
    expected += [f'{at}views/{n}.png' for n in names]
    expected += [f'{at}models/16_{n}_coor.h5' for n in names]
    expected.append(f'{at}models/model_normalized_16.h5')
  for m in ('m1', 'm5'):
    at = f'data/human_im2avatar/human/{m}/'
    expected += [f'{at}views/{n}.png' for n in names]
    expected += [f'{at}flow/16_{n}_coor.h5' for n in names]
    expected.append(f'{at}{m}.h5')
  lists = {
    'train_list_03001627': 'm0\nm2\nm4\n',
    'val_list_03001627': '',
    'test_list_03001627': '',
    'train_list_human': '',
    'test_list_human': 'human m1\nhuman m5\n',
  }
  assert files(tmp_path) == sorted([*expected, *(f'data_list/{name}.txt' for name in lists)])
  for name, text in lists.items():
    assert (tmp_path / 'data_list' / f'{name}.txt').read_text() == text


def test_values_at_known_places(made, tmp_path):
  run(program, data=made.root, output=tmp_path, category='chair')
  record = dataset.read_record(made, 2)
  folder = tmp_path / 'data/ShapeNetCore_im2avatar/03001627/m2'
  at = tuple(record.surface_index.T)
  with h5py.File(folder / 'models/model_normalized_16.h5') as file:
    volume = file['data'][()]
  assert volume.shape == (16, 16, 16, 3)
  np.testing.assert_array_equal(volume[at], np.float32(record.surface_color / 255))
  with h5py.File(folder / 'models/16_1.570_coor.h5') as file:
    flow = file['data'][()]
  np.testing.assert_array_equal(flow[at], record.flow[1])
  for values in (volume, flow):
    assert (values > -0.5).any(-1).sum() == len(record.surface_index)
    values[at] = -1
    assert (values == -1).all()
  with Image.open(folder / 'views/1.570.png') as image:
    rgb = np.asarray(image)
  np.testing.assert_allclose(rgb / 255, data.composite(record.views[1]), atol=1e-6)


def test_only_what_is_missing_is_written(made, tmp_path, capsys):
  run(program, data=made.root, output=tmp_path, split='train')
  folder = tmp_path / 'data/ShapeNetCore_im2avatar/03001627'
  before = {p: (folder / p).stat().st_mtime_ns for p in files(folder)}
  content = (folder / 'm2/models/16_1.570_coor.h5').read_bytes()
  (folder / 'm2/models/16_1.570_coor.h5').unlink()
  capsys.readouterr()
  run(program, data=made.root, output=tmp_path, split='train')
  assert 'written 1, already there 2' in capsys.readouterr().out
  assert (folder / 'm2/models/16_1.570_coor.h5').read_bytes() == content
  after = {p: (folder / p).stat().st_mtime_ns for p in files(folder)}
  assert {p for p in before if after[p] != before[p]} == {'m2/models/16_1.570_coor.h5'}


def test_bad_input_is_named(made, tmp_path):
  with pytest.raises(UserError, match='no data set'):
    run(program, data=tmp_path, output=tmp_path / 'out')
  with pytest.raises(UserError, match='no finished model of this split and category'):
    run(program, data=made.root, output=tmp_path / 'out', split='val')
  with pytest.raises(UserError, match='no finished model of this split and category'):
    run(program, data=made.root, output=tmp_path / 'out', category='car')
  assert os.listdir(tmp_path) == []
  (tmp_path / 'file').write_text('')
  with pytest.raises(UserError, match='cannot write'):
    run(program, data=made.root, output=tmp_path / 'file')


def test_a_folder_of_another_data_set_is_left_alone(made, tmp_path):
  run(program, data=made.root, output=tmp_path, split='train')
  other = synthetic.make_dataset(
    tmp_path / 'other', 1, splits=('train',), azimuths=(0,), image_size=32, grid_size=16
  )
  before = files(tmp_path)
  with pytest.raises(UserError, match='something else'):
    run(program, data=other.root, output=tmp_path)
  assert files(tmp_path) == before


def test_round_trip_through_the_generator(tmp_path, monkeypatch, capsys):
  """What is made of a mesh, written and read back is the same, as far as the layout holds it."""
  first, _ = make_record(procedural.load(procedural.list_models('guitar', None, 1, 0)[0]))
  planned = tuple(
    dataset.Model(id, category, split, 'procedural')
    for id, category, split in (('g1', 'guitar', 'val'), ('clothes1_mesh2', 'human', 'test'))
  )
  ours = dataset.create(
    str(tmp_path / 'ours'),
    dataset.Manifest(planned, camera.AZIMUTHS, camera.IMAGE_SIZE, GRID_SIZE, 8192, {}),
  )
  for row in range(2):
    dataset.write_record(ours.arrays, row, first)
  first = dataset.read_record(ours, 0)
  written, again = tmp_path / 'written', tmp_path / 'again'
  run(program, data=ours.root, output=written)
  monkeypatch.setattr(generate, 'process_executor', lambda n, memory: ThreadPoolExecutor(n))
  for m, collection in zip(planned, release.COLLECTIONS, strict=True):
    run(
      generate,
      '--append',
      source='im2avatar_release',
      category=m.category,
      input=written / 'data' / collection,
      splits=written / 'data_list',
      output=again,
    )
    assert 'no voxel is marked as visible; ' in capsys.readouterr().out
  read = dataset.open_dataset(str(again))
  for row, m in enumerate(read.manifest.models):
    assert m[:4] == (*planned[row][:3], 'im2avatar_release')
    second = dataset.read_record(read, row)
    np.testing.assert_array_equal(first.surface_index, second.surface_index)
    np.testing.assert_array_equal(first.surface_color, second.surface_color)
    np.testing.assert_array_equal(first.flow, second.flow)  # to the bit: u16 fits into float32
    np.testing.assert_array_equal(first.views[..., 3], second.views[..., 3])
    np.testing.assert_array_equal(data.composite(first.views), data.composite(second.views))
    assert not second.visible.any()
  assert row == 1 and first.visible.any()
