"""The study's folder: pairs, drawings, and a key that fits the page."""

import io
import json
import os
import re

import numpy as np
import pytest
import studies
import synthetic
from absl import flags
from PIL import Image

from cvn import figures
from cvn.grid import ColoredVoxels
from experiments.lib import cli, pictures, protocol
from experiments.study import __main__ as user_study
from experiments.study import turntables
from experiments.study.turntables import COLUMNS, GREY


@pytest.fixture(scope='module')
def study(tmp_path_factory):
  """(page, its content, key) of a study."""
  with pytest.MonkeyPatch.context() as monkeypatch:
    return _read(studies.make_study(tmp_path_factory.mktemp('study'), monkeypatch))


def _read(folder):
  with open(os.path.join(folder, 'key.json')) as f:
    key = json.load(f)
  with open(os.path.join(folder, 'study.html'), encoding='utf-8') as f:
    page = f.read()
  (content,) = re.findall(r'<script type="application/json" id="content">(.*?)</script>', page)
  return page, json.loads(content), key


def test_every_shape_meets_ours_and_each_other(study):
  page, content, key = study
  assert content['page'] == key['page'] and f'Page {key["page"]}.' in page
  assert len(content['pictures']) == 5 and sorted(content['sheets']) == sorted(key['results'])
  found = []
  for pair in content['pairs']:
    assert key['pairs'][pair['name']] == pair['sheets']
    results = [key['results'][s] for s in pair['sheets']]
    assert {r['shape'] for r in results} == {pair['picture']}
    found.append((pair['picture'], *sorted(r['method'] for r in results)))
  wanted = [(n, 'blended_0.2', other) for n in range(5) for other in ('flow', 'regression')]
  assert sorted(found) == wanted and found != wanted


def test_page_tells_nothing_of_methods(study):
  page, content, key = study
  text = re.sub(r'"image": "[^"]*"|data:[^"]*', '', page)
  for method in ('blended_0.2', 'regression', 'flow'):
    assert protocol.METHODS[method].title not in text
    assert not re.search(rf'(?<!over){method}\b', text)  # overflow is CSS's
  # Neither do places: ours is first in some pairs, and the names are in no order of methods.
  ours = [key['results'][p['sheets'][0]]['method'] == 'blended_0.2' for p in content['pairs']]
  assert 0 < sum(ours) < len(ours)
  methods = [key['results'][s]['method'] for s in content['sheets']]
  assert methods != sorted(methods) and methods[:3] != methods[3:6]


def test_same_flags_same_page_other_seed_other_page(tmp_path, monkeypatch):
  pages = [
    _read(studies.make_study(tmp_path / name, monkeypatch, '--shapes=1', f'--study_seed={seed}'))[0]
    for name, seed in (('a', 0), ('b', 0), ('c', 1))
  ]
  assert pages[0] == pages[1] != pages[2]


def test_output_is_below_the_workdir_by_default(tmp_path, monkeypatch):
  studies.without_networks(monkeypatch)
  studies.make_data(tmp_path)
  monkeypatch.setattr(turntables, 'FRAMES', studies.FRAMES)
  studies.run(tmp_path, '--models=all', '--size=32', '--shapes=1', '--against=flow')
  folder = tmp_path / 'work' / 'user_study'
  assert sorted(os.listdir(folder)) == ['key.json', 'study.html']
  key = json.loads((folder / 'key.json').read_text())
  assert [s['category'] for s in key['shapes']] == ['chair', 'ball'] and len(key['pairs']) == 2


@pytest.mark.parametrize(
  'wrong, message',
  [
    ('--against=flow,blended_0.2', 'must not name the method of --ours'),
    ('--against=msfcel', 'must be different ones of'),  # has no colours
    ('--against=flow,flow', 'must be different ones of'),
    ('--against=', 'must be different ones of'),
    ('--seeds=0,1', 'must be one'),
  ],
)
def test_methods_that_cannot_be_compared(tmp_path, wrong, message):
  with pytest.raises(flags.IllegalFlagValueError, match=message):
    studies.run(tmp_path, wrong)


def reconstruct(tmp_path, made, methods, **named):
  """(picks, results) of experiments.study."""
  folders = {'data': tmp_path / 'data', 'workdir': tmp_path / 'work'}
  plan = protocol.read_flags(cli.parse(protocol.define_flags, **folders, **named))
  shown = pictures.choose(plan, made, seed=0, per_category=5)
  return shown, user_study.reconstruct(plan, shown, methods)


