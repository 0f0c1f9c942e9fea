"""The demonstration's page and the small steps around the programs it runs."""

import base64
import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest
import synthetic

from cvn import dataset, export, grid, photo
from cvn.errors import UserError
from experiments import demo, demo_page
from experiments.lib import assets


def _page(**changes):
  png = assets.to_png(np.full((3, 5, 3), 100, np.uint8))
  page = demo_page.Page(
    about='made of <b>&',
    verdict='Better.',
    success=True,
    examples=[
      demo_page.Example('first', png, png, b'glTF one', ['models/a.glb', 'models/a.ply']),
      demo_page.Example('"second"', png, png, b'glTF two', []),
    ],
    table=demo_page.Table(['IoU'], [('networks', ['0.5']), ('baseline', ['0.25'])], [0]),
    curves=[demo_page.Curve('loss', [(1, 0.5), (2, 0.25)], [(2, 0.4)])],
    contact_sheet=png,
    commands=[('python -m a --b=<c>', 30.0), ('python -m d', 90.0)],
  )
  return demo_page.render(page._replace(**changes))


class _Tags(HTMLParser):
  """Collects tags, and complains of those that are not closed in order."""

  VOID = ('meta', 'img', 'br', 'link')

  def __init__(self, text):
    super().__init__()
    self.tags, self.open = [], []
    self.feed(text)
    self.close()
    assert self.open == []

  def handle_starttag(self, tag, attrs):
    self.tags.append((tag, dict(attrs)))
    if tag not in self.VOID:
      self.open.append(tag)

  def handle_startendtag(self, tag, attrs):
    self.tags.append((tag, dict(attrs)))

  def handle_endtag(self, tag):
    assert self.open.pop() == tag


def test_page_is_well_formed_and_needs_nothing_from_elsewhere():
  text = _page()
  tags = _Tags(text).tags
  for tag, attributes in tags:
    if 'src' in attributes:
      assert attributes['src'].startswith('data:image/png;base64,')
    assert tag != 'link'
  loads = re.findall(r'(?:src|url)\s*[=(]\s*["\']?(?!#|data:)\w+', text)
  assert loads == []
  links = [a['href'] for t, a in tags if t == 'a']
  assert links == ['models/a.glb', 'models/a.ply']


def test_page_embeds_each_model_for_its_viewer():
  text = _page()
  tags = _Tags(text).tags
  viewers = [a['data-glb'] for t, a in tags if t == 'canvas']
  assert len(viewers) == 2
  for name, data in zip(viewers, (b'glTF one', b'glTF two'), strict=True):
    (found,) = re.findall(f'id="{name}">(.*?)</script>', text)
    assert base64.b64decode(found) == data


def test_page_shows_text_as_text():
  text = _page()
  assert 'made of &lt;b&gt;&amp;' in text and 'python -m a --b=&lt;c&gt;' in text
  assert '<h2>Commands, 2.0 min in all</h2>' in text


def test_page_sets_the_best_in_bold_and_marks_failure():
  assert '<td class="best">0.5</td>' in _page() and '<td>0.25</td>' in _page()
  assert 'class="verdict good"' in _page()
  assert 'class="verdict bad"' in _page(success=False)


def test_curves_come_from_the_log(tmp_path):
  path = tmp_path / 'log.jsonl'
  lines = [
    {'step': 1, 'epoch': 0.5, 'loss': 3.0},
    {'step': 2, 'epoch': 1.0, 'loss': 2.0},
    {'step': 2, 'epoch': 1.0, 'validation': {'loss': 2.5, 'iou': 0.25, 'other': 1}},
  ]
  path.write_text(''.join(json.dumps(x) + '\n' for x in lines))
  loss, iou = demo.read_curves('shape', str(path))
  assert loss[1:] == ([(0.5, 3.0), (1.0, 2.0)], [(1.0, 2.5)])
  assert iou == ('shape network: IoU', [], [(1.0, 0.25)])


def test_pictures_are_held_out_views_and_come_back_as_written(tmp_path):
  made = synthetic.make_dataset(tmp_path / 'data', 6, splits=('train', 'test'))
  pictures = demo.choose(made, 2)
  assert [p.row for p in pictures] == [1, 3]
  assert demo.name_of(pictures[0]) == 'm1_30'
  path = demo.write_picture(made, pictures[1], str(tmp_path / 'pictures'))
  assert path.endswith('m3_330.png')
  record = dataset.read_record(made, 3)
  np.testing.assert_array_equal(photo.load_view(path), record.views[11])


def test_no_held_out_object(tmp_path):
  made = synthetic.make_dataset(tmp_path / 'data', 1, splits=('train',))
  with pytest.raises(UserError, match='--limit'):
    demo.choose(made, 2)


def test_example_takes_the_pictures_files(tmp_path):
  made = synthetic.make_dataset(tmp_path / 'data', 1, splits=('test',))
  (picture,) = demo.choose(made, 6)
  voxels = grid.ColoredVoxels(np.ones((2,) * 3, bool), np.ones((2, 2, 2, 3)))
  stem = str(tmp_path / 'models' / demo.name_of(picture))
  export.write_glb(f'{stem}.glb', voxels)
  with open(f'{stem}.png', 'wb') as f:
    f.write(b'panel')
  example = demo.make_example(made, picture, str(tmp_path / 'models'), str(tmp_path))
  assert example.name == 'm0, seen from 30°'
  assert example.panel == b'panel' and example.glb.startswith(b'glTF')
  assert list(example.links) == [f'models/m0_30.{s}' for s in ('glb', 'ply', 'png')]


def _evaluation(iou, psnr):
  ours = {'iou': iou, 'psnr_rgb': psnr, 'psnr_ycbcr': psnr}
  trivial = {'iou': 0.2, 'psnr_rgb': 12.0, 'psnr_ycbcr': 13.0}
  return {'models': 3, 'views': 12, 'networks': {'total': ours}, 'baselines': {'total': trivial}}


@pytest.mark.parametrize(
  'iou, psnr, success', [(0.3, 13.5, True), (0.2, 13.5, False), (0.3, 12.5, False)]
)
def test_verdict_needs_all_measures_above_the_baselines(iou, psnr, success):
  table, found, verdict = demo.judge(_evaluation(iou, psnr))
  assert found == success
  assert ('NOT' in verdict) != success
  assert table.rows[0][1][0] == f'{iou:.3f}' and table.rows[1][1][0] == '0.200'
  assert table.best[0] == (0 if iou > 0.2 else 1)


def test_verdict_without_any_voxel():
  table, success, verdict = demo.judge(_evaluation(0.3, None))
  assert not success and 'none' in verdict and table.rows[0][1][1] == 'none'
