"""The pipeline: what an element is, what an epoch is, and that nothing depends on threads."""

import itertools
import os

import jax
import numpy as np
import pytest
import synthetic

from cvn import data, dataset, grid
from cvn.errors import UserError

VIEWS = 3


@pytest.fixture(scope='module')
def made(tmp_path_factory):
  return synthetic.make_dataset(
    tmp_path_factory.mktemp('data') / 'set',
    10,
    splits=('train', 'train', 'train', 'val', 'train'),
    categories=('ball', 'egg'),
    azimuths=(0, 120, 240),
    image_size=16,
    grid_size=16,
    capacity=1024,
    missing=(4,),
  )


def train_rows(made):
  return data.select_rows(made, 'train')


def batches(made, read=data.read_color, *, batch_size=2, seed=0, **kwargs):
  return data.training_batches(
    read, made, train_rows(made), batch_size=batch_size, seed=seed, **kwargs
  )


def images(epoch):
  """Which (row, view) an image shows is told by the image: here, its bytes."""
  return [image.tobytes() for batch in epoch for image in batch.image]


def known_images(made):
  """bytes -> (row, view) of all images of the data set."""
  counts = dataset.surface_counts(made)
  return {
    dataset.read_record(made, row).views[view].tobytes(): (row, view)
    for row in range(len(counts))
    if counts[row]
    for view in range(VIEWS)
  }


def test_rows_are_finished_models_of_the_split(made):
  np.testing.assert_array_equal(data.select_rows(made, 'train'), [0, 1, 2, 5, 6, 7, 9])
  np.testing.assert_array_equal(data.select_rows(made, 'val'), [3, 8])
  assert data.select_rows(made, 'test').shape == (0,)


def test_rows_of_categories(made):
  np.testing.assert_array_equal(data.select_rows(made, 'train', categories=['ball']), [0, 2, 6])
  np.testing.assert_array_equal(data.select_rows(made, 'val', categories=['ball', 'egg']), [3, 8])


def test_unknown_split_or_category(made):
  with pytest.raises(UserError, match="'dev' is no split; there are train, val, test"):
    data.select_rows(made, 'dev')
  with pytest.raises(UserError, match="no category 'cube'; it has ball, egg"):
    data.select_rows(made, 'train', categories=['cube'])


def test_slots_are_the_most_voxels_rounded_up(made):
  most, slots = dataset.surface_counts(made).max(), data.max_voxels(made)
  assert slots % 256 == 0 and slots - 256 < most <= slots


def test_slots_never_exceed_what_is_stored(tmp_path):
  tiny = synthetic.make_dataset(
    tmp_path / 'set', 1, azimuths=(0,), image_size=16, grid_size=8, capacity=200
  )
  assert data.max_voxels(tiny) == 200


def test_no_finished_model(tmp_path):
  empty = synthetic.make_dataset(tmp_path / 'set', 1, image_size=16, missing=(0,))
  with pytest.raises(UserError, match='no finished model'):
    data.max_voxels(empty)


def test_composite():
  rgba = np.array([[255, 0, 51, 255], [9, 9, 9, 0], [255, 0, 0, 51]], np.uint8)
  got = data.composite(rgba, background=0.5)
  assert got.dtype == np.float32
  np.testing.assert_allclose(got, [[1, 0, 0.2], [0.5, 0.5, 0.5], [0.6, 0.4, 0.4]], atol=1e-6)


def test_default_background_is_the_authors_grey(made):
  element = data.decode(data.read_shape(made, 0, 0, max_voxels=data.max_voxels(made)))
  np.testing.assert_allclose(element.image[0, 0] * 255, [245] * 3, rtol=1e-6)


def test_decoding_in_a_compiled_program_is_decoding_on_the_host(made):
  for read in (data.read_color, data.read_shape):
    stored = batches(made, read)[0]
    here, there = data.decode(stored), jax.jit(data.decode)(stored)
    assert type(here) is type(there) is type(stored)
    for a, b in zip(here, there, strict=True):
      assert a.dtype == b.dtype
      np.testing.assert_allclose(a, b, rtol=1e-6)


def test_what_is_decoded_stays_as_it_is(made):
  decoded = data.decode(batches(made)[0])
  assert data.decode(decoded) is decoded


