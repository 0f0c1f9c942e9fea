"""The comparison with the authors' numbers, and that it can fail."""

import os
import shutil

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import linen as nn

from cvn.data import Batch
from cvn.errors import UserError
from cvn.networks import ColorNetwork, ShapeNetwork
from experiments.parity import __main__ as parity
from experiments.parity import golden

DIR = os.environ.get(
  'CVN_GOLDEN_DIR', os.path.join(os.path.dirname(__file__), '../../shared/golden')
)
needs_golden = pytest.mark.skipif(
  not os.path.isdir(DIR), reason="the authors' numbers are not there (CVN_GOLDEN_DIR)"
)
CHEAP = {'ops': golden.OPS, 'metrics': None}


def _read(name, spec):
  return golden.read(os.path.join(DIR, f'{name}.npz'), spec)


def _failures(lines):
  return [line.name for line in lines if not parity.is_good(line)]


@needs_golden
def test_every_quantity_of_the_folder_agrees(capsys):
  assert parity.compare(DIR) == 0
  lines = [line.split() for line in capsys.readouterr().out.splitlines()]
  assert all(len(line) == 4 and line[3] == 'ok' for line in lines)
  assert all(float(error) <= float(tolerance) for _, error, tolerance, _ in lines)
  names = {line[0] for line in lines}
  assert len(names) == len(lines)
  ops = ('msfcel_loss', 'msfcel_grad', 'color_loss_l1', 'deconv3d_y', 'conv2d_y')
  assert {f'ops/{x}' for x in (*ops, 'sampler_nearest_color')} <= names
  for view in golden.list_views(_read('metrics', None)):
    assert {f'metrics/{"_".join(view)}_{x}' for x in ('iou', 'psnr_rgb', 'psnr_ycbcr')} <= names
  for net, spec in (('net_shape', golden.SHAPE), ('net_color', golden.COLOR)):
    arrays = _read(net, spec)
    assert {f'{net}/{k}' for k in arrays if k.startswith('out_')} <= names
    assert {f'{net}/grad_l2/{k}' for k in arrays['names']} <= names
    assert {f'{net}/adam_losses/{i}' for i in range(4)} <= names
    assert {f'{net}/loss_total', f'{net}/l1_penalty'} <= names


@needs_golden
@pytest.mark.parametrize(
  'key', ['msfcel_loss', 'msfcel_grad', 'color_loss_l1', 'deconv3d_y', 'sampler_nearest_color']
)
def test_a_wrong_operation_fails(key):
  arrays = _read('ops', golden.OPS)
  value = arrays[key].copy()
  value[(-1,) * value.ndim] += 1e-3
  assert _failures(parity.check_ops(arrays | {key: value})) == [key]
  value[(-1,) * value.ndim] = np.nan
  assert _failures(parity.check_ops(arrays | {key: value})) == [key]


@needs_golden
def test_another_kernel_layout_fails():
  arrays = _read('ops', golden.OPS)
  for key, bad in (('conv2d_kernel', 'conv2d_y'), ('deconv3d_kernel_dhw_out_in', 'deconv3d_y')):
    flipped = arrays | {key: arrays[key][::-1]}
    assert _failures(parity.check_ops(flipped)) == [bad]


@needs_golden
def test_a_wrong_metric_fails():
  arrays = _read('metrics', None)
  view = '_'.join(golden.list_views(arrays)[0])
  for key, by in (('iou', 2e-6), ('psnr_rgb', 2e-3), ('psnr_ycbcr', -2e-3)):
    wrong = arrays | {f'{view}_{key}': arrays[f'{view}_{key}'] + by}
    assert _failures(parity.check_metrics(wrong)) == [f'{view}_{key}']


@needs_golden
def test_a_failure_is_printed_and_is_the_exit_status(tmp_path, monkeypatch, capsys):
  for name in ('ops', 'metrics', 'net_shape', 'net_color'):
    shutil.copy(os.path.join(DIR, f'{name}.npz'), tmp_path)
  arrays = dict(np.load(tmp_path / 'ops.npz'))
  np.savez(tmp_path / 'ops.npz', **arrays | {'msfcel_loss': arrays['msfcel_loss'] * 1.01})
  monkeypatch.setattr(parity, 'check_shape', lambda golden: iter(()))
  monkeypatch.setattr(parity, 'check_color', lambda golden: iter(()))
  assert parity.compare(tmp_path) == 1
  out, err = capsys.readouterr()
  (failed,) = [line.split() for line in out.splitlines() if line.endswith('FAIL')]
  assert failed[0] == 'ops/msfcel_loss' and failed[2] == '1.00e-05'
  assert float(failed[1]) == pytest.approx(0.01 * arrays['msfcel_loss'], rel=0.01)
  assert '1 out of tolerance' in err


