"""Axes of volumes, found from flows: known answers for volumes turned in known ways."""

import numpy as np
import pytest
import synthetic

from cvn.camera import AZIMUTHS
from datagen.axes import find_axes


@pytest.fixture(scope='module')
def records():
  return [synthetic.make_record(n, image_size=64, grid_size=16) for n in range(3)]


def found(records, turn=lambda index: index, flow=lambda record: record.flow, azimuths=AZIMUTHS):
  indices = [turn(r.surface_index.astype(int)) for r in records]
  return find_axes(indices, [flow(r) for r in records], azimuths)


def test_our_own_volumes_have_our_axes(records):
  axes = found(records)
  assert axes.names == ('x', 'y', 'z')
  assert axes.agreement > 0.99
  assert not axes.is_mirrored


@pytest.mark.parametrize(
  'turn, names, is_mirrored',
  [
    (lambda i: i[:, [2, 1, 0]], ('z', 'y', 'x'), True),
    (lambda i: np.stack([15 - i[:, 2], i[:, 1], i[:, 0]], -1), ('-z', 'y', 'x'), False),
    (lambda i: np.stack([i[:, 0], 15 - i[:, 2], i[:, 1]], -1), ('x', '-z', 'y'), False),
    (lambda i: np.stack([15 - i[:, 0], i[:, 1], i[:, 2]], -1), ('-x', 'y', 'z'), True),
  ],
)
def test_turned_volumes(records, turn, names, is_mirrored):
  axes = found(records, turn)
  assert axes.names == names
  assert axes.agreement > 0.99
  assert axes.is_mirrored == is_mirrored


def test_azimuths_that_run_the_other_way_look_mirrored(records):
  axes = found(records, azimuths=[-a for a in AZIMUTHS])
  assert axes.names == ('x', 'y', '-z')
  assert axes.is_mirrored


def test_hidden_voxels_that_fetch_from_elsewhere_do_not_mislead(records):
  rng = np.random.default_rng(0)

  def scattered(record):
    elsewhere = rng.uniform(0.3, 0.7, record.flow.shape)
    return np.where(record.visible[..., None], record.flow, elsewhere)

  axes = found(records, flow=scattered)
  assert axes.names == ('x', 'y', 'z')
  assert axes.agreement > 0.5


def test_flows_that_follow_nothing(records):
  rng = np.random.default_rng(0)
  assert found(records, flow=lambda r: rng.uniform(0, 1, r.flow.shape)).agreement < 0.2
  assert found(records, flow=lambda r: r.flow[..., ::-1]).agreement < 0.2  # (v, u)
  assert found(records, flow=lambda r: np.full(r.flow.shape, 0.5)).agreement == 0
