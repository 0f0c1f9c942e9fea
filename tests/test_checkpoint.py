"""A run's folder: what is saved comes back bit for bit, and what is wrong is told in one line."""

import json
import os
import shutil
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from jax.sharding import AxisType, NamedSharding, PartitionSpec

from cvn import checkpoint
from cvn.errors import UserError

CONFIG = {'network': 'shape', 'recipe': 'paper', 'learning_rate': 3e-4, 'category': ['chair']}


class TrainState(NamedTuple):
  params: Any
  batch_stats: Any
  opt_state: Any
  step: Any


def make_state(step, seed=0):
  a, b, c = (jax.random.normal(k, (3, 5)) for k in jax.random.split(jax.random.key(seed), 3))
  params = {'trunk': {'conv0': {'kernel': a}}, 'head': {'bias': b[0]}}
  opt_state = optax.adam(1e-3).init(params)
  return TrainState(params, {'trunk': {'norm': {'mean': c}}}, opt_state, jnp.int32(step))


def assert_equal(got, expected):
  assert jax.tree.structure(got) == jax.tree.structure(expected)
  jax.tree.map(np.testing.assert_array_equal, got, expected)


@pytest.fixture
def workdir(tmp_path):
  path = str(tmp_path / 'run')
  checkpoint.start(path, CONFIG)
  return path


def test_round_trip(workdir):
  state, progress = make_state(7), {'iterator': {'next_index': 7}, 'pending': [{'loss': 0.1}]}
  checkpoint.save(workdir, state, progress)
  got, got_progress = checkpoint.restore(workdir, make_state(0, seed=1))
  assert isinstance(got, TrainState)
  assert_equal(got, state)
  assert got_progress == progress


def test_nothing_to_restore(workdir):
  assert checkpoint.latest_step(workdir) is None
  assert checkpoint.restore(workdir, make_state(0)) is None


def test_the_newest_is_restored_and_the_latest_two_are_kept(workdir):
  for step in (9, 10, 100):
    checkpoint.save(workdir, make_state(step, seed=step), {})
  assert sorted(os.listdir(f'{workdir}/checkpoints'), key=int) == ['10', '100']
  got, _ = checkpoint.restore(workdir, make_state(0))
  assert_equal(got, make_state(100, seed=100))


def test_half_written_checkpoint_is_ignored_and_goes_with_the_next_save(workdir):
  checkpoint.save(workdir, make_state(1), {})
  left = f'{workdir}/checkpoints/2.orbax-checkpoint-tmp'
  shutil.copytree(f'{workdir}/checkpoints/1', left)
  os.unlink(f'{left}/_CHECKPOINT_METADATA')
  assert checkpoint.latest_step(workdir) == 1
  assert checkpoint.load_network(workdir, 'shape')
  checkpoint.save(workdir, make_state(3), {})
  assert sorted(os.listdir(f'{workdir}/checkpoints')) == ['1', '3']


def test_restores_to_the_template_s_devices(workdir):
  mesh = jax.make_mesh((4,), ('batch',), axis_types=(AxisType.Auto,))
  everywhere = NamedSharding(mesh, PartitionSpec())
  checkpoint.save(workdir, jax.device_put(make_state(5), everywhere), {})
  one, _ = checkpoint.restore(workdir, make_state(0))
  assert_equal(one, make_state(5))
  assert len(one.params['head']['bias'].devices()) == 1
  four, _ = checkpoint.restore(workdir, jax.device_put(make_state(0), everywhere))
  assert_equal(four, make_state(5))
  assert len(four.params['head']['bias'].devices()) == 4


def test_load_network(workdir):
  state = make_state(5)
  checkpoint.save(workdir, state, {})
  config, variables = checkpoint.load_network(workdir, 'shape')
  assert config['recipe'] == 'paper'
  assert_equal(variables, {'params': state.params, 'batch_stats': state.batch_stats})
  assert all(isinstance(x, np.ndarray) for x in jax.tree.leaves(variables))


def test_load_network_of_the_other_kind(workdir):
  with pytest.raises(UserError, match='holds a shape network, a color one is needed'):
    checkpoint.load_network(workdir, 'color')


def test_load_network_before_the_first_checkpoint(workdir):
  with pytest.raises(UserError, match='no checkpoint yet'):
    checkpoint.load_network(workdir, 'shape')


def test_load_network_where_nothing_is(tmp_path):
  with pytest.raises(UserError, match='is no training folder'):
    checkpoint.load_network(str(tmp_path), 'shape')
  (tmp_path / 'file').write_text('')
  with pytest.raises(UserError, match='is no training folder'):
    checkpoint.load_network(str(tmp_path / 'file'), 'shape')


