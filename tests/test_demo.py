"""The demonstration's page and the small steps around the programs it runs."""

import base64
import os
import re

import markdown_cells
import numpy as np
import pages
import pytest
import synthetic
import workdirs
from PIL import Image

from cvn import dataset, export, grid, photo
from cvn.errors import UserError
from experiments import demo
from experiments.lib import stages


@pytest.fixture
def made(tmp_path, monkeypatch):
  """(exit status, page, commands) of a demonstration whose programs leave small files."""
  ran = []

  def run_program(folder, program, **named):
    ran.append((program, named))
    line = f'python -m {program} --step={len(ran)}'
    seconds = stages.read_seconds(folder) | {line: 30}
    stages.write_json(os.path.join(folder, 'seconds.json'), seconds)
    if program == 'datagen.generate':
      synthetic.make_dataset(named['output'], 4, splits=('train', 'test'))
      Image.new('RGB', (5, 3)).save(os.path.join(named['output'], 'contact_sheet.png'))
    elif program == 'experiments.train':
      config = workdirs.CONFIG | {'network': named['network']}
      os.makedirs(os.path.join(named['workdir'], 'checkpoints', '4'))
      stages.write_json(os.path.join(named['workdir'], 'config.json'), config)
      with open(os.path.join(named['workdir'], 'log.jsonl'), 'w') as f:
        f.write('{"step": 4, "epoch": 2, "loss": 0.5}\n')
        f.write('{"step": 4, "epoch": 2, "validation": {"loss": 1, "iou": 0.25}}\n')
    elif program == 'experiments.evaluate':
      found = evaluation(0.3, 13.5) | {'threshold': 0.4, 'alpha': 0.6}
      stages.write_json(named['json'], found)
    else:
      voxels = grid.ColoredVoxels(np.ones((2,) * 3, bool), np.ones((2, 2, 2, 3)))
      for path in named['image'].split(','):
        stem = os.path.join(named['output'], os.path.splitext(os.path.basename(path))[0])
        export.write_glb(f'{stem}.glb', voxels)
        Image.new('RGB', (40, 30)).save(f'{stem}.png')
    return line

  monkeypatch.setattr(stages, 'run_program', run_program)
  status = demo.main([f'--output={tmp_path / "demo"}', '--category=ball', '--pictures=2'])
  return status, (tmp_path / 'demo/index.html').read_text(), ran


def test_the_programs_run_one_after_the_other(made):
  status, _, ran = made
  programs = [p.rpartition('.')[2] for p, _ in ran]
  assert status == 0 and programs == ['generate', 'train', 'train', 'evaluate', 'reconstruct']
  assert [n['network'] for p, n in ran if p.endswith('train')] == ['shape', 'color']
  assert 'threshold' not in ran[3][1]  # no models of the split val to choose it on
  chosen = {k: ran[4][1][k] for k in ('threshold', 'alpha', 'flip')}
  assert chosen == {'threshold': 0.4, 'alpha': 0.6, 'flip': 'true'}


def test_the_page_needs_nothing_but_the_files_it_offers(made):
  _, page, _ = made
  names = [f'models/m{n}_{a}.{s}' for n, a in ((1, 30), (3, 330)) for s in ('glb', 'ply', 'png')]
  tags = pages.check_alone(page, links=names)
  assert [a['href'] for t, a in tags if t == 'a' and a['href'][0] != '#'] == names
  canvases = [a['data-glb'] for t, a in tags if t == 'canvas']
  assert canvases == ['m1_30', 'm3_330']
  for name in canvases:
    (glb,) = re.findall(f'id="{name}">(.*?)</script>', page)
    assert base64.b64decode(glb).startswith(b'glTF')
  titles = re.findall(r'>(?:shape|color): (?:loss|IoU)<', page)
  assert titles == ['>shape: loss<', '>shape: IoU<', '>color: loss<', '>color: IoU<']
  assert 'Commands, 2 min in all' in page and '--step=5  # 30 s' in page


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


def evaluation(iou, psnr):
  ours = {'iou': iou, 'psnr_rgb': psnr, 'psnr_ycbcr': psnr}
  trivial = {'iou': 0.2, 'psnr_rgb': 12.0, 'psnr_ycbcr': 13.0}
  return {'models': 3, 'views': 12, 'networks': {'total': ours}, 'baselines': {'total': trivial}}


@pytest.mark.parametrize(
  'iou, psnr, better',
  [
    (0.3, 13.5, [True] * 3),
    (0.2, 13.5, [False, True, True]),
    (0.3, 12.5, [True, True, False]),
    (0.3, None, [True, False, False]),
  ],
)
def test_success_needs_every_measure_above_its_baseline(iou, psnr, better):
  report = evaluation(iou, psnr)
  found = demo.find_better(report)
  assert [*found.values()] == better
  text = demo.make_table(report, found)
  (table,) = markdown_cells.read(text)
  shown = 'none' if psnr is None else f'{psnr:.2f} dB'
  assert table[1:] == [
    ['networks', f'{iou:.3f}', shown, shown],
    ['mean training shape and mean training colour', '0.200', '12.00 dB', '13.00 dB'],
  ]
  rows = text.splitlines()[2:]
  bold = [[cell.startswith(' **') for cell in row.split('|')[2:-1]] for row in rows]
  assert bold == [better, [not b for b in better]]
  assert demo.say_verdict(report, found).startswith('NOT ') != all(better)
