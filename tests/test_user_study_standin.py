"""The stand-in: likeness of drawings, and who is closer."""

import json

import numpy as np
import pytest
import studies

from cvn import figures
from experiments.lib.scoring import PSNR_CEILING
from experiments.study import standin as user_study_standin
from experiments.study.standin import GREY, LABEL


def test_the_truth_is_like_itself():
  box = studies.make_box('flow')
  found = user_study_standin.compare({'a': box}, box, azimuths=(0, 45), size=32)
  assert found['a'] == {'ssim': pytest.approx(1), 'psnr': PSNR_CEILING}


def test_psnr_is_that_of_the_drawings():
  box, other = studies.make_box('flow'), studies.make_box('regression')
  found = user_study_standin.compare({'a': other}, box, azimuths=(0, 45), size=32)
  wanted = []
  for azimuth in (0, 45):
    a, b = (
      figures.draw_voxels(v, azimuth, elevation=0, size=32, background=GREY) / 255
      for v in (box, other)
    )
    wanted.append(-10 * np.log10(np.mean((a - b) ** 2)))
  assert found['a']['psnr'] == pytest.approx(np.mean(wanted))
  assert 0 < found['a']['ssim'] < 1


def test_what_is_closer_scores_higher():
  box = studies.make_box('flow')
  near = box._replace(color=0.9 * box.color)
  far = box._replace(color=0.4 * box.color)
  smaller = near._replace(occupancy=box.occupancy & (np.arange(16) < 9))
  results = {'near': near, 'far': far, 'smaller': smaller}
  found = user_study_standin.compare(results, box, azimuths=range(0, 360, 90), size=32)
  for measure in ('ssim', 'psnr'):
    assert found['near'][measure] > found['far'][measure]
    assert found['near'][measure] > found['smaller'][measure]


def _run(tmp_path, monkeypatch, *more):
  studies.without_networks(monkeypatch)
  studies.make_data(tmp_path)
  f = studies.parse(user_study_standin.define_flags, tmp_path, '--models=all', *more)
  assert user_study_standin.run(f) == 0
  folder = tmp_path / 'work' / 'user_study'
  assert (folder / 'standin.png').stat().st_size > 1000
  return json.loads((folder / 'standin.json').read_text())


def test_report_says_what_it_is_and_agrees_with_its_scores(tmp_path, monkeypatch, capsys):
  report = _run(tmp_path, monkeypatch, '--shapes=2')
  assert report['what'] == LABEL == 'automatic stand-in, no person was asked'
  assert len(report['shapes']) == 4
  for measure in ('ssim', 'psnr'):
    for other in ('regression', 'flow'):
      shapes = [s['scores'] for s in report['shapes']]
      ours = sum(s['blended_0.2'][measure] > s[other][measure] for s in shapes)
      row = report['closer'][measure][other]
      assert (row['all']['ours'], row['all']['choices']) == (ours, 4)
      assert row['chair']['choices'] == row['ball']['choices'] == 2
    mean = np.mean([s['scores']['flow'][measure] for s in report['shapes']])
    assert report['means']['flow'][measure] == pytest.approx(mean)
  out = capsys.readouterr().out
  assert LABEL in out and 'closer by SSIM' in out and 'closer by PSNR' in out


def test_equal_results_are_no_wins(tmp_path, monkeypatch):
  monkeypatch.setitem(studies.COLORS, 'flow', studies.COLORS['blended_0.2'])
  report = _run(tmp_path, monkeypatch, '--shapes=1')
  assert report['closer']['ssim']['flow'] == {}
  assert report['closer']['ssim']['regression']['all']['choices'] == 2