def damage(workdir, step, keep):
  """Cuts every file of a checkpoint to `keep` bytes, or removes them."""
  for folder, _, names in os.walk(f'{workdir}/checkpoints/{step}'):
    for name in names:
      path = os.path.join(folder, name)
      os.truncate(path, keep) if keep is not None else os.unlink(path)


@pytest.mark.parametrize('keep', [0, 20, None])
def test_damaged_checkpoint(workdir, keep):
  checkpoint.save(workdir, make_state(5), {})
  damage(workdir, 5, keep)
  with pytest.raises(UserError, match=r'checkpoints/5 is damaged \(.+\): --restore=last_good'):
    checkpoint.load_network(workdir, 'shape')
  with pytest.raises(UserError, match=r'checkpoints/5 is damaged \(.+\): --restore=last_good'):
    checkpoint.restore(workdir, make_state(0))


def test_the_way_out_of_a_damaged_checkpoint_works(workdir):
  checkpoint.save(workdir, make_state(4), {})
  checkpoint.save(workdir, make_state(5), {})
  damage(workdir, 5, 0)
  shutil.rmtree(f'{workdir}/checkpoints/5')
  assert_equal(checkpoint.restore(workdir, make_state(0))[0], make_state(4))


def test_the_optimiser_of_another_version_is_no_damage(workdir):
  checkpoint.save(workdir, make_state(5), {})
  template = make_state(0)
  other = optax.adam(optax.constant_schedule(1e-3)).init(template.params)
  with pytest.raises(UserError, match=r'checkpoints/5 was written by another version: its network'):
    checkpoint.restore(workdir, template._replace(opt_state=other))
  assert checkpoint.load_network(workdir, 'shape')


def test_place_that_cannot_be_written(workdir):
  with open(f'{workdir}/checkpoints', 'w'):
    pass
  with pytest.raises(UserError, match=r'cannot write a checkpoint to .*/checkpoints: .+'):
    checkpoint.save(workdir, make_state(1), {})


def test_full_disk(workdir, monkeypatch):
  def full(*args, **kwargs):
    raise OSError(28, 'No space left on device')

  monkeypatch.setattr(checkpoint.ocp.training.Checkpointer, 'save_checkpointables', full)
  with pytest.raises(UserError, match=r'cannot write a checkpoint .* No space left on device'):
    checkpoint.save(workdir, make_state(1), {})


def test_starting_again_with_the_same_settings(workdir):
  checkpoint.start(workdir, CONFIG)
  assert checkpoint.read_config(workdir) == {'format': checkpoint.FORMAT, **CONFIG}


@pytest.mark.parametrize(
  ('name', 'value'),
  [('network', 'color'), ('learning_rate', 1e-3), ('category', []), ('batch_size', 4)],
)
def test_starting_again_with_another_setting_names_it(workdir, name, value):
  with pytest.raises(UserError, match=f'made with {name}='):
    checkpoint.start(workdir, {**CONFIG, name: value})
  assert checkpoint.read_config(workdir)['learning_rate'] == 3e-4


def test_data_may_move_and_must_not_change(workdir):
  config = {**CONFIG, 'data': '/a', 'data_digest': 'abc'}
  checkpoint.compare(workdir, config, {**config, 'data': '/b'})
  with pytest.raises(UserError, match=r'data_digest=abc \(/a\), not abd \(/b\)'):
    checkpoint.compare(workdir, config, {**config, 'data': '/b', 'data_digest': 'abd'})


@pytest.mark.parametrize('text', ['', '{"format": 1', '\x00\x01'])
def test_config_that_is_not_json(workdir, text):
  with open(f'{workdir}/config.json', 'w') as f:
    f.write(text)
  with pytest.raises(UserError, match=r'config\.json is damaged: it is not JSON'):
    checkpoint.read_config(workdir)


@pytest.mark.parametrize('config', [[], {}, {'format': 99}])
def test_config_of_another_format(workdir, config):
  with open(f'{workdir}/config.json', 'w') as f:
    json.dump(config, f)
  with pytest.raises(UserError, match='not of format 1'):
    checkpoint.start(workdir, CONFIG)


def test_workdir_that_is_a_file(tmp_path):
  (tmp_path / 'file').write_text('')
  with pytest.raises(UserError, match='cannot write'):
    checkpoint.start(str(tmp_path / 'file'), CONFIG)
