"""Relative indices of OBJ faces."""

import pytest

from cvn.errors import UserError
from datagen import obj
from datagen.obj import absolute_indices, without_normals

POINTS = b'v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nvn 0 0 1\n'


def faces(content):
  return [line for line in absolute_indices(content).split(b'\n') if line.startswith(b'f')]


def test_indices_count_back_from_the_face():
  content = POINTS + b'f -3 -2 -1\n' + POINTS + b'f -3 -2 -1\nf 1 -4 6\n'
  assert faces(content) == [b'f 1 2 3', b'f 4 5 6', b'f 1 3 6']


def test_each_kind_counts_alone():
  content = POINTS + b'v 1 1 1\nf -4/-3/-1 -3//-1 4/-1\n'
  assert faces(content) == [b'f 1/1/1 2//1 4/3']


def test_long_lines_and_windows_lines():
  content = POINTS + b'f -3 \\\r\n-2 \\\n-1\r\n'
  assert faces(content) == [b'f 1 2 3']


def test_other_files_stay_as_they_are():
  content = b'# f -1\nv -1 -2 -3\n' + POINTS + b'g f -1\nf 1/1 2/2 3/3\n'
  assert absolute_indices(content) is content


@pytest.mark.parametrize('face', [b'f 0 1 2', b'f -4 1 2', b'f 1/-4 2/1 3/1', b'f 1//0 2//0 3//0'])
def test_indices_of_nothing(face):
  with pytest.raises(UserError, match='names what is not there') as e:
    absolute_indices(POINTS + face)
  assert face.decode() in str(e.value)


def test_words_for_indices():
  with pytest.raises(ValueError, match='invalid literal'):
    absolute_indices(POINTS + b'f -x 1 2\n')


@pytest.mark.parametrize('piece', [1, 30, 1 << 22])
def test_normals_are_left_out(piece, monkeypatch):
  monkeypatch.setattr(obj, 'PIECE', piece)
  content = POINTS + b'vn 1 0 0\r\nf 1/1/1 2/2/1 3/3/1\nf 1//1 2//1\t3//1\r\nf 1/1 2/2 3/3\nf 1 2 3'
  expected = POINTS.replace(b'vn 0 0 1\n', b'') + (
    b'f 1/1 2/2 3/3\nf 1/ 2/\t3/\r\nf 1/1 2/2 3/3\nf 1 2 3'
  )
  assert without_normals(content) == expected
  assert without_normals(content + b'\nf 1/1/1') == expected + b'\nf 1/1'


def test_names_that_look_like_corners_stay():
  content = POINTS + b'usemtl 1/2/3\nf 1//1 2//1 3//1\n'
  assert without_normals(content) == content
