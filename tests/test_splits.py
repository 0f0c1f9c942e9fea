import collections

import pytest

from cvn.errors import UserError
from datagen.splits import ranked_splits, read_splits, split_of, write_splits


def test_fractions():
  counts = collections.Counter(split_of(f'chair-0-{i:05d}') for i in range(10000))
  # Three standard deviations of a binomial count are at most 137.
  assert abs(counts['train'] - 7000) < 140
  assert abs(counts['val'] - 1000) < 90
  assert abs(counts['test'] - 2000) < 120


def test_a_split_never_changes():
  # SHA-256 of '0' begins 5feceb66 (0.374), of 'b' 3e23e816 (0.243), of '5' ef2d127d (0.934), of
  # 'd' 18ac3e73 (0.096); of '3' 4e074085 (0.305); of 'a' ca978112 (0.791).
  assert [split_of(i) for i in '0b53d'] == ['train', 'train', 'test', 'train', 'train']
  assert split_of('a') == 'val'


def test_other_fractions():
  assert split_of('5', (1, 0, 0)) == 'train'
  assert split_of('0', (0, 0, 1)) == 'test'
  assert split_of('0', (0.1, 0.9, 0)) == 'val'


def test_lists_as_the_authors_write_them(tmp_path):
  (tmp_path / 'train_list_03001627.txt').write_text('abc\ndef\n\n')
  (tmp_path / 'test_list_03001627.txt').write_text('ghi')
  assert read_splits(str(tmp_path), '03001627') == {'abc': 'train', 'def': 'train', 'ghi': 'test'}


def test_people_have_ids_of_two_words(tmp_path):
  (tmp_path / 'train_list_human.txt').write_text('clothes5 mesh29_new\nclothes9 mesh33_new \n')
  assert set(read_splits(str(tmp_path), 'human')) == {'clothes5_mesh29_new', 'clothes9_mesh33_new'}


def test_no_list(tmp_path):
  with pytest.raises(UserError, match='list_chair'):
    read_splits(str(tmp_path), 'chair')


def test_a_list_that_is_no_text(tmp_path):
  (tmp_path / 'train_list_chair.txt').write_bytes(b'\xff\xfe\x00')
  with pytest.raises(UserError, match='train_list_chair'):
    read_splits(str(tmp_path), 'chair')


def test_an_id_in_two_lists(tmp_path):
  (tmp_path / 'train_list_chair.txt').write_text('abc')
  (tmp_path / 'val_list_chair.txt').write_text('abc')
  with pytest.raises(UserError, match='abc'):
    read_splits(str(tmp_path), 'chair')


def test_ranked_splits_give_each_split_its_share_and_keep_families_together():
  families = {f'm{n}': f'family{n // 2}' for n in range(40)}
  splits = ranked_splits(families)
  counts = collections.Counter(splits.values())
  assert counts == {'train': 28, 'val': 4, 'test': 8}
  assert all(splits[f'm{n}'] == splits[f'm{n + 1}'] for n in range(0, 40, 2))
  assert ranked_splits(dict(reversed(families.items()))) == splits


@pytest.mark.parametrize(
  ('models', 'counts'),
  [
    (1, {'test': 1}),
    (2, {'test': 1, 'val': 1}),
    (13, {'test': 3, 'val': 2, 'train': 8}),
  ],
)
def test_small_collections_are_for_testing_first(models, counts):
  splits = ranked_splits({str(n): str(n) for n in range(models)})
  assert collections.Counter(splits.values()) == counts


def test_lists_that_are_written_are_read(tmp_path):
  splits = {'a': 'train', 'b': 'test', 'c': 'train'}
  write_splits(str(tmp_path / 'lists'), 'chair', splits)
  assert read_splits(str(tmp_path / 'lists'), 'chair') == splits
