"""The benchmark runs and says what it measured; how fast that was is no test's business."""

import re
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from absl import flags

from datagen import benchmark
from datagen.geometry.mesh import check


@pytest.mark.parametrize('faces, made', [(1, 8), (20000, 20000), (700, 722)])
def test_a_ball_of_about_so_many_faces(faces, made):
  mesh = benchmark.lumpy_ball(faces, 32)
  check(mesh)
  assert len(mesh.faces) == made
  assert mesh.textures[0].shape == (32, 32, 4)
  assert mesh.faces.max() == len(mesh.vertices) - 1
  # Every place of the image is somewhere on the ball.
  np.testing.assert_array_equal(mesh.corner_uv.min((0, 1)), 0)
  np.testing.assert_array_equal(mesh.corner_uv.max((0, 1)), 1)


def test_prints_machine_and_shares(capsys, monkeypatch):
  # No second process: starting one takes longer than all the rest.
  monkeypatch.setattr(benchmark, 'process_executor', lambda *_: ThreadPoolExecutor(1))
  f = flags.FlagValues()
  benchmark.define_flags(f)
  f(['benchmark', '--faces=500', '--texture=16', '--models=2'])
  benchmark.run(f)
  machine, total, *parts = capsys.readouterr().out.rstrip().split('\n')
  assert 'mitsuba' in machine and 'cores' in machine
  found = re.fullmatch(
    r'512 faces, texture 16, \d+ voxels: (\S+) s a model in one worker'
    r' \((\S+) to (\S+) over 2\), (\S+) s of its processor; peak memory \d+ MiB',
    total,
  )
  median, low, high, _ = (float(x) for x in found.groups())
  assert 0 < low <= median <= high
  seconds = {part[13:]: float(part[:9]) for part in parts}
  assert set(seconds) == {*benchmark.PARTS, benchmark.MITSUBA, 'all the rest'}
  assert 0 < seconds[benchmark.MITSUBA] < seconds['views']
