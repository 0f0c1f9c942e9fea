"""Pictures of a training: of a network that is always right they show the truth twice."""

import numpy as np
import pytest
import synthetic

from cvn import data, grid
from cvn.infer import Network, Reconstruction
from cvn.networks import NETWORKS
from experiments.lib import training_pictures as program


@pytest.mark.parametrize('kind', ['shape', 'color'])
def test_pictures_of_a_perfect_network_show_the_truth(tmp_path, monkeypatch, kind):
  dataset = synthetic.make_dataset(tmp_path, 5)
  pairs = data.evaluation_pairs([0, 4], 2)[1:3]
  slots = data.max_voxels(dataset)
  truth = [data.decode(data.read_color(dataset, *p, max_voxels=slots)) for p in pairs]
  truth = [grid.to_voxels(t.index, t.color) for t in truth]
  right = Reconstruction(*[None] * 7)
  if kind == 'color':
    right = right._replace(color=np.stack([t.color for t in truth]))
  else:
    right = right._replace(occupancy=np.stack([t.occupancy for t in truth]))
  monkeypatch.setattr(program.infer, 'reconstruct', lambda images, shape, color: right)
  rows = []
  monkeypatch.setattr(program.figures, 'grid_of_images', lambda r, **_: rows.extend(r))
  program.draw_views(Network(kind, NETWORKS[kind](), {}), dataset, pairs)
  for (view, network, right), (row, azimuth) in zip(rows, pairs, strict=True):
    record = dataset.arrays['views'][row, azimuth].read().result()
    np.testing.assert_array_equal(view, np.round(data.composite(record) * 255))
    if kind == 'color':
      np.testing.assert_array_equal(network, right)
    else:
      background = right[0, 0]
      np.testing.assert_array_equal((network != background).any(-1), (right != background).any(-1))