def test_each_category_is_reconstructed_by_its_own_networks(tmp_path, monkeypatch):
  made = studies.make_data(tmp_path)
  asked = studies.without_networks(monkeypatch)
  chosen, found = reconstruct(tmp_path, made, ['blended_0.2', 'flow'], seeds='7')
  found = list(found)
  assert [r.pick for r in found] == chosen and len(chosen) == 5
  assert asked == [(m, c, '7') for c in ('chair', 'ball') for m in ('blended_0.2', 'flow')]
  for results in found:
    assert list(results.voxels) == ['blended_0.2', 'flow']
    for method, voxels in results.voxels.items():
      np.testing.assert_array_equal(voxels.color, studies.make_box(method).color)
    model = synthetic.make_record(results.pick.row, image_size=32, grid_size=studies.GRID)
    np.testing.assert_array_equal(results.shown.view, model.views[results.pick.view])


def test_methods_see_the_chosen_view_alone(tmp_path, monkeypatch):
  made = studies.make_data(tmp_path)
  asked, seen = [], []

  def make_predictor(plan, method, category, seed):
    asked.append((method, category))

    def predict(views):
      seen.append(views)
      return [studies.make_box(method)]

    return predict

  monkeypatch.setattr(protocol, 'make_predictor', make_predictor)
  _, found = reconstruct(tmp_path, made, ['blended_0.2', 'flow'], models='all')
  for results in found:
    assert len(seen) == 2
    for views in seen:
      np.testing.assert_array_equal(views, results.shown.view[None])
    seen.clear()
  assert asked == [('blended_0.2', 'all'), ('flow', 'all')]  # loaded once


def _frames(sheet):
  image = np.asarray(Image.open(io.BytesIO(sheet.image)).convert('RGB'))
  assert image.shape == (turntables.FRAMES // COLUMNS * sheet.height, COLUMNS * sheet.width, 3)
  lines = image.reshape(-1, sheet.height, COLUMNS, sheet.width, 3).swapaxes(1, 2)
  return lines.reshape(turntables.FRAMES, sheet.height, sheet.width, 3)


def test_turntable_starts_at_the_picture_and_goes_round(monkeypatch):
  monkeypatch.setattr(turntables, 'FRAMES', studies.FRAMES)
  box = studies.make_box('flow')
  box.color[8:] = (0.9, 0.9, 0.1)  # two sides
  small = box._replace(occupancy=box.occupancy & (np.arange(16) < 10))
  sheets = turntables.draw([box, small], 60, 64)
  assert sheets[0].width == sheets[1].width < 64 and sheets[0].height == sheets[1].height < 64
  turns = [
    np.stack(
      [
        figures.draw_voxels(v, 60 + 360 * n / turntables.FRAMES, size=64, background=GREY)
        for n in range(turntables.FRAMES)
      ]
    )
    for v in (box, small)
  ]
  rows, columns = turntables.common_frame(turns)
  for sheet, turn in zip(sheets, turns, strict=True):
    errors = np.abs(_frames(sheet)[:, None] - turn[None, :, rows, columns].astype(int))
    assert (errors.mean((2, 3, 4)).argmin(1) == np.arange(turntables.FRAMES)).all()


def test_frame_is_symmetric_and_holds_all():
  turns = [np.full((2, 100, 100, 3), 246, np.uint8) for _ in range(2)]
  turns[0][1, 40, 70:81] = 0
  turns[1][0, 50, 45] = 10
  rows, columns = turntables.common_frame(turns)
  assert (rows.start, rows.stop) == (32, 59)
  assert (columns.start, columns.stop) == (11, 89)


def test_nothing_is_occupied():
  empty = ColoredVoxels(np.zeros((16,) * 3, bool), np.zeros((16, 16, 16, 3)))
  (sheet,) = turntables.draw([empty], 0, 32)
  assert (sheet.width, sheet.height) == (32, 32)
  assert np.ptp(_frames(sheet)) == 0


@pytest.mark.parametrize('corner', [(0, 0), (20, 12), (24, 24)])
def test_picture_is_cut_to_the_object(corner):
  view = np.zeros((32, 32, 4), np.uint8)
  r, c = corner
  view[r : r + 8, c : c + 4] = (200, 30, 30, 255)
  cut = turntables.crop_to_object(view)
  assert cut.shape == (24, 24, 3)
  inside = (cut == (200, 30, 30)).all(-1)
  assert inside.sum() == 32 and inside[8:16, 10:14].all()


def test_picture_without_an_object_stays_whole():
  cut = turntables.crop_to_object(np.zeros((32, 32, 4), np.uint8))
  assert cut.shape == (48, 48, 3) and (cut == GREY).all()
