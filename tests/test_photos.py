"""Names of pictures, masks and results."""

import numpy as np
import pytest
from PIL import Image

from cvn.errors import UserError
from cvn.photo import Photo
from experiments.lib import photos


def test_names_of_pictures(tmp_path, monkeypatch):
  monkeypatch.chdir(tmp_path)
  (tmp_path / 'a,b.png').touch()
  assert photos.split_names(['a,b.png', 'c.png, d.png,', 'c.png']) == ['a,b.png', 'c.png', 'd.png']


def test_folders_give_their_pictures_by_name(tmp_path):
  for name in ('b.JPG', 'a.png', 'notes.txt', 'c.heic'):
    (tmp_path / name).touch()
  (tmp_path / 'empty').mkdir()
  other = str(tmp_path / 'notes.txt')
  found = photos.expand_folders([str(tmp_path), other, str(tmp_path / 'a.png')])
  assert found == [*(str(tmp_path / n) for n in ('a.png', 'b.JPG', 'c.heic')), other]
  with pytest.raises(UserError, match='holds no image'):
    photos.expand_folders([str(tmp_path / 'empty')])


def test_one_mask_a_picture_or_none():
  assert photos.assign_masks(['a', 'b'], []) == {'a': None, 'b': None}
  assert photos.assign_masks(['a', 'b'], ['x', 'y']) == {'a': 'x', 'b': 'y'}
  with pytest.raises(UserError, match='1 files for 2 images'):
    photos.assign_masks(['a', 'b'], ['x'])


def test_results_have_different_names():
  paths = ['x/a.png', 'y/a.jpg', 'a_2.png', 'z/a.png', 'a_mask.png', 'b_mask.png', 'b.png']
  names = photos.output_names(paths)
  assert names['x/a.png'] == 'a'
  files = [f'{n}{end}.png' for n in names.values() for end in ('', '_mask')]
  assert len(set(files)) == 2 * len(paths)


def test_masks_are_written_as_they_are(tmp_path):
  mask = np.random.default_rng(0).integers(0, 256, (5, 7), np.uint8)
  photos.write_mask(str(tmp_path / 'new' / 'm.png'), Photo(None, mask, 'mask', ()))
  with Image.open(tmp_path / 'new' / 'm.png') as image:
    np.testing.assert_array_equal(np.asarray(image), mask)


def test_categories_that_all_networks_know():
  a, b = {'categories': ['car', 'chair']}, {'categories': ['chair', 'table']}
  assert photos.known_categories(a, b) == ['chair']
  assert photos.known_categories({'category': ['car']}) == ['car']
  assert photos.known_categories({'category': []}, a) == []
