"""The training program, with networks of a few numbers in place of the real ones."""

import json
import os
import re
import signal
import subprocess
import sys
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
import synthetic
from absl import flags

from cvn import checkpoint, data, files, grid, infer, losses, objectives
from cvn.errors import UserError
from cvn.recipe import RELEASE, cosine
from experiments import train as program
from experiments.lib import cli, training


class TrainState(NamedTuple):
  params: Any
  batch_stats: Any
  opt_state: Any
  step: Any


def create_state(key, network):
  del network
  params = {'w': jax.random.normal(key, (3,))}
  return TrainState(params, {'mean': jnp.zeros(3)}, optax.adam(1.0).init(params), jnp.int32(0))


def loss_of(params, batch):
  """Depends on which models and views are in the batch."""
  batch = data.decode(batch)
  pixel = batch.image.mean((1, 2))
  count = (batch.index[..., 0] != grid.PADDING_INDEX).sum(1, dtype=jnp.float32)
  return jnp.mean((pixel @ params['w'] - count / 1e4) ** 2)


def make_step(network, objective, recipe, *, total_samples, parts=1):
  del network, objective, total_samples, parts
  optimizer = optax.adam(recipe.learning_rate)

  @jax.jit
  def step(state, batch):
    loss, gradient = jax.value_and_grad(loss_of)(state.params, batch)
    with jax.numpy_dtype_promotion('standard'):  # as in cvn.train
      update, opt_state = optimizer.update(gradient, state.opt_state)
    params = optax.apply_updates(state.params, update)
    mean = 0.9 * state.batch_stats['mean'] + 0.1 * data.decode(batch).image.mean((0, 1, 2))
    return TrainState(params, {'mean': mean}, opt_state, state.step + 1), {'loss': loss}

  return step


def make_surface_step(network, recipe, **options):
  return make_step(network, None, recipe, **options)


def make_eval(network, objective, recipe):
  del network, recipe
  extra = {'iou': jnp.float32(0.5)} if objective is objectives.shape else {}
  return jax.jit(lambda state, batch: {'loss': loss_of(state.params, batch), **extra})


@pytest.fixture(autouse=True)
def small_networks(request, monkeypatch):
  if request.node.get_closest_marker('slow'):
    return
  for f in (create_state, make_step, make_surface_step, make_eval):
    monkeypatch.setattr(program.train, f.__name__, f)
  monkeypatch.setattr(program, 'draw_views', lambda *_: np.zeros((8, 8, 3), np.uint8))


@pytest.fixture(scope='module')
def made(tmp_path_factory):
  """Eight models to train on, two each to validate and to test; tests have four devices."""
  root = tmp_path_factory.mktemp('data') / 'set'
  synthetic.make_dataset(root, 12, azimuths=(0, 90))
  return root


def run(made, workdir, *arguments, network='shape', epochs=2):
  return program.main(
    [
      f'--network={network}',
      f'--data={made}',
      f'--workdir={workdir}',
      f'--epochs={epochs}',
      '--batch_size=4',
      '--validate_every=1',
      '--log_every=3',
      '--dtype=float32',
      *arguments,
    ]
  )


def log_of(workdir):
  return [json.loads(line) for line in (workdir / 'log.jsonl').read_text().splitlines()]


def arrays_of(workdir):
  """The newest checkpoint, all of it."""
  template = jax.tree.map(jnp.zeros_like, create_state(jax.random.key(0), None))
  return checkpoint.restore(str(workdir), template)


def interrupt_at(monkeypatch, step, number=signal.SIGTERM):
  """The signal arrives while this step is computed."""

  def make(*args, **kwargs):
    inner = make_step(*args, **kwargs)

    def outer(state, batch):
      if int(state.step) == step - 1:
        os.kill(os.getpid(), number)
      return inner(state, batch)

    return outer

  monkeypatch.setattr(program.train, 'make_step', make)