def _small(seed=0, steps=2):
  """Golden values of one layer: weight [2, 3] and bias [3]."""
  names = np.array(['Encoding/conv1/weights', 'Encoding/conv1/biases'])
  return {
    'seed': np.int64(seed),
    'names': names,
    'shapes': np.array(['[2, 3]', '[3]']),
    'grad_l2': np.ones(2),
    'loss_total': np.float32(0),
    'l1_penalty': np.float32(0),
    'adam_losses': np.ones(steps, np.float32),
  }


def _gradients(arrays):
  params = {'trunk': {'encoder': {'conv0': {'kernel': np.zeros((2, 3)), 'bias': np.zeros(3)}}}}
  params = golden.draw_params(arrays, params)

  def loss(params, target):
    layer = params['trunk']['encoder']['conv0']
    # The bias has no effect, as in front of a normalisation.
    return ((layer['kernel'] - target) ** 2).sum() + 0 * layer['bias'].sum()

  lines = parity.check_gradients(arrays, params, loss, (np.ones((2, 3)),), tolerance=1e-3)
  return params['trunk']['encoder']['conv0']['kernel'], {line.name: line for line in lines}


def test_gradients_against_a_closed_form():
  kernel, lines = _gradients(_small())
  penalty = 1e-5 * np.abs(kernel).sum()
  gradient = 2 * (kernel - 1) + 1e-5 * np.sign(kernel)
  right = _small() | {
    'l1_penalty': np.float32(penalty),
    'loss_total': np.float32(((kernel - 1) ** 2).sum() + penalty),
    'grad_l2': np.array([np.linalg.norm(gradient), 0]),
  }
  _, lines = _gradients(right)
  assert list(lines) == [
    'l1_penalty',
    'loss_total',
    'grad_l2/Encoding/conv1/weights',
    'grad_l2/Encoding/conv1/biases',
  ]
  assert _failures(lines.values()) == []
  for place in (0, 1):
    wrong = right['grad_l2'].copy()
    wrong[place] = wrong[place] * 1.002 + 2e-6
    _, found = _gradients(right | {'grad_l2': wrong})
    assert len(_failures(found.values())) == 1
  for key in ('l1_penalty', 'loss_total'):
    _, found = _gradients(right | {key: right[key] + np.float32(1e-3)})
    assert _failures(found.values()) == [key]


class _Constant(nn.Module):
  """A network whose output is its only parameter."""

  image_size: int = 1

  @nn.compact
  def __call__(self, image, *, train):
    self.variable('batch_stats', 'mean', jnp.zeros, (1,))
    return self.param('kernel', nn.initializers.ones, (2, 3))


def test_steps_against_a_closed_form():
  kernel = np.random.default_rng(0).uniform(0.1, 0.9, (2, 3)).astype(np.float32)

  def losses():
    at = kernel.astype(np.float64)
    for _ in range(2):
      yield ((at - 1) ** 2).sum() + 1e-5 * np.abs(at).sum()
      at = at + 3e-4  # Adam's first step is one of the learning rate against the gradient's sign

  def check(expected):
    batch = Batch(np.zeros((1, 1, 1, 3), np.float32), None, None, None)
    arrays = {'adam_losses': np.array([*expected], np.float32)}
    objective = lambda output, *_: (((output - 1) ** 2).sum(), {})  # noqa: E731
    params = {'kernel': jnp.asarray(kernel)}
    return [*parity.check_steps(arrays, _Constant(), objective, params, batch)]

  lines = check(losses())
  assert [line.name for line in lines] == ['adam_losses/0', 'adam_losses/1']
  assert max(line.error for line in lines) < 1e-6
  first, second = losses()
  assert _failures(check([first, second * 1.002])) == ['adam_losses/1']


def test_voxels_of_a_mask_come_as_in_a_batch():
  mask = np.zeros((2, 4, 4, 4, 1), bool)
  mask[0, 1, 2, 3], mask[0, 2, 0, 0], mask[1, 3, 3, 3] = True, True, True
  index = golden.list_voxels(mask)
  assert index.tolist() == [[[1, 2, 3], [2, 0, 0]], [[3, 3, 3], [255, 255, 255]]]
  volume = np.arange(2 * 64 * 2, dtype=np.float32).reshape(2, 4, 4, 4, 2)
  found = golden.at_voxels(volume, index)
  np.testing.assert_array_equal(found[0, 0], volume[0, 1, 2, 3])
  np.testing.assert_array_equal(found[1], [volume[1, 3, 3, 3], [0, 0]])


