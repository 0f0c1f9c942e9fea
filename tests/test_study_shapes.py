"""Which shapes and views are judged, and which networks make results of them."""

import numpy as np
import pytest
import studies
import synthetic
from absl import flags

from cvn.errors import UserError
from experiments.lib import protocol
from experiments.study import shapes as study_shapes


def _define(f):
  protocol.define_flags(f)
  study_shapes.define_flags(f)


def _choose(tmp_path, *more):
  f = studies.parse(_define, tmp_path, *more)
  return study_shapes.choose(protocol.read_flags(f), shapes=f.shapes, seed=f.study_seed)


def _reconstruct(tmp_path, *more):
  f = studies.parse(_define, tmp_path, *more)
  chosen = study_shapes.choose(protocol.read_flags(f), shapes=f.shapes, seed=f.study_seed)
  return chosen, study_shapes.reconstruct(protocol.read_flags(f), chosen, [f.ours, *f.against])


def test_shapes_are_held_out_and_as_many_as_asked_for(tmp_path):
  made = studies.make_data(tmp_path)
  chosen = _choose(tmp_path, '--shapes=2')
  assert [s.model.category for s in chosen] == ['chair', 'chair', 'ball', 'ball']
  assert len({s.model.id for s in chosen}) == 4
  for s in chosen:
    assert s.model == made.manifest.models[s.row] and s.model.split == 'test'
    assert s.azimuth == made.manifest.azimuths[s.view]
  assert study_shapes.describe(chosen) == '4 shapes: 2 chair, 2 ball'


def test_all_there_are_where_there_are_fewer(tmp_path):
  studies.make_data(tmp_path)
  assert study_shapes.describe(_choose(tmp_path)) == '5 shapes: 3 chair, 2 ball'
  assert study_shapes.describe(_choose(tmp_path, '--category=ball')) == '2 shapes: 2 ball'


def test_the_seed_decides(tmp_path):
  studies.make_data(tmp_path)
  assert _choose(tmp_path, '--study_seed=3') == _choose(tmp_path, '--study_seed=3')
  drawn = {tuple(_choose(tmp_path, f'--study_seed={n}', '--shapes=1')) for n in range(8)}
  assert len(drawn) > 4
  assert len({s.view for some in drawn for s in some}) > 4
  assert {s.model.id for some in drawn for s in some} == {'m0', 'm1', 'm2', 'm3', 'm5'}


def test_no_finished_test_model(tmp_path):
  synthetic.make_dataset(tmp_path / 'data', 2, splits=('train', 'test'), missing=(1,))
  with pytest.raises(UserError, match='no finished model in the split test'):
    _choose(tmp_path)


@pytest.mark.parametrize(
  'wrong, message',
  [
    ('--against=flow,blended_0.2', 'must not name the method of --ours'),
    ('--against=msfcel', 'must be different ones of'),  # has no colours
    ('--against=flow,flow', 'must be different ones of'),
    ('--against=', 'must be different ones of'),
    ('--ours=msfcel', 'ours'),
    ('--seeds=0,1', 'must be one'),
  ],
)
def test_methods_that_cannot_be_compared(tmp_path, wrong, message):
  with pytest.raises(flags.IllegalFlagValueError, match=message):
    studies.parse(_define, tmp_path, wrong)


def test_each_category_is_reconstructed_by_its_own_networks(tmp_path, monkeypatch):
  made = studies.make_data(tmp_path)
  asked = studies.without_networks(monkeypatch)
  chosen, found = _reconstruct(tmp_path, '--seeds=7', '--against=flow')
  found = list(found)
  assert [r.pick for r in found] == chosen
  assert asked == [(m, c, '7') for c in ('chair', 'ball') for m in ('blended_0.2', 'flow')]
  for results in found:
    assert list(results.voxels) == ['blended_0.2', 'flow']
    for method, voxels in results.voxels.items():
      np.testing.assert_array_equal(voxels.color, studies.make_box(method).color)
    model = synthetic.make_record(results.pick.row, image_size=32, grid_size=studies.GRID)
    np.testing.assert_array_equal(results.record.views, model.views)
    assert made.manifest.models[results.pick.row] == results.pick.model


def test_one_network_for_all_is_loaded_once(tmp_path, monkeypatch):
  studies.make_data(tmp_path)
  asked = studies.without_networks(monkeypatch)
  _, found = _reconstruct(tmp_path, '--models=all')
  assert len(list(found)) == 5
  assert asked == [(m, 'all', '0') for m in ('blended_0.2', 'regression', 'flow')]


def test_methods_see_the_chosen_view_alone(tmp_path, monkeypatch):
  studies.make_data(tmp_path)
  seen = []

  def make_predictor(plan, method, category, seed):
    def predict(views):
      seen.append(views)
      return [studies.make_box(method)]

    return predict

  monkeypatch.setattr(protocol, 'make_predictor', make_predictor)
  _, found = _reconstruct(tmp_path, '--models=all', '--against=flow', '--shapes=1')
  for results in found:
    for views in seen:
      np.testing.assert_array_equal(views, results.record.views[[results.pick.view]])
    assert len(seen) == 2
    seen.clear()
