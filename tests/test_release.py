"""Names, arrays and pictures of the authors' released folders."""

import io
import sys

import h5py
import numpy as np
import pytest
from PIL import Image

from cvn.camera import AZIMUTHS
from cvn.errors import UserError
from datagen import release


def test_views_are_called_as_in_the_release():
  names = [release.view_name(a) for a in AZIMUTHS]
  assert (names[0], names[1], names[3], names[-1]) == ('0.000', '0.523', '1.570', '5.757')
  assert names == sorted(names)  # the authors' programs pair views with predictions by sorting
  back = [release.view_azimuth(name) for name in names]
  np.testing.assert_allclose(back, AZIMUTHS, atol=0.03)


def test_places_of_shapenet():
  folder = release.model_folder('chair', '1a2b')
  assert (release.collection('chair'), folder) == ('ShapeNetCore_im2avatar', '03001627/1a2b')
  assert release.model_folder('boat', 'x') == 'boat/x'
  assert release.volume_path('chair', folder, 64) == 'models/model_normalized_64.h5'
  assert release.flow_path('chair', '0.523', 64) == 'models/64_0.523_coor.h5'
  assert release.view_path('0.523') == 'views/0.523.png'


def test_places_of_people():
  folder = release.model_folder('human', 'clothes9_mesh8_new')
  assert (release.collection('human'), folder) == ('human_im2avatar', 'clothes9/mesh8_new')
  assert release.model_folder('human', 'human-0-00001') == 'human/human-0-00001'
  assert release.volume_path('human', folder, 64) == 'mesh8_new.h5'
  assert release.flow_path('human', '0.523', 64) == 'flow/64_0.523_coor.h5'


@pytest.mark.parametrize(
  'category, model_id', [('chair', '..'), ('../x', 'a'), ('chair', 'a/b'), ('human', '.._x')]
)
def test_names_that_lead_elsewhere_are_refused(category, model_id):
  with pytest.raises(UserError, match='cannot be the name of a folder'):
    release.model_folder(category, model_id)


def test_arrays_come_back_and_are_what_the_authors_write(tmp_path):
  array = np.linspace(-1, 1, 4 * 4 * 4 * 3, dtype=np.float32).reshape(4, 4, 4, 3)
  path = tmp_path / 'new' / 'a.h5'
  release.write_array(str(path), array)
  with h5py.File(path) as file:
    assert list(file) == ['data']
    assert (file['data'].dtype, file['data'].compression) == (np.float32, 'gzip')
  np.testing.assert_array_equal(release.read_array(path.read_bytes(), 'a', array.shape), array)
  release.write_array(str(tmp_path / 'b.h5'), array)
  assert (tmp_path / 'b.h5').read_bytes() == path.read_bytes()


def file_with(**datasets):
  content = io.BytesIO()
  with h5py.File(content, 'w') as file:
    for name, value in datasets.items():
      file[name] = value
  return content.getvalue()


@pytest.mark.parametrize(
  'content, message',
  [
    (b'', 'a.h5 cannot be read as HDF5'),
    (b'\x89HDF\r\n\x1a\nand nothing more', 'a.h5 cannot be read as HDF5'),
    (file_with(data=np.zeros((2, 2)))[:-200], 'a.h5 cannot be read as HDF5'),
    (file_with(other=np.zeros((2, 2))), 'a.h5 has no dataset `data`'),
    (file_with(data=h5py.ExternalLink('/etc/hostname', 'data')), 'a.h5 has no dataset `data`'),
    (file_with(data=h5py.SoftLink('/nowhere')), 'a.h5 has no dataset `data`'),
    (file_with(data=np.zeros((2, 3))), r'`data` is float64 \(2, 3\), not numbers \(2, 2\)'),
    (file_with(data='two'), 'not numbers'),
    (file_with(data=np.zeros((2, 2), complex)), 'not numbers'),
  ],
)
def test_files_without_the_array(content, message):
  with pytest.raises(UserError, match=message) as e:
    release.read_array(content, 'a.h5', (2, 2))
  assert '\n' not in str(e.value)


