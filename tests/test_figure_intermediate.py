"""The figure of intermediate results, on networks of random parameters."""

import numpy as np
from test_figure_random import make_workdir, read_figure, run

from cvn import figures
from experiments.lib import pictures
from experiments.paper.figures import intermediate as figure_intermediate


def test_volumes_stand_on_the_found_voxels(tmp_path, monkeypatch, capsys):
  given = make_workdir(tmp_path, monkeypatch)
  drawn = []
  draw_row = figure_intermediate.draw_row
  monkeypatch.setattr(
    figure_intermediate, 'draw_row', lambda *a, **k: drawn.append(draw_row(*a, **k)) or drawn[-1]
  )
  run(figure_intermediate, '--category=car', tile=48, **given)
  (row,) = drawn
  assert len(row) == len(figure_intermediate.TITLES)
  found = [np.any(x < 255, axis=-1) for x in row[2:7]]
  assert found[0].any()
  for x in found[1:]:  # flow, sampled, regressed, weight, result: one silhouette
    assert np.mean(x != found[0]) < 0.02
  assert len({x.tobytes() for x in row}) == len(row)
  image, facts = read_figure(given, 'intermediate')
  assert image.shape[1] > len(figure_intermediate.TITLES) * 20
  assert [r['category'] for r in facts['rows']] == ['car']
  assert {*facts['networks']['car']} == {'r2n2', 'msfcel', 'blended'}
  assert facts['figure_seed'] == 0
  assert capsys.readouterr().out.splitlines()[0].endswith('intermediate.png')


def test_the_legend_has_the_codes_ends():
  legend = figure_intermediate.draw_legend(64)
  colors = {tuple(c) for c in legend.reshape(-1, 3)}
  assert {tuple(figures.to_uint8(c)) for c in figures.WEIGHT_COLORS} <= colors
  square = pictures.draw_flow_code(64)
  corners = square[[0, 0, -1, -1], [0, -1, 0, -1]].astype(int)
  assert np.abs(corners - figures.to_uint8(figures.FLOW_CORNERS)).max() <= 5