@pytest.mark.parametrize('network', ['shape', 'color'])
def test_trains(made, tmp_path, network):
  assert run(made, tmp_path / 'run', network=network) == 0
  log = log_of(tmp_path / 'run')
  # Two steps an epoch; a line each 3 steps and at the end of an epoch, then the validation.
  assert [(line['step'], 'validation' in line) for line in log] == [
    (2, False),
    (2, True),
    (3, False),
    (4, False),
    (4, True),
  ]
  assert [line['epoch'] for line in log] == [1, 1, 1.5, 2, 2]
  assert set(log[1]['validation']) == ({'loss', 'iou'} if network == 'shape' else {'loss'})
  config, variables = checkpoint.load_network(str(tmp_path / 'run'), network)
  assert (config['batch_size'], config['models'], config['learning_rate']) == (4, 8, 3e-4)
  assert variables['params']['w'].shape == (3,)
  assert os.listdir(tmp_path / 'run' / 'tensorboard')


def test_a_line_is_the_mean_since_the_line_before(made, tmp_path):
  run(made, tmp_path / 'a', '--log_every=1')
  run(made, tmp_path / 'b', '--log_every=100')
  each = [line['loss'] for line in log_of(tmp_path / 'a') if 'loss' in line]
  means = [line['loss'] for line in log_of(tmp_path / 'b') if 'loss' in line]
  assert means == [np.mean(each[:2]), np.mean(each[2:])]


def test_seed_decides(made, tmp_path):
  for name, seed in (('a', 0), ('b', 0), ('c', 1)):
    run(made, tmp_path / name, f'--seed={seed}')
  a, b, c = ((tmp_path / name / 'log.jsonl').read_bytes() for name in 'abc')
  assert a == b != c


@pytest.mark.parametrize('at', [1, 2])
def test_resumed_equals_uninterrupted(made, tmp_path, monkeypatch, at):
  run(made, tmp_path / 'whole')
  with monkeypatch.context() as m:
    interrupt_at(m, at)
    assert run(made, tmp_path / 'parts') == 128 + signal.SIGTERM
  assert checkpoint.latest_step(str(tmp_path / 'parts')) == at
  assert run(made, tmp_path / 'parts') == 0
  whole, parts = (tmp_path / name / 'log.jsonl' for name in ('whole', 'parts'))
  assert parts.read_bytes() == whole.read_bytes()
  expected, progress = arrays_of(tmp_path / 'whole')
  got, got_progress = arrays_of(tmp_path / 'parts')
  jax.tree.map(np.testing.assert_array_equal, got, expected)
  assert got_progress == progress


def test_resumed_after_a_crash_between_checkpoints(made, tmp_path, monkeypatch):
  """Lines past the last checkpoint are told again, not twice."""
  run(made, tmp_path / 'whole', '--checkpoint_every=0')
  saved = checkpoint.save

  def save_until_2(workdir, state, progress):
    if int(state.step) > 2:
      raise RuntimeError('crash')
    saved(workdir, state, progress)

  with monkeypatch.context() as m:
    m.setattr(checkpoint, 'save', save_until_2)
    with pytest.raises(RuntimeError):
      run(made, tmp_path / 'parts', '--checkpoint_every=0')
  assert log_of(tmp_path / 'parts')[-1]['step'] == 3
  run(made, tmp_path / 'parts', '--checkpoint_every=0')
  whole, parts = (tmp_path / name / 'log.jsonl' for name in ('whole', 'parts'))
  assert parts.read_bytes() == whole.read_bytes()


def test_more_epochs_go_on(made, tmp_path, capsys):
  run(made, tmp_path / 'whole', epochs=3)
  run(made, tmp_path / 'parts', epochs=1)
  run(made, tmp_path / 'parts', epochs=3)
  whole, parts = (tmp_path / name / 'log.jsonl' for name in ('whole', 'parts'))
  assert parts.read_bytes() == whole.read_bytes()
  capsys.readouterr()
  before = parts.read_bytes()
  assert run(made, tmp_path / 'parts', epochs=3) == 0
  assert 'is trained for 3 epochs: raise --epochs' in capsys.readouterr().out
  assert parts.read_bytes() == before


def test_interrupt_says_how_to_go_on_and_gives_the_handlers_back(
  made, tmp_path, monkeypatch, capsys
):
  before = signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)
  interrupt_at(monkeypatch, 1, signal.SIGINT)
  assert run(made, tmp_path / 'run') == 128 + signal.SIGINT
  assert 'the same command continues from here' in capsys.readouterr().err
  assert (signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)) == before


