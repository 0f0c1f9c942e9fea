"""Records come back as they were written, and damage is told in one line."""

import json
import os
import pathlib

import numpy as np
import pytest
import synthetic

from cvn import camera, dataset, grid
from cvn.errors import UserError

TINY = {'azimuths': (0, 90), 'image_size': 16, 'grid_size': 16, 'capacity': 1024}


@pytest.fixture
def made(tmp_path):
  return synthetic.make_dataset(tmp_path / 'data', 3, missing=(1,), **TINY)


def tiny_record(seed):
  return synthetic.make_record(seed, azimuths=(0, 90), image_size=16, grid_size=16)


def test_record_round_trip(made):
  expected = tiny_record(2)
  got = dataset.read_record(dataset.open_dataset(made.root), 2)
  for name in ('views', 'surface_index', 'surface_color', 'visible'):
    np.testing.assert_array_equal(getattr(got, name), getattr(expected, name))
  assert got.visible.dtype == bool
  # Rounding to 65536 levels is off by half a level, 1/1024 of a pixel of 128.
  np.testing.assert_allclose(got.flow, expected.flow, atol=0.5001 / 65535)


def test_manifest_round_trip(made):
  assert dataset.open_dataset(made.root).manifest == made.manifest


def test_past_the_count_is_padding(made):
  count = dataset.surface_counts(made)[0]
  index = made.arrays['surface_index'][0].read().result()
  assert (index[:count] < 16).all()
  assert (index[count:] == grid.PADDING_INDEX).all()
  assert not made.arrays['surface_color'][0, count:].read().result().any()
  assert not made.arrays['visible'][0, :, count:].read().result().any()
  assert not made.arrays['flow'][0, :, count:].read().result().any()


def test_counts_are_zero_where_not_made(made):
  counts = dataset.surface_counts(made)
  assert counts.shape == (3,)
  assert counts[1] == 0
  assert counts[0] == len(tiny_record(0).surface_index)


def test_reading_a_model_that_is_not_made(made):
  with pytest.raises(UserError, match='m1 is not made yet'):
    dataset.read_record(made, 1)


def test_no_two_models_share_a_file(made):
  """Each row's chunks live under its own number, so writers never meet."""
  before = {p: os.path.getmtime(p) for p in all_files(made)}
  dataset.write_record(made.arrays, 1, tiny_record(1))
  after = {p: os.path.getmtime(p) for p in all_files(made)}
  assert all(after[p] == t for p, t in before.items())
  new = [os.path.relpath(p, made.root.removeprefix('file://')) for p in set(after) - set(before)]
  assert new and all(p.split(os.sep)[1:3] == ['c', '1'] for p in new)


def all_files(made):
  root = made.root.removeprefix('file://')
  return [os.path.join(d, f) for d, _, names in os.walk(root) for f in names]


def test_a_view_is_a_chunk(made):
  for name in ('views', 'visible', 'flow'):
    assert made.arrays[name].chunk_layout.read_chunk.shape[:2] == (1, 1)


def test_writing_again_gives_the_same_bytes(made):
  def content():
    return {p: pathlib.Path(p).read_bytes() for p in all_files(made)}

  before = content()
  dataset.write_record(made.arrays, 0, tiny_record(0))
  assert content() == before


def test_record_of_no_voxel_or_too_many(made):
  r = tiny_record(0)
  empty = r._replace(surface_index=r.surface_index[:0], surface_color=r.surface_color[:0])
  with pytest.raises(UserError, match='0 surface voxels; a record holds 1 to 1024'):
    dataset.write_record(made.arrays, 1, empty)
  many = r._replace(surface_index=np.zeros((1025, 3), np.uint8))
  with pytest.raises(UserError, match='1025 surface voxels'):
    dataset.write_record(made.arrays, 1, many)
  assert dataset.surface_counts(made)[1] == 0


def test_flow_code():
  flow = np.array([0, 0.25, 1, -0.1, 1.1])
  np.testing.assert_allclose(
    dataset.decode_flow(dataset.encode_flow(flow)), [0, 0.25, 1, 0, 1], atol=1e-5
  )


def test_capacity_holds_the_shell_of_the_whole_cube():
  assert dataset.SURFACE_CAPACITY > 64**3 - 62**3 == 23816