def test_element_is_the_record(made):
  record, slots = dataset.read_record(made, 5), data.max_voxels(made)
  count = len(record.surface_index)
  got = data.decode(data.read_color(made, 5, 2, max_voxels=slots))
  np.testing.assert_array_equal(got.image, data.composite(record.views[2]))
  np.testing.assert_array_equal(got.index[:count], record.surface_index)
  assert (got.index[count:] == grid.PADDING_INDEX).all()
  np.testing.assert_array_equal(got.color[:count], record.surface_color.astype(np.float32) / 255)
  np.testing.assert_array_equal(got.flow[:count], record.flow[2])
  assert not got.color[count:].any() and not got.flow[count:].any()


def test_elements_are_painted_at_random_and_the_same_each_time(made):
  plain, painted, again = (batches(made, recolor=r) for r in (False, True, True))
  changed = [
    not np.array_equal(a, b)
    for n in range(20)
    for a, b in zip(plain[n].image, painted[n].image, strict=True)
  ]
  assert np.mean(changed) > 0.5
  np.testing.assert_array_equal(painted[7].image, again[7].image)


def test_half_of_the_elements_are_mirrored(made):
  plain, both = batches(made), batches(made, mirror=True)
  flipped = []
  for n in range(60):
    for a, b in zip(plain[n].image, both[n].image, strict=True):
      flipped.append(not np.array_equal(a, b))
      np.testing.assert_array_equal(b, a[:, ::-1] if flipped[-1] else a)
  assert 0.3 < np.mean(flipped) < 0.7


def test_shape_element_is_the_color_element_without_its_colors(made):
  slots = data.max_voxels(made)
  shape, color = (f(made, 5, 2, max_voxels=slots) for f in (data.read_shape, data.read_color))
  np.testing.assert_array_equal(shape.image, color.image)
  np.testing.assert_array_equal(shape.index, color.index)


def test_batch_shapes_and_types(made):
  s = data.max_voxels(made)
  batch = batches(made)[0]
  assert [(x.shape, x.dtype.name) for x in batch] == [
    ((2, 16, 16, 4), 'uint8'),
    ((2, s, 3), 'uint8'),
    ((2, s, 3), 'uint8'),
    ((2, s, 2), 'uint16'),
  ]
  assert [(x.shape, x.dtype.name) for x in data.decode(batch)] == [
    ((2, 16, 16, 3), 'float32'),
    ((2, s, 3), 'int32'),
    ((2, s, 3), 'float32'),
    ((2, s, 2), 'float32'),
  ]
  assert isinstance(batch, data.Batch)
  assert isinstance(batches(made, data.read_shape)[0], data.ShapeBatch)


def test_reading_touches_one_view_only(tmp_path):
  """With the other views' chunks spoiled on the disk, this one still reads; and they do not."""
  tiny = {'azimuths': (0, 120, 240), 'image_size': 16, 'grid_size': 16, 'capacity': 1024}
  made = synthetic.make_dataset(tmp_path / 'set', 1, **tiny)
  slots, expected = data.max_voxels(made), data.read_color(made, 0, 1, max_voxels=1024)
  for name in ('views', 'flow', 'visible'):
    (shard,) = (p for p in (tmp_path / 'set' / name / 'c').rglob('*') if p.is_file())
    content = bytearray(shard.read_bytes())
    # A shard ends in (offset, length) of its chunks and a checksum of these.
    index = np.frombuffer(content[-4 - 3 * 16 : -4], '<u8').reshape(3, 2)
    for offset, length in index[[0, 2]].astype(int):
      content[offset : offset + length] = bytes(length)
    shard.write_bytes(content)
  got = data.read_color(made, 0, 1, max_voxels=slots)
  np.testing.assert_array_equal(got.image, expected.image)
  np.testing.assert_array_equal(got.flow, expected.flow[:slots])
  for view in (0, 2):
    with pytest.raises(UserError):
      data.read_color(made, 0, view, max_voxels=slots)


def test_damaged_files_name_the_model(tmp_path):
  made = synthetic.make_dataset(
    tmp_path / 'set', 1, azimuths=(0,), image_size=16, grid_size=16, capacity=1024
  )
  for folder, _, names in os.walk(tmp_path / 'set' / 'views' / 'c'):
    for name in names:
      with open(os.path.join(folder, name), 'wb') as f:
        f.write(b'not zstd')
  with pytest.raises(UserError, match='files of model m0 are damaged'):
    data.read_shape(made, 0, 0, max_voxels=256)
  with pytest.raises(UserError, match='files of model m0 are damaged'):
    next(data.iterate(data.training_batches(data.read_shape, made, [0], batch_size=1, seed=0)))


