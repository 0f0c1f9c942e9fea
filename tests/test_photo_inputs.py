"""Small pictures after public bug reports, a kind of fault each, and what is right.

pictures.zip holds them; pictures.json has what differs from the usual right result, a chair in the
middle with a red back, a blue seat and green legs: other colours, a warning, or an error.
"""

import json
import os
import zipfile

import numpy as np
import pytest

from cvn import photo
from cvn.errors import UserError

HERE = os.path.dirname(__file__)
CHAIR = [[200, 40, 40], [40, 70, 200], [40, 150, 60]]
with open(os.path.join(HERE, 'pictures.json'), encoding='utf-8') as f:
  EXPECTED = json.load(f)


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
  folder = tmp_path_factory.mktemp('pictures')
  with zipfile.ZipFile(os.path.join(HERE, 'pictures.zip')) as z:
    z.extractall(folder)
  return folder


@pytest.mark.parametrize('name', EXPECTED)
def test_right_or_a_reason_that_helps(folder, name):
  expected = {'error': None, 'warning': None, 'colors': CHAIR, 'shape': True} | EXPECTED[name]
  path = str(folder / name)
  if expected['error']:
    with pytest.raises(UserError) as e:
      photo.load_photo(path)
    assert path in str(e.value) and expected['error'] in str(e.value)
    return
  found = photo.load_photo(path)
  if expected['warning']:
    (warning,) = found.warnings
    assert warning.startswith(f'{path} ') and expected['warning'] in warning
  else:
    assert found.warnings == ()
  mask = found.view[..., 3] >= 128
  rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
  height, width = np.ptp(rows) + 1, np.ptp(columns) + 1
  assert max(height, width) in (77, 78)
  np.testing.assert_allclose([rows.mean(), columns.mean()], 63.5, atol=1)
  if not expected['colors']:
    return
  top, left = rows[0], columns[0]
  places = (
    (top + height // 8, left + round(0.08 * width)),
    (top + round(0.58 * height), left + width // 2),
    (top + round(0.9 * height), left + round(0.06 * width)),
  )
  for (row, column), color in zip(places, expected['colors'], strict=True):
    assert mask[row, column]
    np.testing.assert_allclose(found.view[row, column, :3], color, atol=8)
  if expected['shape']:
    assert abs(mask.sum() - 1970) < 40 and abs(width - 68) <= 2
    assert not mask[top : top + height // 3, left + width // 3 :].any()  # beside the back
    gap = np.s_[top + round(0.75 * height) :, left + width // 4 : left + 3 * width // 4]
    assert not mask[gap].any()  # between the legs
