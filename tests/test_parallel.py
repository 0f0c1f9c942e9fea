"""One training on several devices and processes: the same numbers as on one device."""

import json
import os
import pathlib
import signal
import socket
import subprocess
import sys
import time

import jax
import numpy as np
import pytest
import synthetic

from cvn import checkpoint, data, parallel, train
from cvn.errors import UserError
from cvn.networks import NETWORKS
from cvn.objectives import OBJECTIVES
from cvn.recipe import PAPER

SIZES = {'image_size': 32, 'grid_size': 16}
PROGRAM = pathlib.Path(__file__).with_name('train_small.py')


@pytest.fixture(scope='module')
def made(tmp_path_factory):
  """Sixteen models to train on, four each to validate and to test."""
  root = tmp_path_factory.mktemp('data') / 'set'
  synthetic.make_dataset(root, 24, azimuths=(0, 90), capacity=1024, **SIZES)
  return root


@pytest.fixture(scope='module')
def losses(made):
  """devices -> the losses of three steps, gradient norms, and the state's digest."""
  dataset = data.dataset_lib.open_dataset(str(made))
  rows = data.select_rows(dataset, 'train')
  batches = data.training_batches(data.read_color, dataset, rows, batch_size=8, seed=0)
  network = NETWORKS['color'](**SIZES)
  step, found = train.make_step(network, OBJECTIVES['color'], PAPER), {}
  for count in (1, 2, 4):
    placement = parallel.make_placement(devices=jax.devices()[:count])
    state = parallel.put_whole(placement, train.create_state(jax.random.key(0), network))
    found[count] = []
    for n in range(3):
      batch = parallel.put_batch(placement, batches[n])
      assert len(batch.image.devices()) == count
      state, metrics = step(state, batch)
      found[count].append([float(metrics['loss']), float(metrics['gradient_norm'])])
  return found


@pytest.mark.parametrize('devices', [2, 4])
def test_losses_and_gradients_are_those_of_one_device(losses, devices):
  np.testing.assert_allclose(losses[devices][0], losses[1][0], rtol=1e-5)
  # Adam's first steps take the gradients' signs: rounding decides some that are nearly 0.
  loss, expected = (np.array(losses[n])[:, 0] for n in (devices, 1))
  np.testing.assert_allclose(loss, expected, rtol=1e-3)


def test_a_batch_that_does_not_divide():
  assert parallel.local_batch(8) == 8 and parallel.local_batch(8, parts=2) == 8
  with pytest.raises(UserError, match=r'batch of 2 cannot .* 4 devices: take --batch_size=4'):
    parallel.local_batch(2)


@pytest.mark.parametrize(
  'given',
  [
    {'coordinator': 'h:1', 'num_processes': 2},
    {'num_processes': 2, 'process_id': 0},
    {'coordinator': 'h:1', 'process_id': 0},
  ],
)
def test_the_arguments_of_a_process_go_together(given):
  with pytest.raises(UserError, match='go together'):
    parallel.connect(**given)


def test_one_process_joins_nobody():
  parallel.connect(num_processes=1)
  parallel.connect(num_processes=1, process_id=0)
  assert parallel.is_first() and parallel.broadcast('text') == 'text' and parallel.agree(True)
  parallel.check_equal({'a': np.ones(3)}, 'the state')


def test_parts_of_a_batch_have_the_mean_gradient(made):
  """Of one part after the other, each with its own batch statistics."""
  dataset = data.dataset_lib.open_dataset(str(made))
  rows = data.select_rows(dataset, 'train')
  batch = data.training_batches(data.read_color, dataset, rows, batch_size=8, seed=0)[0]
  network, objective = NETWORKS['color'](**SIZES), OBJECTIVES['color']

  def gradient(batch, parts):
    step = train.make_step(network, objective, PAPER, parts=parts)
    state, metrics = step(train.create_state(jax.random.key(0), network), batch)
    return jax.tree.map(lambda m: np.asarray(m) / 0.1, state.opt_state[0].mu), metrics

  whole, metrics = gradient(batch, 2)
  halves = [gradient(jax.tree.map(lambda x, n=n: x[n::2], batch), 1) for n in (0, 1)]
  mean = jax.tree.map(lambda a, b: (a + b) / 2, halves[0][0], halves[1][0])
  difference = jax.tree.map(lambda a, b: np.linalg.norm(a - b), whole, mean)
  size = np.linalg.norm([np.linalg.norm(x) for x in jax.tree.leaves(mean)])
  assert max(jax.tree.leaves(difference)) < 1e-4 * size
  np.testing.assert_allclose(metrics['loss'], np.mean([m['loss'] for _, m in halves]), rtol=1e-5)