def test_an_epoch_shows_every_model_once(made):
  epochs = batches(made, batch_size=1)
  known = known_images(made)
  for epoch in range(3):
    shown = [known[b] for b in images(epochs[7 * epoch + i] for i in range(7))]
    assert sorted(row for row, _ in shown) == train_rows(made).tolist()


def test_views_and_order_are_drawn_anew_each_epoch(made):
  known = known_images(made)
  epochs = batches(made, batch_size=1)
  shown = [
    [known[b] for b in images(epochs[7 * epoch + i] for i in range(7))] for epoch in range(40)
  ]
  orders = {tuple(row for row, _ in epoch) for epoch in shown}
  assert len(orders) > 35
  per_view = np.bincount([view for epoch in shown for _, view in epoch], minlength=VIEWS)
  # 280 draws of three views: mean 93.3, standard deviation 7.9.
  assert (np.abs(per_view - 280 / VIEWS) < 5 * 7.9).all()


def test_models_beyond_the_last_full_batch_wait_for_another_epoch(made):
  assert len(batches(made, batch_size=3)) == 2
  assert len(batches(made, batch_size=7)) == 1


def test_seed_decides(made):
  first = images(batches(made)[i] for i in range(6))
  assert images(batches(made)[i] for i in range(6)) == first
  assert images(batches(made, seed=1)[i] for i in range(6)) != first


def test_iterating_is_indexing(made):
  mapped = batches(made)
  got = images(itertools.islice(data.iterate(mapped), 8))
  assert got == images(mapped[i] for i in range(8))


def test_epochs_end(made):
  mapped = batches(made)
  assert len(list(data.iterate(mapped, num_epochs=2))) == 2 * len(mapped) == 6


@pytest.mark.parametrize('consumed', [0, 1, 5])
def test_restored_iterator_continues_exactly(made, consumed):
  first = data.iterate(batches(made))
  for _ in range(consumed):
    next(first)
  state = first.get_state()
  expected = images(itertools.islice(first, 4))
  second = data.iterate(batches(made))
  second.set_state(state)
  assert images(itertools.islice(second, 4)) == expected


@pytest.mark.parametrize('processes', [2, 3])
def test_the_parts_of_all_processes_are_the_batch_of_one(made, processes):
  """In every epoch, and with the models left over that one process leaves out."""

  def named(**options):
    rows, options = data.select_rows(made, 'train'), {'batch_size': 6, 'seed': 3, **options}
    return data.training_batches(data.read_name, made, rows, **options)

  whole, parts = named(), [named(shard=(n, processes)) for n in range(processes)]
  assert {len(p) for p in parts} == {len(whole)}
  for n in range(3):
    mine = [set(map(str, p[n])) for p in parts]
    assert set().union(*mine) == set(map(str, whole[n]))
    assert [len(m) for m in mine] == [6 // processes] * processes


def test_too_few_models_for_a_batch(made):
  with pytest.raises(UserError, match='7 finished training models, too few for a batch of 60'):
    batches(made, batch_size=60)


def test_evaluation_pairs():
  np.testing.assert_array_equal(
    data.evaluation_pairs([4, 7], 3), [[4, 0], [4, 1], [4, 2], [7, 0], [7, 1], [7, 2]]
  )
  some = data.evaluation_pairs(np.arange(20), 12, limit=20)
  assert len(some) == 20
  assert len(np.unique(some[:, 0])) == 20  # every model once
  assert len(np.unique(some[:, 1])) == 12  # from all sides
  assert data.evaluation_pairs([4, 7], 3, limit=99).shape == (6, 2)
  assert data.evaluation_pairs([], 12).shape == (0, 2)


def test_evaluation_goes_through_the_pairs_in_order(made):
  pairs = data.evaluation_pairs(data.select_rows(made, 'val'), VIEWS)
  got = list(
    data.iterate(data.evaluation_batches(data.read_color, made, pairs, batch_size=4), num_epochs=1)
  )
  assert [len(b.image) for b in got] == [4, 2]
  known = known_images(made)
  assert [known[b] for b in images(got)] == [tuple(p) for p in pairs]