def test_outputs_are_compared_at_the_stored_voxels():
  volume = np.random.default_rng(0).random((4, 64, 64, 64, 3), np.float32)
  stored = volume[:, ::7, ::7, ::7].copy()
  arrays = {'out_regressed': stored, 'out_blended': stored.copy()}

  def compare():
    outputs = {'regressed': volume, 'blended': volume}
    return _failures(parity.compare_outputs(arrays, outputs))

  assert compare() == []
  arrays['out_blended'].ravel()[: stored.size // 50] += 0.5  # 2 %
  assert compare() == []
  arrays['out_blended'].ravel()[: stored.size // 50 + 1] += 0.5
  arrays['out_regressed'][3, 9, 9, 9, 2] += 6e-4
  assert compare() == ['out_regressed', 'out_blended']


@needs_golden
@pytest.mark.parametrize(
  'network, name, spec',
  [(ShapeNetwork(), 'net_shape', golden.SHAPE), (ColorNetwork(), 'net_color', golden.COLOR)],
)
def test_every_parameter_has_its_golden_variable(network, name, spec):
  arrays = _read(name, spec)
  params = parity.draw_params(arrays, network)
  assert len(golden.flatten(params)) == len(arrays['names'])
  drawn = golden.flatten(params)['trunk/decoder/deconv1/kernel']
  assert drawn.shape == (3, 3, 3, 64, 32)
  limit = np.sqrt(6 / (27 * 96))
  assert 0.99 * limit < np.abs(drawn).max() <= limit
  renamed = arrays | {'names': np.char.replace(arrays['names'], 'fc1', 'fc7')}
  with pytest.raises(UserError, match="'Latent_variable/fc7/weights'"):
    parity.draw_params(renamed, network)
  fewer = arrays | {k: arrays[k][:-1] for k in ('names', 'shapes')}
  with pytest.raises(UserError, match='missing in the golden values'):
    parity.draw_params(fewer, network)


def test_the_authors_rounding_is_a_sum_of_one_value_after_the_other():
  rng = np.random.default_rng(0)
  x = (0.3 * rng.standard_normal((4, 32, 32, 32, 2)) + (0.1, -0.2)).astype(np.float32)
  scale, bias = np.array([1.1, 0.9]), np.array([0.05, -0.1])
  stats = {'mean': x.mean((0, 1, 2, 3), np.float64), 'var': x.var((0, 1, 2, 3), np.float64)}

  def volume(mean, variance):
    return 1 / (1 + np.exp(-((x - mean) / np.sqrt(variance + 1e-3) * scale + bias)))

  total = np.zeros(2, np.float32)
  for v in x.reshape(-1, 2):
    total += v
  mean = total / np.float32(x[..., 0].size)
  total = np.zeros(2, np.float32)
  for v in x.reshape(-1, 2):
    total += (v - mean) ** 2
  theirs = volume(mean, total / np.float32(x[..., 0].size))
  ours = volume(stats['mean'], stats['var'])
  layer = {'norm': {'scale': scale, 'bias': bias}}
  line = golden.one_by_one_line(ours, layer, {'norm': stats})
  assert np.abs(ours - theirs).max() > 2e-6
  with jax.enable_x64(True):
    found = golden.apply_line(ours, line.astype(np.float64))
  np.testing.assert_allclose(found, theirs, atol=3e-7)


@needs_golden
@pytest.mark.parametrize('name, spec', CHEAP.items())
def test_garbled_files_are_named(tmp_path, name, spec):
  path = str(tmp_path / f'{name}.npz')
  with pytest.raises(UserError, match=rf'{name}\.npz is missing'):
    golden.read(path, spec)
  with open(os.path.join(DIR, f'{name}.npz'), 'rb') as f:
    content = f.read()
  for bad in (b'', b'no archive', content[: len(content) // 2]):
    with open(path, 'wb') as f:
      f.write(bad)
    with pytest.raises(UserError, match=rf'{name}\.npz is not a readable \.npz file'):
      golden.read(path, spec)
  flipped = bytearray(content)
  flipped[len(content) // 2] ^= 0xFF
  with open(path, 'wb') as f:
    f.write(flipped)
  with pytest.raises(UserError, match=rf'{name}\.npz'):
    golden.read(path, spec)


@needs_golden
@pytest.mark.parametrize('name, spec', CHEAP.items())
def test_a_missing_array_is_named(tmp_path, name, spec):
  path = tmp_path / f'{name}.npz'
  arrays = dict(np.load(os.path.join(DIR, f'{name}.npz')))
  # Without occupancy a view does not exist.
  key = next(k for k in arrays if not k.endswith('_occupancy'))
  np.savez(path, **{k: v for k, v in arrays.items() if k != key})
  with pytest.raises(UserError, match=f'has no array {key}'):
    golden.read(str(path), spec)


def test_files_of_objects_and_of_no_view_are_refused(tmp_path):
  path = str(tmp_path / 'metrics.npz')
  np.savez(path, m0_gt_color=np.array([{}], dtype=object))
  with pytest.raises(UserError, match='not a readable'):
    golden.read(path, None)
  with open(path, 'wb') as f:
    np.save(f, np.zeros(3))
  with pytest.raises(UserError, match='not a readable'):
    golden.read(path, None)
  np.savez(path, m0_gt_color=np.zeros(3))
  with pytest.raises(UserError, match='holds no view'):
    golden.read(path, None)


def test_a_missing_folder_is_named(tmp_path):
  with pytest.raises(UserError, match=r'nowhere/ops\.npz is missing'):
    parity.compare(tmp_path / 'nowhere')