def test_second_interrupt_ends_at_once(made, tmp_path, monkeypatch, request):
  def impatient(*args, **kwargs):
    signal.raise_signal(signal.SIGINT)

  # As in a terminal: a shell starts what runs in the background with SIGINT ignored.
  before = signal.signal(signal.SIGINT, signal.default_int_handler)
  request.addfinalizer(lambda: signal.signal(signal.SIGINT, before))
  interrupt_at(monkeypatch, 1, signal.SIGINT)
  monkeypatch.setattr(checkpoint, 'save', impatient)
  with pytest.raises(KeyboardInterrupt):
    run(made, tmp_path / 'run')


def test_empty_validation_split_is_said(tmp_path, capsys):
  root = tmp_path / 'set'
  synthetic.make_dataset(root, 4, splits=('train',), azimuths=(0,))
  assert run(root, tmp_path / 'run', epochs=1) == 0
  assert 'no finished model in the split val' in capsys.readouterr().err
  assert not any('validation' in line for line in log_of(tmp_path / 'run'))


def test_nan_stops_and_is_not_saved(made, tmp_path, monkeypatch):
  def make(*args, **kwargs):
    inner = make_step(*args, **kwargs)

    def outer(state, batch):
      state, metrics = inner(state, batch)
      return state, jax.tree.map(lambda x: jnp.where(state.step < 3, x, jnp.nan), metrics)

    return outer

  monkeypatch.setattr(program.train, 'make_step', make)
  with pytest.raises(UserError, match='loss became nan at step 3'):
    run(made, tmp_path / 'run', '--checkpoint_every=0')
  assert checkpoint.latest_step(str(tmp_path / 'run')) == 2


@pytest.mark.parametrize(
  ('changed', 'name'),
  [
    ('--batch_size=8', 'batch_size'),
    ('--recipe=release', 'recipe'),
    ('--dtype=mixed', 'dtype'),
    ('--seed=3', 'seed'),
  ],
)
def test_another_setting_is_refused(made, tmp_path, changed, name):
  run(made, tmp_path / 'run', epochs=1)
  with pytest.raises(UserError, match=f'was made with {name}='):
    run(made, tmp_path / 'run', changed)


def test_the_other_network_in_the_workdir_is_refused(made, tmp_path):
  run(made, tmp_path / 'run', epochs=1)
  with pytest.raises(UserError, match='was made with network=shape, not color'):
    run(made, tmp_path / 'run', network='color')


def test_fewer_epochs_than_there_are_is_an_error(made, tmp_path):
  run(made, tmp_path / 'run', epochs=2)
  with pytest.raises(UserError, match='was trained for epochs=2, not 1: ask for more --epochs'):
    run(made, tmp_path / 'run', epochs=1)


def test_the_configuration_is_known_before_the_run(made, tmp_path):
  run(made, tmp_path / 'run', '--learning_rate=0.01', '--recipe=best', '--dtype=mixed', epochs=1)
  stored = checkpoint.read_config(str(tmp_path / 'run'))
  named = {'network': 'shape', 'data': made, 'workdir': 'elsewhere', 'epochs': 1, 'batch_size': 4}
  asked = training.configuration(**named, learning_rate=0.01, recipe='best', dtype='mixed')
  assert stored == {'format': checkpoint.FORMAT, **asked}
  assert (stored['recipe'], stored['sample'], stored['schedule']) == (
    'best',
    'foreground',
    'cosine',
  )
  assert (stored['learning_rate'], stored['mirror'], stored['epochs']) == (0.01, True, 1)
  assert stored['counts'] == {'ball (synthetic)': 8} and stored['models'] == 8