def test_cameras_are_in_the_manifest_file(made):
  raw = dataset.read_json(made.root, 'manifest.json')
  assert raw['format'] == dataset.FORMAT
  for a, written in zip((0, 90), raw['cameras'], strict=True):
    for name, value in camera.camera_at(a, image_size=16)._asdict().items():
      np.testing.assert_array_equal(written[name], value)


def test_create_refuses_a_place_that_is_taken(made):
  with pytest.raises(UserError, match='already holds a data set'):
    dataset.create(made.root, made.manifest)


def test_create_where_nothing_can_be_written(tmp_path, made):
  (tmp_path / 'file').write_text('')
  with pytest.raises(UserError):
    dataset.create(str(tmp_path / 'file' / 'data'), made.manifest)


def test_open_where_there_is_none(tmp_path):
  with pytest.raises(UserError, match=r'is no data set: it has no manifest\.json'):
    dataset.open_dataset(str(tmp_path))


def edit_manifest(made, change):
  path = os.path.join(made.root.removeprefix('file://'), 'manifest.json')
  with open(path) as f:
    raw = json.load(f)
  change(raw)
  with open(path, 'w') as f:
    json.dump(raw, f)


def test_open_another_format(made):
  edit_manifest(made, lambda raw: raw.update(format=99))
  with pytest.raises(UserError, match='not of format'):
    dataset.open_dataset(made.root)


def test_open_with_a_key_missing(made):
  edit_manifest(made, lambda raw: raw.pop('image_size'))
  with pytest.raises(UserError, match=r'damaged data set: .*image_size'):
    dataset.open_dataset(made.root)


def test_open_with_an_array_missing(made):
  path = os.path.join(made.root.removeprefix('file://'), 'flow', 'zarr.json')
  os.unlink(path)
  with pytest.raises(UserError, match='damaged data set'):
    dataset.open_dataset(made.root)


def test_open_a_manifest_that_is_not_json(tmp_path):
  (tmp_path / 'manifest.json').write_text('{"models": [')
  with pytest.raises(UserError, match='cannot read'):
    dataset.open_dataset(str(tmp_path))


def test_json_files(tmp_path):
  root = str(tmp_path)
  assert dataset.read_json(root, 'failures.json') is None
  dataset.write_json(root, 'failures.json', {'m1': 'no faces'})
  assert dataset.read_json(root, 'failures.json') == {'m1': 'no faces'}


def test_urls(tmp_path, monkeypatch):
  monkeypatch.chdir(tmp_path)
  assert dataset.to_url('a') == dataset.to_url(str(tmp_path / 'a/')) == f'file://{tmp_path}/a/'
  assert dataset.to_url('gs://bucket/a') == 'gs://bucket/a/'


def test_one_file_a_model_and_array(made):
  names = [os.path.relpath(p, made.root.removeprefix('file://')) for p in all_files(made)]
  records = [n for n in names if os.sep + 'c' + os.sep in n]
  assert len(records) == 2 * (len(dataset.ARRAYS) - 1)  # facts of zeros only need no file


def test_extended_data_sets_keep_what_they_hold(made):
  before = dataset.read_record(made, 0)
  more = [dataset.Model('new', 'cube', 'test', 'synthetic')]
  extended = dataset.extend(made, more)
  assert extended.manifest.models == (*made.manifest.models, *more)
  dataset.write_record(dataset.open_arrays(made.root), 3, tiny_record(7))
  again = dataset.open_dataset(made.root)
  assert again.manifest == extended.manifest
  assert (dataset.surface_counts(again) > 0).tolist() == [True, False, True, True]
  np.testing.assert_array_equal(dataset.read_record(again, 0).views, before.views)
  np.testing.assert_array_equal(dataset.read_record(again, 3).views, tiny_record(7).views)


def test_a_data_set_whose_extension_was_cut_short_is_as_before(made, monkeypatch):
  monkeypatch.setattr(dataset, '_write_manifest', lambda *_: None)
  more = [dataset.Model('new', 'cube', 'test', 'synthetic')]
  dataset.extend(made, more)
  monkeypatch.undo()
  again = dataset.open_dataset(made.root)
  assert len(dataset.surface_counts(again)) == 3
  assert len(dataset.surface_counts(dataset.extend(again, more))) == 4


def test_facts_come_back(made):
  facts = dataset.Facts(faces=1234567, missing=2, volume=-0.25)
  dataset.write_record(made.arrays, 1, tiny_record(1)._replace(facts=facts))
  assert dataset.read_record(made, 1).facts == facts
  assert dataset.read_record(made, 0).facts == dataset.Facts()