def test_a_group_or_data_elsewhere_is_no_array(tmp_path):
  secret = tmp_path / 'secret'
  secret.write_bytes(bytes(32))
  for make in (
    lambda f: f.create_group('data'),
    lambda f: f.create_dataset('data', (2, 2), float, external=[(str(secret), 0, 32)]),
  ):
    content = io.BytesIO()
    with h5py.File(content, 'w') as file:
      make(file)
    with pytest.raises(UserError, match='no dataset `data` of its own'):
      release.read_array(content.getvalue(), 'a.h5', (2, 2))


def test_a_declared_size_is_not_believed():
  content = io.BytesIO()
  with h5py.File(content, 'w') as file:
    file.create_dataset('data', (1 << 20,) * 3, np.float32, chunks=(1, 1, 1024))
  with pytest.raises(UserError, match='not numbers'):
    release.read_array(content.getvalue(), 'a.h5', (64, 64, 64, 3))


def test_broken_bytes_end_in_a_line():
  rng = np.random.default_rng(0)
  whole = file_with(data=np.zeros((2, 2)))
  refused = 0
  for _ in range(100):
    content = np.frombuffer(whole, np.uint8).copy()
    content[rng.integers(0, 1200, 5)] = rng.integers(0, 256, 5)
    try:
      release.read_array(content.tobytes(), 'a.h5', (2, 2))
    except UserError as e:
      assert str(e).startswith('a.h5') and '\n' not in str(e)
      refused += 1
  assert 10 < refused < 100


def test_without_h5py(monkeypatch):
  monkeypatch.setitem(sys.modules, 'h5py', None)
  with pytest.raises(UserError, match='pip install'):
    release.h5py()


def picture(pixels, mode=None, format='PNG'):
  content = io.BytesIO()
  Image.fromarray(np.asarray(pixels, np.uint8)).convert(mode or 'RGB').save(content, format)
  return content.getvalue()


def test_alpha_is_what_differs_from_the_top_left_pixels_red():
  pixels = np.full((2, 2, 3), 245)
  pixels[0, 1], pixels[1, 0] = (255, 255, 255), (245, 245, 246)
  rgba = release.read_view(picture(pixels), 'a.png', 2)
  assert rgba[..., 3].tolist() == [[0, 255], [255, 0]]
  np.testing.assert_array_equal(rgba[..., :3], pixels)
  pixels[0, 0] = (9, 8, 7)  # an object in the corner: nothing is ground but its red's grey
  pixels[1, 1] = (9, 9, 9)
  assert release.read_view(picture(pixels), 'a.png', 2)[..., 3].tolist() == [[255, 255], [255, 0]]


@pytest.mark.parametrize(
  'content, message',
  [
    (b'no picture', 'a.png cannot be read as PNG'),
    (picture(np.zeros((2, 2, 3)))[:-30], 'a.png cannot be read as PNG'),
    (picture(np.zeros((2, 2, 3)), format='JPEG'), 'a.png cannot be read as PNG'),
    (picture(np.zeros((3, 2, 3))), 'a.png has 2 x 3 pixels, not 2 x 2'),
    (picture(np.full((2, 2, 3), 245)), 'a.png shows only its background'),
  ],
)
def test_pictures_that_are_no_views(content, message):
  with pytest.raises(UserError, match=message):
    release.read_view(content, 'a.png', 2)


def test_views_are_written_on_grey_with_hard_edges(tmp_path):
  rgba = np.zeros((2, 3, 4), np.uint8)
  rgba[0, 1] = (10, 20, 30, 255)
  rgba[0, 2] = (245, 245, 245, 255)  # the object's own grey
  rgba[1, 0] = (10, 20, 30, 127)
  rgba[1, 1] = (0, 100, 200, 204)
  release.write_view(str(tmp_path / 'a.png'), rgba)
  with Image.open(tmp_path / 'a.png') as image:
    assert image.mode == 'RGB'
    got = np.asarray(image)
  ground, mixed = [245] * 3, [49, 129, 209]
  assert got.tolist() == [[ground, [10, 20, 30], [244] * 3], [ground, mixed, ground]]


def test_a_folder_is_claimed_once(tmp_path):
  folder = str(tmp_path / 'new')
  release.claim(folder, 'from.json', {'data': 'a', 'step': 1})
  release.claim(folder, 'from.json', {'step': 1, 'data': 'a'})
  with pytest.raises(UserError, match='something else'):
    release.claim(folder, 'from.json', {'data': 'a', 'step': 2})