def test_statistics_are_taken_anew_at_the_end_and_for_validation(made, tmp_path, monkeypatch):
  renewed = []

  def make_recalibration(_):
    def renew(state, batches):
      images = np.concatenate([data.decode(b).image for b in batches])
      renewed.append(len(images))
      return state._replace(batch_stats={'mean': images.mean((0, 1, 2))})

    return renew

  monkeypatch.setattr(program.train, 'make_recalibration', make_recalibration)
  run(made, tmp_path / 'run', '--fresh_statistics=3', '--validate_every=1', epochs=2)
  assert renewed == [12, 12]
  dataset = program.open_dataset(str(made))
  batches = data.training_batches(
    data.read_shape, dataset, data.select_rows(dataset, 'train'), batch_size=4, seed=0
  )
  _, variables = checkpoint.load_network(str(tmp_path / 'run'), 'shape')
  expected = np.concatenate([data.decode(batches[n]).image for n in range(3)]).mean((0, 1, 2))
  np.testing.assert_allclose(variables['batch_stats']['mean'], expected, rtol=1e-5)


def test_flags_change_the_recipe():
  def make(**named):
    f = cli.parse(training.define_flags, network='shape', data='D', workdir='W', **named)
    return training.make_recipe(training.read_flags(f))

  recipe = make(recipe='release', learning_rate=0.5, schedule='cosine')
  assert recipe == RELEASE._replace(learning_rate=0.5, schedule=cosine)
  recipe = make(mirror=True, shape_loss='cross_entropy', surface_distance='l1')
  assert recipe.mirror and recipe.shape_loss is losses.cross_entropy
  assert recipe.surface_distance is losses.surface_l1


def test_a_schedule_that_ends_is_for_one_number_of_epochs(made, tmp_path):
  run(made, tmp_path / 'run', '--schedule=cosine', epochs=1)
  with pytest.raises(UserError, match='was made with epochs=1, not 2'):
    run(made, tmp_path / 'run', '--schedule=cosine', epochs=2)


@pytest.mark.parametrize('dtype', training.DTYPES)
def test_auto_is_the_faster_type_and_a_resumed_run_keeps_it(
  made, tmp_path, monkeypatch, capsys, dtype
):
  monkeypatch.setattr(training.native, 'faster_dtype', lambda: (dtype, '3 ms are less than 4 ms'))
  run(made, tmp_path / 'run', '--dtype=auto', epochs=1)
  assert checkpoint.read_config(str(tmp_path / 'run'))['dtype'] == dtype
  assert f'--dtype=auto is {dtype}: 3 ms are less than 4 ms' in capsys.readouterr().out
  # Another machine, where the other type is faster.
  (other,) = {*training.DTYPES} - {dtype}
  monkeypatch.setattr(training.native, 'faster_dtype', lambda: (other, ''))
  assert run(made, tmp_path / 'run', '--dtype=auto', epochs=2) == 0
  assert f'--dtype=auto is {dtype}: the run in {tmp_path / "run"}' in capsys.readouterr().out
  with pytest.raises(UserError, match=f'dtype={dtype}, not {other}'):
    run(made, tmp_path / 'run', f'--dtype={other}', epochs=3)


@pytest.mark.parametrize('dtype', training.DTYPES)
@pytest.mark.parametrize(
  ('heads', 'name'), [('dense', 'make_step'), ('surface', 'make_surface_step')]
)
def test_dtype_and_heads_reach_the_step(made, tmp_path, monkeypatch, dtype, heads, name):
  asked = []

  def make(network, *args, **kwargs):
    asked.append(network.mixed)
    return make_step(network, None, args[-1], **kwargs)

  monkeypatch.setattr(program.train, name, make)
  run(made, tmp_path / 'run', f'--dtype={dtype}', f'--heads={heads}', network='color', epochs=1)
  assert asked == [dtype == 'mixed']


def test_shapes_have_no_surface_heads(made, tmp_path):
  with pytest.raises(UserError, match='--heads=surface is for --network=color'):
    run(made, tmp_path / 'run', '--heads=surface')
  assert not (tmp_path / 'run').exists()


def test_too_few_models(made, tmp_path):
  with pytest.raises(UserError, match='8 finished training models, too few for a batch of 60'):
    run(made, tmp_path / 'run', '--batch_size=60')
  assert not (tmp_path / 'run').exists()


def test_data_of_another_size(tmp_path):
  synthetic.make_dataset(tmp_path / 'set', 1, azimuths=(0,), image_size=64, grid_size=32)
  with pytest.raises(UserError, match='has 64-pixel views and a grid of 32'):
    run(tmp_path / 'set', tmp_path / 'run')


