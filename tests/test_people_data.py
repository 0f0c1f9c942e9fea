"""Reading MakeHuman's files: known vertices and weights of the miniature, and broken files."""

import gzip
import json
import os

import makehuman
import numpy as np
import pytest

from cvn.errors import UserError
from datagen.sources.people import data, rig

RIG, WEIGHTS = data.RIG, data.WEIGHTS
TARGET = f'targets/{makehuman.TARGET}.target.gz'


@pytest.fixture(scope='module')
def body(tmp_path_factory):
  return data.read_body(makehuman.write_wheel(tmp_path_factory.mktemp('wheel')))


def test_wheel_and_folder_hold_the_same(body, tmp_path):
  other = data.read_body(makehuman.write_folder(tmp_path))
  np.testing.assert_array_equal(other.vertices, body.vertices)
  np.testing.assert_array_equal(other.weights, body.weights)
  assert other.bones == body.bones and other.groups.keys() == body.groups.keys()
  index, offset = data.read_target(other, makehuman.FAT)
  assert index.tolist() == [1] and offset.tolist() == [[0, 0, 0.25]]


def test_bones_come_after_their_parents_and_begin_at_their_joints(body):
  assert body.parent[0] == -1 and body.bones[0] == 'pelvis'
  assert (body.parent[1:] < np.arange(1, len(body.bones))).all()
  at = rig.joints(body, body.vertices)
  np.testing.assert_allclose(at['lowerarm_l'], [3.6, 2.9, 0], atol=1e-6)  # by its cube
  np.testing.assert_allclose(at['hand_l'], [5.2, 1.3, 0.1], atol=1e-6)  # by a mean of vertices
  assert body.bones[body.parent[body.bones.index('hand_l')]] == 'lowerarm_l'


def test_weights_sum_to_one_and_the_root_moves_the_rest(body):
  np.testing.assert_allclose(body.weights.sum(1), 1)
  cube = np.unique(body.groups['joint-head'])
  np.testing.assert_array_equal(body.weights[cube, 0], 1)
  head = body.weights[:, body.bones.index('head')]
  assert head[np.unique(body.groups['helper-hair'])].min() == 1


def test_groups_share_no_vertices(body):
  used = np.concatenate([np.unique(faces) for faces in body.groups.values()])
  assert len(used) == len(np.unique(used)) == len(body.vertices)


def test_parses_obj_and_target_by_the_letter():
  vertices, groups = data.parse_obj(
    '# x\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\n'
    'g a\nf 1/1 2/1 3/1 4/1\ng b\nf 4/1 3/1 2/1 1/1\n'
  )
  np.testing.assert_array_equal(vertices[2], [1, 1, 0])
  assert groups['a'].tolist() == [[0, 1, 2, 3]] and groups['b'].tolist() == [[3, 2, 1, 0]]
  index, offset = data.parse_target('# c\n3 .5 0 -1\n0 1 2 3\n', 4)
  assert index.tolist() == [3, 0] and offset.tolist() == [[0.5, 0, -1], [1, 2, 3]]
  assert len(data.parse_target('# nothing\n', 4)[0]) == 0


def test_a_combination_without_a_target_moves_nothing(body):
  assert data.read_target(body, 'macrodetails/no-such') is None


@pytest.mark.parametrize(
  ('name', 'content', 'reason'),
  [
    ('3dobjs/base.obj', b'v 0 0 0\ng a\nf 1 2 3 4\n', 'a face names a vertex'),
    ('3dobjs/base.obj', b'v 0 0 nan\n', 'not finite'),
    ('3dobjs/base.obj', b'v 0 0 0\nv 1 0 0\nv 0 1 0\ng a\nf 1 2 3\n', 'ValueError'),
    ('3dobjs/base.obj', b'f 1 2 3 4\n', 'AttributeError'),
    ('3dobjs/base.obj', b'\xff\xfe', 'UnicodeDecodeError'),
    (RIG, b'{"bones": ', 'JSONDecodeError'),
    (RIG, b'{"bones": {"a": {"parent": "b"}, "b": {"parent": "a"}}}', 'parents are missing'),
    (RIG, makehuman.files()[RIG].replace(b'MEAN', b'NEW'), "by the strategy 'NEW'"),
    (RIG, None, 'has no file'),
    (WEIGHTS, b'{}', 'KeyError'),
    (WEIGHTS, json.dumps({'weights': {'pelvis': [[10**7, 1.0]]}}).encode(), 'IndexError'),
  ],
)
def test_broken_files_are_told(name, content, reason, tmp_path):
  files = makehuman.files() | {name: content}
  path = makehuman.write_wheel(tmp_path, {k: v for k, v in files.items() if v is not None})
  with pytest.raises(UserError, match=f'{os.path.basename(path)}.*{reason}'):
    data.read_body(path)


def _packed(text):
  return gzip.compress(text, mtime=0)  # without the time: each process must name the same tests


@pytest.mark.parametrize(
  'content',
  [b'no gzip', _packed(b'0 1 2\n'), _packed(b'99999999 0 0 0\n'),
   _packed(b'0 0 nan 0\n'), _packed(b'-1 0 0 0\n'), _packed(b'0 0 0 1\n')[:-9]],
)  # fmt: skip
def test_broken_targets_are_told(content, tmp_path):
  path = makehuman.write_wheel(tmp_path, makehuman.files() | {TARGET: content})
  with pytest.raises(UserError, match=f'the target {makehuman.TARGET} cannot be read'):
    data.read_target(data.read_body(path), makehuman.TARGET)


def test_a_target_that_unpacks_to_too_much_is_refused(tmp_path):
  bomb = gzip.compress(b'#' * (data.MAX_TARGET + 1))
  path = makehuman.write_wheel(tmp_path, makehuman.files() | {TARGET: bomb})
  with pytest.raises(UserError, match='more than'):
    data.read_target(data.read_body(path), makehuman.TARGET)


def test_says_where_there_is_no_data(tmp_path):
  assert data.find(str(tmp_path)) is None
  with pytest.raises(UserError, match=r'holds no 3dobjs/base\.obj'):
    data.read_body(str(tmp_path))
