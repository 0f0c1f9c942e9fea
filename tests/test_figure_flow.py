"""The figure of a symmetric object's flow: mirror images, choice, distances."""

import numpy as np
import pytest
from test_figure_random import GRID, make_workdir, read_figure, run, save_networks

from cvn import dataset
from experiments.lib import picks
from experiments.paper.figures import flow as figure_flow


def make_record(index, visible, flow=(0.5, 0.5), size=32):
  """A record of given voxels in one view."""
  index = np.array(index, np.uint8)
  views = np.full((1, size, size, 4), 255, np.uint8)
  colors = np.full((len(index), 3), 100, np.uint8)
  flow = np.broadcast_to(np.float32(flow), (1, len(index), 2))
  return dataset.Record(views, index, colors, np.array([visible]), flow)


def test_hidden_voxels_find_their_visible_mirror_images():
  index = [(0, 1, 2), (1, 5, 5), (14, 5, 5), (15, 1, 2), (3, 3, 3), (12, 3, 3), (7, 0, 0)]
  visible = [True, False, True, False, True, True, False]
  pairs = figure_flow.find_pairs(make_record(index, visible), 0, 16)
  assert pairs.tolist() == [[1, 2], [3, 0]]


def test_the_most_symmetric_model_is_chosen(tmp_path):
  pair = [(2, 5, 5), (13, 5, 5)]
  records = (
    make_record([(2, 5, 5), (6, 5, 5)], [True, False]),  # no mirror image
    make_record(pair, [True, True]),  # nothing hidden
    make_record(pair, [True, False]),
  )
  planned = tuple(dataset.Model(f'm{n}', 'car', 'test', 'made') for n in range(len(records)))
  made = dataset.create(str(tmp_path), dataset.Manifest(planned, (90,), 32, 16, 64, {}))
  for n, record in enumerate(records):
    dataset.write_record(made.arrays, n, record)
  assert figure_flow.choose(made, [0, 1, 2], 0) == (2, 1.0)
  assert figure_flow.choose(made, [0, 1], 0) == (1, 1.0)
  assert figure_flow.choose(made, [0], 0) == (0, 0.0)


def test_the_distance_is_the_median():
  flow = np.zeros((3, 2))
  assert figure_flow.distance(flow, flow + [[3, 4], [0, 1], [60, 80]]) == 5
  assert figure_flow.distance(flow[:0], flow[:0]) == 0


def test_the_figure_tells_what_it_shows(tmp_path, monkeypatch, capsys):
  given = make_workdir(tmp_path, monkeypatch)
  save_networks(given, 'car', 'blended')
  run(figure_flow, '--category=car', tile=48, **given)
  image, facts = read_figure(given, 'flow')
  assert (image < 100).any()
  assert [(r['category'], r['azimuth']) for r in facts['rows']] == [('car', 90)]
  assert facts['networks'] == {'car': {'blended': 'runs/blended_car_0'}}
  assert facts['hidden_voxels'] > 0 and facts['pixels_to_target'] > 0
  # An ellipsoid on the grid is its own mirror image.
  assert facts['mirror_iou'] == pytest.approx(1)
  assert facts['caption'] in capsys.readouterr().out


def test_both_sides_look_the_same_where_the_flow_is_symmetric(tmp_path, monkeypatch):
  given = make_workdir(tmp_path, monkeypatch)
  opened = dataset.open_dataset(given['data'])
  record = dataset.read_record(opened, 2)
  tiles = []
  monkeypatch.setattr(figure_flow.figures, 'grid_of_images', lambda rows, **_: tiles.extend(rows))
  # What lies at one height is fetched from one place.
  flow = np.stack([np.full(len(record.surface_index), 0.5), record.surface_index[:, 1] / GRID], -1)
  pick = picks.of(opened, 2, 1)
  flows = {'target': flow.astype(np.float32)}
  figure_flow.draw(pick, record, flows, grid_size=GRID, tile=48)
  _, seen, hidden = tiles[0]
  silhouettes = [np.any(x < 255, axis=-1) for x in (seen, hidden[:, ::-1])]
  assert np.mean(silhouettes[0] != silhouettes[1]) < 0.01
  # The light comes from one side, so shades differ and hues do not.
  both = silhouettes[0] & silhouettes[1]
  hues = [x[both] / x[both].sum(-1, keepdims=True) for x in (seen, hidden[:, ::-1])]
  assert np.abs(hues[0] - hues[1]).mean() < 0.02