def test_unknown_category(made, tmp_path):
  with pytest.raises(UserError, match="no category 'cube'; it has ball"):
    run(made, tmp_path / 'run', '--category=cube')


def test_out_of_memory(made, tmp_path, monkeypatch):
  def make(*args, **kwargs):
    def step(state, batch):
      raise jax.errors.JaxRuntimeError('RESOURCE_EXHAUSTED: Out of memory allocating 9 bytes')

    return step

  monkeypatch.setattr(program.train, 'make_step', make)
  with pytest.raises(
    UserError, match='too little memory: take a larger --parts, or a smaller --batch'
  ):
    run(made, tmp_path / 'run')


def test_a_learning_rate_must_be_a_positive_number(made, tmp_path):
  for bad in ('-1', '0', 'nan', 'inf'):
    with pytest.raises(flags.Error, match='learning_rate'):
      run(made, tmp_path / 'run', f'--learning_rate={bad}')


def test_validation_is_whole_batches_where_it_can_be(made):
  dataset = program.open_dataset(str(made))

  def count(batch_size, maximum=120):
    options = {'batch_size': batch_size, 'maximum': maximum}
    return len(program.choose_views(dataset, np.arange(2), **options))

  assert (count(3), count(4), count(60)) == (3, 4, 4)
  assert (count(2, maximum=3), count(2, maximum=1)) == (2, 1)


def test_a_batch_that_does_not_divide_is_refused(made, tmp_path):
  with pytest.raises(UserError, match=r'batch of 6 .* over 4 devices: take --batch_size=4 or 8'):
    run(made, tmp_path / 'run', '--batch_size=6')
  with pytest.raises(UserError, match='4 devices and 2 parts: take --batch_size=8'):
    run(made, tmp_path / 'run', '--parts=2')
  assert not (tmp_path / 'run').exists()


def test_the_workdir_alone_continues_the_run(made, tmp_path, capsys):
  run(made, tmp_path / 'whole', '--log_every=2', '--seed=3', epochs=3)
  run(made, tmp_path / 'parts', '--log_every=2', '--seed=3', epochs=2)
  alone = f'--workdir={tmp_path / "parts"}'
  assert program.main([alone]) == 0
  assert 'is trained for 2 epochs' in capsys.readouterr().out
  assert program.main([alone, '--epochs=3']) == 0
  whole, parts = (tmp_path / name / 'log.jsonl' for name in ('whole', 'parts'))
  assert parts.read_bytes() == whole.read_bytes()
  with pytest.raises(UserError, match='was made with seed=3, not 4'):
    program.main([alone, '--seed=4'])


def test_sessions_say_how_the_run_was_started(made, tmp_path):
  run(made, tmp_path / 'run', epochs=1)
  run(made, tmp_path / 'run', epochs=2)
  lines = [json.loads(x) for x in (tmp_path / 'run' / 'sessions.jsonl').read_text().splitlines()]
  assert [(x['step'], x['settings']['epochs']) for x in lines] == [(0, 1), (2, 2)]
  assert lines[0]['versions']['jax'] == jax.__version__
  assert lines[0]['devices'] == '4 x cpu' and lines[0]['processes'] == 1


def test_a_new_workdir_needs_a_network_and_data(tmp_path):
  with pytest.raises(UserError, match='holds no run to continue: name --network and --data'):
    program.main([f'--workdir={tmp_path / "new"}'])


def test_a_second_run_in_the_workdir_is_refused(made, tmp_path):
  run(made, tmp_path / 'run', epochs=1)
  with files.exclusive(str(tmp_path / 'run')):
    with pytest.raises(UserError, match=f'is in use by process {os.getpid()} on'):
      run(made, tmp_path / 'run', epochs=2)
  assert run(made, tmp_path / 'run', epochs=2) == 0


