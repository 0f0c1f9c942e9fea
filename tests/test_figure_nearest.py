"""Nearest-foreground sampling with and without: the measures and the choice of models."""

import markdown_cells
import numpy as np
import pytest
from test_figure_random import AZIMUTHS, GRID, IMAGE, make_workdir, read_figure, run

from cvn import data, dataset, metrics
from cvn.infer import Reconstruction
from experiments.lib import protocol, scoring
from experiments.paper.figures import nearest as figure_nearest


@pytest.fixture
def given(tmp_path, monkeypatch):
  return make_workdir(tmp_path, monkeypatch)


def fake(flow, occupied=True):
  """A predictor that finds the given flow everywhere, and trusts the sampled colour alone."""
  volume = (GRID,) * 3
  sampled = np.full((*volume, 3), 0.5, np.float32)
  one = Reconstruction(
    occupancy=np.full(volume, occupied),
    probability=None,
    color=sampled,
    regressed=np.zeros_like(sampled),
    sampled=sampled,
    flow=np.broadcast_to(flow, (*volume, 2)),
    weight=np.ones(volume, np.float32),
  )
  return lambda views: [one] * len(views)


@pytest.mark.parametrize('flow, on_background', [((0.01, 0.01), True), ((0.5, 0.5), False)])
def test_the_plain_flow_takes_the_background_where_it_points_at_it(given, flow, on_background):
  record = dataset.read_record(dataset.open_dataset(given['data']), 2)
  pixel = record.views[:, int(flow[1] * IMAGE), int(flow[0] * IMAGE)] / 255
  assert (pixel[:, 3] == (0 if on_background else 1)).all()
  predict = fake(np.float32(flow))
  for n, one in enumerate(figure_nearest.sample(record.views, predict(record.views))):
    assert (one.background == on_background).all() and one.occupancy.all()
    expected = [data.GREY] * 3 if on_background else pixel[n, :3]
    for colors in (one.plain, one.plain_blended):
      np.testing.assert_allclose(colors, np.broadcast_to(expected, colors.shape), rtol=1e-5)
    np.testing.assert_array_equal(one.nearest, 0.5)
  measured = figure_nearest.measure_model(record, predict, GRID)
  assert measured.shape == (len(AZIMUTHS), len(figure_nearest.MEASURES))
  np.testing.assert_array_equal(measured[:, 0], float(on_background))
  true = scoring.to_voxels(record, GRID)
  partner = metrics.aligned_colors(np.ones((GRID,) * 3, bool), true)
  assert measured[0, 2] == pytest.approx(metrics.psnr(np.full_like(partner, 0.5), partner).rgb)


def test_views_without_voxels_have_no_share(given):
  record = dataset.read_record(dataset.open_dataset(given['data']), 2)
  predict = fake(np.float32((0.5, 0.5)), occupied=False)
  assert np.isnan(figure_nearest.measure_model(record, predict, GRID)).all()


def test_means_are_over_views_that_have_voxels():
  measured = np.full((3, 2, 5), np.nan)
  measured[0] = [[0.2, 1, 2, 3, 4], [0.4, 3, 4, 5, 6]]
  measured[1, 0] = [0.9, 5, 6, 7, 8]
  summary = figure_nearest.summarize(['car', 'car', 'zebra'], measured)
  assert list(summary) == ['car', 'zebra', 'all']
  assert summary['car']['models'] == 2 and summary['car']['share'] == pytest.approx(0.5)
  assert summary['car']['nearest_blended'] == pytest.approx(6)
  assert summary['zebra']['share'] is None and summary['all'] == summary['car'] | {'models': 3}
  (table,) = markdown_cells.read(figure_nearest.to_markdown(summary))
  assert table[1] == ['car', '2', '50.0%', '3.000 dB', '4.000 dB', '5.000 dB', '6.000 dB']
  assert table[2] == ['zebra', '1', *['–'] * 5]


def test_the_models_shown_have_the_highest_share_of_their_category(given):
  opened = dataset.open_dataset(given['data'])
  shares = np.array([[0.1, 0.2, np.nan], [0.5, 0.6, 0.9], [0.3, 0.1, 0.2], [np.nan] * 3])
  picked = figure_nearest.pick_highest(opened, [2, 3, 6, 7], shares, 1)
  assert [(e.row, e.view) for e in picked] == [(3, 2), (6, 0)]
  assert len(figure_nearest.pick_highest(opened, [2, 3, 6, 7], shares, 2)) == 4


def test_the_program_prints_the_share_of_the_whole_split(given, monkeypatch, capsys):
  predict = fake(np.linspace(0, 1, GRID, dtype=np.float32)[:, None])
  monkeypatch.setattr(protocol, 'make_predictor', lambda *_, **__: predict)
  run(figure_nearest, '--models=all', tile=48, **given)
  image, facts = read_figure(given, 'nearest')
  assert (image < 100).any() and len(facts['rows']) == 2
  total = facts['measures']['all']
  assert total['models'] == 4 and 0.2 < total['share'] < 0.8
  (table,) = markdown_cells.read(capsys.readouterr().out)
  assert table[-1][:3] == ['all', '4', f'{total["share"]:.1%}']
