"""`python -m datagen.inspect` on a data set with a broken model and a model of one colour."""

import numpy as np
import pytest
import synthetic
from absl import flags
from PIL import Image

from cvn import dataset as dataset_lib
from cvn.dataset import Facts
from cvn.errors import UserError
from datagen import inspect
from datagen.reading import notes
from datagen.reading.notes import to_bits


@pytest.fixture(scope='module')
def data(tmp_path_factory):
  path = tmp_path_factory.mktemp('inspect') / 'data'
  made = synthetic.make_dataset(
    path, 8, image_size=32, grid_size=32, categories=('ball', 'egg'), missing=(7,)
  )
  red = dataset_lib.read_record(made, 2)
  red.surface_color[:] = (200, 0, 0)
  red = red._replace(facts=Facts(notes=to_bits([notes.POSE, notes.NO_COORDINATES])))
  dataset_lib.write_record(made.arrays, 2, red)
  other = dataset_lib.read_record(made, 3)
  dataset_lib.write_record(made.arrays, 3, other._replace(facts=Facts(notes=to_bits([notes.POSE]))))
  dataset_lib.write_json(made.root, 'failures.json', {'m7': 'm7.obj: the mesh has no faces'})
  return path


def inspected(*arguments):
  f = flags.FlagValues()
  inspect.define_flags(f)
  f(['inspect', *arguments])
  inspect.run(f)


def test_a_whole_data_set(data, tmp_path, capsys):
  inspected(f'--data={data}', f'--sheet={tmp_path / "sheet.png"}')
  out = capsys.readouterr().out
  assert '7 of 8 models are made' in out
  lines = {line.split()[0]: line.split() for line in out.splitlines() if line.strip()}
  assert lines['ball'][1:6] == ['4', '4', '3', '1', '0']
  assert lines['egg'][1:6] == ['4', '3', '2', '0', '1']
  assert '        7  not stated' in out
  assert '1 failed\n        1  m7.obj: the mesh has no faces' in out
  assert '1 suspicious\n  m2: a single colour\n' in out
  assert f'        2  {notes.POSE}: m2, m3\n' in out
  assert f'        1  {notes.NO_COORDINATES}: m2\n' in out
  with Image.open(tmp_path / 'sheet.png') as sheet:
    assert sheet.height > 7 * 128


def test_records_that_do_not_tell_what_is_visible(tmp_path, capsys):
  made = synthetic.make_dataset(
    tmp_path / 'data', 2, image_size=32, grid_size=32, categories=('ball', 'egg')
  )
  inspected(f'--data={tmp_path / "data"}', '--id=m1', '--sheet=')
  own = capsys.readouterr().out.split('colour')[1].split('),')[0].strip()
  record = dataset_lib.read_record(made, 0)
  unseen = record._replace(visible=np.zeros_like(record.visible))
  dataset_lib.write_record(made.arrays, 0, unseen)
  inspected(f'--data={tmp_path / "data"}', '--sheet=')
  out = capsys.readouterr().out
  lines = {line.split()[0]: line.split() for line in out.splitlines() if line.strip()}
  assert (len(lines['ball']), len(lines['egg'])) == (6, 9)
  assert own in out  # of visible voxels, only those of the other model count
  inspected(f'--data={tmp_path / "data"}', '--id=m0', '--sheet=')
  assert 'none is marked as visible' in capsys.readouterr().out


def test_one_model(data, tmp_path, capsys):
  inspected(f'--data={data}', '--id=m2', '--sheet=')
  out = capsys.readouterr().out
  assert 'category   ball' in out
  assert 'suspicious a single colour' in out
  assert f'note       {notes.POSE}' in out
  assert 'look at' not in out


@pytest.mark.parametrize(
  'model, message', [('nobody', 'has no model nobody'), ('m7', 'm7 is not made yet')]
)
def test_a_model_that_is_not_there(data, model, message):
  with pytest.raises(UserError, match=message):
    inspected(f'--data={data}', f'--id={model}', '--sheet=')


def test_nothing_is_made(tmp_path):
  synthetic.make_dataset(tmp_path / 'empty', 1, missing=(0,))
  with pytest.raises(UserError, match='no finished model'):
    inspected(f'--data={tmp_path / "empty"}')


def test_no_data_set(tmp_path):
  with pytest.raises(UserError, match='is no data set'):
    inspected(f'--data={tmp_path}')
