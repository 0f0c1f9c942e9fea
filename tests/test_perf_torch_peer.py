"""The networks in PyTorch are ours, mirrored: the same losses and gradients from the same weights.

PyTorch is no dependency. Without it there is one test, of the message that says how to get it.
"""

import importlib.util
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cvn import train
from cvn.data import Batch
from cvn.grid import GRID_SIZE
from cvn.networks import NETWORKS
from cvn.objectives import OBJECTIVES
from cvn.recipe import PAPER
from experiments.perf import peer

HAS_TORCH = importlib.util.find_spec('torch') is not None


@pytest.mark.skipif(HAS_TORCH, reason='PyTorch is installed')
def test_the_message_without_pytorch():
  done = subprocess.run([sys.executable, str(peer.PROGRAM)], capture_output=True, text=True)
  assert done.returncode == 1
  (line,) = done.stderr.splitlines()
  assert line.startswith('error: PyTorch is missing') and 'pip install torch' in line


def mirrored(kernel, axes):
  """[*size, in, out] -> [out, in, *size], mirrored along the axes of its size."""
  return np.moveaxis(np.flip(kernel, axes), (-1, -2), (0, 1))


def set_weights(network, params):
  """Copies our weights into the layers of PyTorch."""
  import torch

  def put(layer, kernel):
    assert layer.weight.shape == kernel.shape
    layer.weight.data = torch.tensor(np.ascontiguousarray(kernel))

  trunk = params['trunk']
  encoder, decoder = trunk['encoder'], trunk['decoder']
  for i, block in enumerate(network['encoder']):
    put(block[0], mirrored(encoder[f'conv{i}']['kernel'], (0, 1)))
  collect = np.flip(encoder['conv5']['kernel'], (0, 1))  # [4, 4, 256, 512]
  put(network['latent'][0][0], collect.transpose(3, 2, 0, 1).reshape(512, -1))
  put(network['latent'][1][0], encoder['latent0']['kernel'].T)
  code = encoder['latent1']['kernel'].T.reshape(4, 4, 4, 128, 512)
  code = np.flip(code, (0, 1, 2)).transpose(3, 0, 1, 2, 4)
  put(network['latent'][2][0], code.reshape(8192, 512))

  def put_deconv(block, p):
    put(block[0], mirrored(p['kernel'], (0, 1, 2)).swapaxes(0, 1))

  for i, block in enumerate(network['decoder']):
    put_deconv(block, decoder[f'deconv{i}'])
  for name, head in network['heads'].items():
    p = params['head' if name == 'shape' else name]
    if name == 'flow':
      put_deconv(head, p['deconv'])
    else:
      put_deconv(head[0], p['deconv'])
      put(head[1], mirrored(p['conv']['kernel'], (0, 1, 2)))


@pytest.mark.skipif(not HAS_TORCH, reason='PyTorch is not installed')
@pytest.mark.slow
@pytest.mark.parametrize('kind', ['shape', 'color'])
def test_the_losses_of_two_steps_are_equal(kind):
  import torch

  from experiments.perf import torch_peer

  ours = NETWORKS[kind]()
  state = train.create_state(jax.random.key(1), ours)
  step = train.make_step(ours, OBJECTIVES[kind], PAPER)
  theirs = torch_peer.make_batch(3)
  flipped = theirs['image'].flip((2, 3))  # what their network sees as ours sees the image
  index = GRID_SIZE - 1 - theirs['index'].numpy().astype(np.int32)
  arrays = (flipped.permute(0, 2, 3, 1), index, theirs['color'], theirs['flow'])
  batch = Batch(*(jnp.asarray(np.asarray(v)) for v in arrays))
  network = torch_peer.make_network(kind)
  set_weights(network, jax.tree.map(np.asarray, state.params))
  optimizer = torch.optim.Adam(network.parameters(), PAPER.learning_rate)
  for tolerance in (1e-5, 1e-3):  # Adam's first step is of the gradients' signs: small ones differ
    state, found = step(state, batch)
    volumes = torch_peer.compute_volumes(network, theirs['image'], False)
    loss = torch_peer.compute_loss(volumes, theirs | {'image': flipped})
    np.testing.assert_allclose(loss.item(), found['loss'], rtol=tolerance)
    loss.backward()
    optimizer.step()
