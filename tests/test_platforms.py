"""The same parameters give the same results on a CPU and on an accelerator.

JAX_PLATFORMS=cuda,cpu python -m pytest tests/test_platforms.py

Products are in full float32 ('highest') or as an accelerator does them by default, with factors
rounded to TF32 (11 bits) or bfloat16 (8 bits).
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cvn import data, losses, sampler, train
from cvn.camera import IMAGE_SIZE
from cvn.data import Batch
from cvn.grid import GRID_SIZE, PADDING_INDEX
from cvn.networks import NETWORKS
from cvn.objectives import OBJECTIVES
from cvn.ops import deconv
from cvn.ops.normalization import ELU
from cvn.recipe import PAPER

pytestmark = pytest.mark.skipif(jax.default_backend() == 'cpu', reason='no accelerator here')
SIZE = 4  # views in a batch
VOXELS = 2048


def devices():
  return jax.devices('cpu')[0], jax.devices()[0]


def draw_batch(seed):
  """A ball on a plain ground, and noise for colours and flow, as stored."""
  rng = np.random.default_rng(seed)
  at = np.stack(np.meshgrid(*[np.arange(GRID_SIZE)] * 3, indexing='ij'), -1).reshape(-1, 3)
  distance = np.linalg.norm(at - 31.5, axis=-1)
  index = np.full((SIZE, VOXELS, 3), PADDING_INDEX, np.uint8)
  image = np.zeros((SIZE, IMAGE_SIZE, IMAGE_SIZE, 4), np.uint8)
  rows, columns = np.mgrid[:IMAGE_SIZE, :IMAGE_SIZE] - 63.5
  for n, radius in enumerate((6, 8, 10, 12)):
    shell = at[np.abs(distance - radius) < 0.5][:VOXELS]
    index[n, : len(shell)] = shell
    image[n, np.hypot(rows, columns) < 2 * radius] = [*rng.integers(256, size=3), 255]
  color = rng.integers(256, size=(SIZE, VOXELS, 3), dtype=np.uint8)
  flow = rng.integers(1 << 16, size=(SIZE, VOXELS, 2), dtype=np.uint16)
  return Batch(image, index, color, flow)


@functools.cache
def trained(kind):
  """A state whose statistics are those of batches, as of a trained network, made on the CPU."""
  with jax.default_device(devices()[0]):
    state = train.create_state(jax.random.key(3), NETWORKS[kind]())
    renew = train.make_recalibration(NETWORKS[kind]())
    return jax.tree.map(np.asarray, renew(state, [draw_batch(0), draw_batch(1)]))


def on_both(function, *arrays, precision):
  """function(*arrays) on the CPU and on the accelerator, as NumPy arrays."""
  found = []
  for device in devices():
    with jax.default_device(device), jax.default_matmul_precision(precision):
      result = jax.jit(function)(*jax.device_put(arrays, device))
      assert {d for x in jax.tree.leaves(result) for d in x.devices()} == {device}
      found.append(jax.tree.map(lambda x: np.asarray(x, np.float64), result))
  return found


def difference(got, want):
  """The largest relative error of any array, in the Euclidean norm."""
  errors = jax.tree.map(lambda g, w: np.linalg.norm(g - w) / (np.linalg.norm(w) + 1e-30), got, want)
  return max(jax.tree.leaves(errors))


@pytest.mark.parametrize('precision, tolerance', [('highest', 1e-4), ('default', 2e-2)])
@pytest.mark.parametrize('kind', ['shape', 'color'])
def test_outputs_and_metrics(kind, precision, tolerance):
  state, batch, network = trained(kind), draw_batch(2), NETWORKS[kind]()
  evaluate = train.make_eval(network, OBJECTIVES[kind], PAPER)

  def outputs(state, batch):
    variables = {'params': state.params, 'batch_stats': state.batch_stats}
    return network.apply(variables, data.decode(batch).image, train=False)

  cpu, accelerator = on_both(
    lambda *a: (evaluate(*a), outputs(*a)), state, batch, precision=precision
  )
  print(kind, precision, 'metrics', cpu[0], accelerator[0])
  print(kind, precision, 'largest relative error of a volume', difference(accelerator[1], cpu[1]))
  assert difference(accelerator[1], cpu[1]) < tolerance
  for name, value in cpu[0].items():
    np.testing.assert_allclose(accelerator[0][name], value, rtol=tolerance, err_msg=name)


@pytest.mark.parametrize('precision, tolerance', [('highest', 2e-3), ('default', 1e-1)])
@pytest.mark.parametrize('kind', ['shape', 'color'])
def test_gradients_of_all_parameters(kind, precision, tolerance):
  step = train.make_step(NETWORKS[kind](), OBJECTIVES[kind], PAPER)

  def gradient(state, batch):
    return step(state, batch)[0].opt_state[0].mu  # a tenth of it, after the first step

  cpu, accelerator = on_both(gradient, trained(kind), draw_batch(2), precision=precision)
  flat = [np.concatenate([x.ravel() for x in jax.tree.leaves(g)]) for g in (cpu, accelerator)]
  print(kind, precision, 'relative error of the gradient', difference(flat[1], flat[0]))
  assert difference(flat[1], flat[0]) < tolerance


@pytest.mark.parametrize('name', ['deconv', 'conv'])
@pytest.mark.parametrize('dtype, tolerance', [('float32', 1e-5), ('bfloat16', 1e-2)])
def test_layers_and_their_gradients(name, dtype, tolerance):
  rng = np.random.default_rng(0)
  x, kernel = rng.standard_normal((2, 8, 8, 8, 32)), rng.standard_normal((3, 3, 3, 32, 24)) / 30
  scale, shift = rng.standard_normal((2, 32))

  def run(x, *rest):
    y, sums = getattr(deconv, name)(x.astype(dtype), *rest, ELU)
    return jnp.sum(jnp.sin(y.astype(jnp.float32))) + jnp.sum(jnp.sin(sums / 1000)), y

  def both(*arrays):
    return jax.value_and_grad(run, argnums=(0, 1, 2, 3), has_aux=True)(*arrays)

  arrays = [np.float32(a) for a in (x, scale, shift, kernel)]
  cpu, accelerator = on_both(both, *arrays, precision='highest')
  print(name, dtype, 'largest relative error', difference(accelerator, cpu))
  assert difference(accelerator, cpu) < tolerance


def test_losses_and_samplers():
  rng = np.random.default_rng(0)
  logits, occupied = rng.standard_normal((2, 32, 32, 32)), rng.random((2, 32, 32, 32)) < 0.1
  image, flow = rng.random((2, 64, 64, 3)), rng.uniform(-0.2, 1.2, (2, 500, 2))
  mask = rng.random((2, 500)) < 0.8

  def run(logits, occupied, image, flow, mask):
    def loss(logits, flow):
      sampled = sampler.bilinear_foreground(image, flow)
      return losses.msfcel(logits, occupied) + losses.surface_l2(sampled, sampled[::-1], mask)

    return jax.value_and_grad(loss, (0, 1))(logits, flow), sampler.nearest(image, flow)

  arrays = [np.float32(a) if a.dtype == float else a for a in (logits, occupied, image, flow, mask)]
  cpu, accelerator = on_both(run, *arrays, precision='highest')
  print('losses and samplers', difference(accelerator, cpu))
  assert difference(accelerator, cpu) < 1e-5