def flip_a_byte(folder):
  """In the largest file below a folder."""
  path = max((p for p in folder.rglob('*') if p.is_file()), key=lambda p: p.stat().st_size)
  content = bytearray(path.read_bytes())
  content[len(content) // 2] ^= 255
  path.write_bytes(content)


def test_the_checkpoint_before_a_damaged_one_on_demand(made, tmp_path, caplog):
  run(made, tmp_path / 'whole', '--checkpoint_every=0')
  run(made, tmp_path / 'parts', '--checkpoint_every=0', epochs=1)
  flip_a_byte(tmp_path / 'parts' / 'checkpoints' / '2')
  with pytest.raises(UserError, match=r'is damaged .*--restore=last_good'):
    run(made, tmp_path / 'parts', '--checkpoint_every=0')
  run(made, tmp_path / 'parts', '--checkpoint_every=0', '--restore=last_good')
  assert 'is damaged' in caplog.text and 'continues from step 1' in caplog.text
  assert (tmp_path / 'parts' / 'damaged-2').is_dir()
  whole, parts = (tmp_path / name / 'log.jsonl' for name in ('whole', 'parts'))
  assert parts.read_bytes() == whole.read_bytes()
  jax.tree.map(
    np.testing.assert_array_equal, arrays_of(tmp_path / 'parts'), arrays_of(tmp_path / 'whole')
  )


def test_a_step_that_was_not_finite_is_computed_again(made, tmp_path, monkeypatch, capsys):
  def make(*args, **kwargs):
    inner = make_step(*args, **kwargs)

    @jax.jit
    def outer(state, batch):
      new, metrics = inner(state, batch)
      bad = state.step == 2
      kept = jax.tree.map(lambda n, o: jnp.where(bad, o, n), new, state)
      return kept, {'loss': jnp.log(jnp.where(bad, -1.0, 1.0)) + metrics['loss']}

    return outer

  monkeypatch.setattr(program.train, 'make_step', make)
  with pytest.raises(UserError, match=r'loss became nan at step 3.*\((m\d+ at (0|90)[, ]*){4}\)'):
    run(made, tmp_path / 'run', '--log_every=1')
  capsys.readouterr()
  assert program.main([f'--workdir={tmp_path / "run"}', '--replay']) == 0
  out = capsys.readouterr().out
  assert 'step 3: loss nan' in out and 'first in: ' in out
  assert len(re.findall(r'm\d+ at (?:0|90) alone: iou 0.5, loss [0-9]', out)) == 4
  assert 'parameters: the largest is' in out


def test_nothing_to_replay(made, tmp_path):
  run(made, tmp_path / 'run', epochs=1)
  with pytest.raises(UserError, match='no loss of this training was ever not finite'):
    program.main([f'--workdir={tmp_path / "run"}', '--replay'])


def test_program_prints_one_line(tmp_path):
  done = subprocess.run(
    [
      sys.executable,
      '-m',
      'experiments.train',
      '--network=shape',
      f'--data={tmp_path}',
      f'--workdir={tmp_path}/run',
    ],
    capture_output=True,
    text=True,
    check=False,
  )
  assert done.returncode == 1
  assert re.fullmatch(r'error: .* is no data set: .*\n', done.stderr)


@pytest.mark.slow
@pytest.mark.parametrize(
  ('network', 'recipe', 'dtype'), [('shape', 'paper', 'mixed'), ('color', 'release', 'float32')]
)
def test_the_real_networks_resume_exactly(made, tmp_path, network, recipe, dtype):
  """Four steps, and two and two, with validation and pictures; any dtype's network can be used."""
  chosen = f'--recipe={recipe}', f'--dtype={dtype}'
  run(made, tmp_path / 'whole', *chosen, network=network, epochs=2)
  run(made, tmp_path / 'parts', *chosen, network=network, epochs=1)
  run(made, tmp_path / 'parts', *chosen, network=network, epochs=2)
  whole, parts = (tmp_path / name / 'log.jsonl' for name in ('whole', 'parts'))
  assert parts.read_bytes() == whole.read_bytes()
  _, expected = checkpoint.load_network(str(tmp_path / 'whole'), network)
  _, got = checkpoint.load_network(str(tmp_path / 'parts'), network)
  jax.tree.map(np.testing.assert_array_equal, got, expected)
  loaded = infer.load(str(tmp_path / 'parts'), network)
  estimated = infer.reconstruct(np.zeros((1, 128, 128, 4), np.float32), **{network: loaded})
  assert all(np.isfinite(x).all() for x in jax.tree.leaves(estimated))