def start(
  made, workdir, *, count=1, devices=1, epochs=2, learning_rate=3e-4, number=None, port=None
):
  """Starts a process of a training: all of it, or one of `count`."""
  command = [sys.executable, str(PROGRAM), '--network=shape', f'--data={made}']
  command += [f'--workdir={workdir}', f'--epochs={epochs}', '--batch_size=4', '--dtype=float32']
  command += ['--learning_rate=1e-5']  # Adam turns rounding of small gradients into whole steps
  command += ['--validate_every=1', '--log_every=1', '--checkpoint_every=0']
  command += [f'--learning_rate={learning_rate}']
  if count > 1:
    command += [f'--coordinator=localhost:{port}', f'--num_processes={count}']
    command += [f'--process_id={number}']
  variables = {'JAX_NUM_CPU_DEVICES': str(devices), 'JAX_PLATFORMS': 'cpu'}
  variables['PYTHONPATH'] = str(PROGRAM.parent.parent)
  return subprocess.Popen(
    command,
    env=os.environ | variables,
    stdout=subprocess.PIPE,
    stderr=subprocess.STDOUT,
    text=True,
    cwd=PROGRAM.parent.parent,
  )


def start_all(made, workdir, **options):
  with socket.socket() as s:
    s.bind(('localhost', 0))
    port = s.getsockname()[1]
  return [start(made, workdir, count=2, number=n, port=port, **options) for n in (0, 1)]


def finish(*processes, status=0):
  outputs = [p.communicate(timeout=600)[0] for p in processes]
  assert [p.returncode for p in processes] == [status] * len(processes), '\n'.join(outputs)
  return outputs


def numbers(workdir):
  lines = [json.loads(x) for x in (workdir / 'log.jsonl').read_text().splitlines()]
  return [line.get('loss') or line['validation']['loss'] for line in lines]


def arrays(workdir):
  return checkpoint.load_network(str(workdir), 'shape')[1]


def test_two_processes_train_as_two_devices_of_one(made, tmp_path):
  """At a small learning rate: Adam takes signs, so that rounding grows fivefold a step at 3e-4."""
  slow = {'epochs': 1, 'learning_rate': 1e-6}
  outputs = finish(*start_all(made, tmp_path / 'two', **slow))
  finish(start(made, tmp_path / 'one', devices=2, **slow))
  assert [o.count('steps 0 to 4 of 4') for o in outputs] == [1, 0]
  np.testing.assert_allclose(numbers(tmp_path / 'two'), numbers(tmp_path / 'one'), rtol=1e-5)
  # Checkpoints move between numbers of processes.
  finish(start(made, tmp_path / 'two', devices=1, **slow | {'epochs': 2}))
  assert checkpoint.latest_step(str(tmp_path / 'two')) == 8


def wait_for_step(workdir, step):
  deadline = time.monotonic() + 300
  while (checkpoint.latest_step(str(workdir)) or 0) < step:
    assert time.monotonic() < deadline
    time.sleep(0.05)


@pytest.mark.slow
@pytest.mark.parametrize('victim', [0, 1])
def test_one_that_is_killed_ends_all_and_the_same_command_goes_on(made, tmp_path, victim):
  finish(*start_all(made, tmp_path / 'whole', epochs=4))
  processes = start_all(made, tmp_path / 'parts', epochs=4)
  wait_for_step(tmp_path / 'parts', 3)
  processes[victim].kill()
  for p in processes:
    p.communicate(timeout=300)
    assert p.returncode != 0
  finish(*start_all(made, tmp_path / 'parts', epochs=4))
  jax.tree.map(
    np.testing.assert_array_equal, arrays(tmp_path / 'parts'), arrays(tmp_path / 'whole')
  )
  whole, parts = (tmp_path / name / 'log.jsonl' for name in ('whole', 'parts'))
  assert parts.read_bytes() == whole.read_bytes()


@pytest.mark.slow
def test_sigterm_to_one_stops_all_after_the_same_step(made, tmp_path):
  finish(*start_all(made, tmp_path / 'whole', epochs=4))
  processes = start_all(made, tmp_path / 'parts', epochs=4)
  wait_for_step(tmp_path / 'parts', 2)
  processes[1].send_signal(signal.SIGTERM)
  outputs = finish(*processes, status=128 + signal.SIGTERM)
  assert 'the same command continues from here' in outputs[0]
  finish(*start_all(made, tmp_path / 'parts', epochs=4))
  jax.tree.map(
    np.testing.assert_array_equal, arrays(tmp_path / 'parts'), arrays(tmp_path / 'whole')
  )
