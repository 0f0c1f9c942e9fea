r"""The training step of the shape or the colour network in PyTorch, timed, to compare ours with.

python torch_peer.py --network=shape --batch_size=12 --dtype=float32 [--channels_last] [--compile] \
  [--device=cpu|cuda] [--tf32]

The program stands alone: it needs PyTorch and nothing of this project, and runs in an environment
of its own (`pip install torch numpy`). Its step does what that of cvn.train does with the recipe
`paper`: the same layers, batch statistics, losses at surface voxels alone, and Adam. PyTorch pads
at the other side of an axis, so this network is ours mirrored along every axis of image and volume.
Layers have no bias, because the batch normalisation after each of them would take it out again.

Images are [B, 3, H, W] and volumes [B, C, X, Y, Z], where H = W = 128 and X = Y = Z = 64. The last
line that is printed is 'X images/s', the median of the steps after the first.
"""

import argparse
import statistics
import sys
import time

try:
  import torch
  import torch.nn.functional as F
  from torch import nn
except ImportError as e:
  if __name__ != '__main__':
    raise
  sys.exit(f'error: PyTorch is missing here ({e}): pip install torch numpy')

IMAGE_SIZE, GRID_SIZE = 128, 64
SURFACE_VOXELS = 8192  # a sample's, as in measuring.make_batch
ENCODER = ((3, 64, 7), (64, 64, 5), (64, 128, 5), (128, 128, 3), (128, 256, 3))  # in, out, size
DTYPES = {'float32': torch.float32, 'bfloat16': torch.bfloat16}


def make_network(kind: str) -> nn.ModuleDict:
  """The layers of cvn.networks.

  Args:
    kind: 'shape' or 'color'.
  """
  heads = {
    'shape': lambda: {'shape': _head(24, 1, nn.Identity())},
    'color': lambda: {
      'regressed': _head(16, 3, nn.Sigmoid()),
      'flow': _deconv(32, 2, nn.Sigmoid()),
      'weight': _head(16, 1, nn.Sigmoid()),
    },
  }
  return nn.ModuleDict(
    {
      'encoder': nn.Sequential(*(_conv2d(*sizes) for sizes in ENCODER)),
      'latent': nn.Sequential(_dense(4096, 512), _dense(512, 512), _dense(512, 8192)),
      'decoder': nn.Sequential(_deconv(128, 64), _deconv(64, 32), _deconv(32, 32)),
      'heads': nn.ModuleDict(heads[kind]()),
    }
  )


def make_batch(size: int, seed: int = 0, device: str = 'cpu') -> dict[str, torch.Tensor]:
  """Noise of the shapes that training meets; `index` holds the surface voxels [B, S, 3]."""
  random = torch.Generator().manual_seed(seed)
  batch = {
    'image': torch.rand(size, 3, IMAGE_SIZE, IMAGE_SIZE, generator=random),
    'index': torch.randint(GRID_SIZE, (size, SURFACE_VOXELS, 3), generator=random),
    'color': torch.rand(size, SURFACE_VOXELS, 3, generator=random),
    'flow': torch.rand(size, SURFACE_VOXELS, 2, generator=random),
  }
  return {name: x.to(device) for name, x in batch.items()}


def compute_volumes(
  network: nn.ModuleDict, image: torch.Tensor, channels_last: bool
) -> dict[str, torch.Tensor]:
  """The network's volumes [B, C, X, Y, Z] by the names of their heads.

  Args:
    network: of `make_network`.
    image: [B, 3, H, W].
    channels_last: whether the layers keep the channels innermost in memory.
  """
  code = network['latent'](network['encoder'](image).flatten(1))
  x = code.view(-1, 128, 4, 4, 4)
  if channels_last:
    x = x.contiguous(memory_format=torch.channels_last_3d)
  features = network['decoder'](x)
  return {name: head(features) for name, head in network['heads'].items()}


def compute_loss(volumes: dict[str, torch.Tensor], batch: dict[str, torch.Tensor]) -> torch.Tensor:
  """MSFCEL of a shape (equation 1), or the three colour terms (equation 8)."""
  if 'shape' in volumes:
    return _msfcel(volumes['shape'][:, 0].float(), batch['index'])
  color, flow, weight = (
    _at_surface(volumes[name], batch['index']) for name in ('regressed', 'flow', 'weight')
  )
  grid = 2 * flow[:, :, None] - 1  # [B, S, 1, 2]
  sampled = F.grid_sample(batch['image'], grid, padding_mode='border', align_corners=False)
  sampled = sampled[..., 0].transpose(1, 2)  # [B, 3, S, 1] -> [B, S, 3]
  # The authors' network says how sure it is of the regressed colour: 1 - w.
  blended = (1 - weight) * sampled + weight * color
  return (
    _distance(flow, batch['flow'])
    + _distance(color, batch['color'])
    + _distance(blended, batch['color'])
  )


def time_steps(
  kind: str,
  *,
  batch_size: int,
  dtype: str,
  channels_last: bool = False,
  compiled: bool = False,
  device: str = 'cpu',
  tf32: bool = False,
  steps: int = 5,
) -> list[float]:
  """Seconds of every training step; the first one is not representative.

  On a GPU cuDNN tries its programs for each shape in the first step and keeps the fastest.

  Args:
    kind: 'shape' or 'color'.
    batch_size: views.
    dtype: 'float32', or 'bfloat16' for PyTorch's automatic mixed precision.
    channels_last: whether the layers keep the channels innermost in memory.
    compiled: whether `torch.compile` compiles the network and its loss.
    device: 'cpu' or 'cuda'.
    tf32: whether a GPU may round float32 factors of products to TF32.
    steps: how many there are after the first.
  """
  torch.manual_seed(0)
  torch.backends.cudnn.benchmark = True
  torch.backends.cudnn.allow_tf32 = torch.backends.cuda.matmul.allow_tf32 = tf32
  network, batch = make_network(kind).to(device), make_batch(batch_size, device=device)
  if channels_last:
    batch['image'] = batch['image'].contiguous(memory_format=torch.channels_last)
    for layer in network.modules():
      if isinstance(layer, nn.Conv2d):
        layer.to(memory_format=torch.channels_last)
      if isinstance(layer, nn.Conv3d | nn.ConvTranspose3d):
        layer.to(memory_format=torch.channels_last_3d)
  optimizer = torch.optim.Adam(network.parameters(), 3e-4, fused=True)

  def objective():
    return compute_loss(compute_volumes(network, batch['image'], channels_last), batch)

  if compiled:
    objective = torch.compile(objective)
  seconds = []
  for _ in range(steps + 1):
    start = time.perf_counter()
    optimizer.zero_grad()
    with torch.autocast(device, DTYPES[dtype], enabled=dtype != 'float32'):
      loss = objective()
    loss.backward()
    optimizer.step()
    loss.item()  # waits for all that was asked of the device
    seconds.append(time.perf_counter() - start)
  return seconds


def describe(device: str) -> str:
  """PyTorch's version, and what it computes with."""
  if device == 'cpu':
    where = f'{torch.backends.cpu.get_cpu_capability()}, {torch.get_num_threads()} threads'
  else:
    where = f'{torch.cuda.get_device_name()}, cuDNN {torch.backends.cudnn.version()}'
  return f'PyTorch {torch.__version__}, {where}'


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
  parser.add_argument('--network', choices=('shape', 'color'), default='shape')
  parser.add_argument('--batch_size', type=int, default=12, help='Views in a step.')
  parser.add_argument('--dtype', choices=(*DTYPES,), default='float32')
  parser.add_argument('--channels_last', action='store_true', help='Keep channels innermost.')
  parser.add_argument('--compile', action='store_true', help='Use torch.compile.')
  parser.add_argument('--device', choices=('cpu', 'cuda'), default='cpu')
  parser.add_argument('--tf32', action='store_true', help="Allow a GPU's TF32 products.")
  parser.add_argument('--steps', type=int, default=5, help='Timed steps after the first.')
  a = parser.parse_args()
  if a.batch_size < 2 or a.steps < 1:
    parser.error('--batch_size must be 2 or more and --steps 1 or more')
  first, *seconds = time_steps(
    a.network,
    batch_size=a.batch_size,
    dtype=a.dtype,
    channels_last=a.channels_last,
    compiled=a.compile,
    device=a.device,
    tf32=a.tf32,
    steps=a.steps,
  )
  print(describe(a.device))
  print(f'first step {first:.1f} s')
  print(f'{a.batch_size / statistics.median(seconds):.3f} images/s')


def _conv2d(inputs, outputs, size):
  layer = nn.Conv2d(inputs, outputs, size, 2, (size - 1) // 2, bias=False)
  return nn.Sequential(layer, nn.BatchNorm2d(outputs, eps=1e-3), nn.ELU(inplace=True))


def _dense(inputs, outputs):
  layer = nn.Linear(inputs, outputs, bias=False)
  return nn.Sequential(layer, nn.BatchNorm1d(outputs, eps=1e-3), nn.ELU(inplace=True))


def _deconv(inputs, outputs, activation=None):
  layer = nn.ConvTranspose3d(inputs, outputs, 3, 2, 1, output_padding=1, bias=False)
  return nn.Sequential(layer, nn.BatchNorm3d(outputs, eps=1e-3), activation or nn.ELU(inplace=True))


def _head(hidden, outputs, activation):
  layer = nn.Conv3d(hidden, outputs, 3, 1, 1, bias=False)
  return nn.Sequential(_deconv(32, hidden), layer, nn.BatchNorm3d(outputs, eps=1e-3), activation)


def _msfcel(logits, index):
  """Squared means of the cross-entropy over empty and over occupied voxels of [B, X, Y, Z]."""
  sample = torch.arange(len(index), device=index.device)[:, None].expand(index.shape[:2])
  occupied = torch.zeros(logits.shape, dtype=torch.bool, device=logits.device)
  occupied[sample, index[..., 0], index[..., 1], index[..., 2]] = True
  empty = F.softplus(logits).masked_fill(occupied, 0).sum() / (~occupied).sum()
  full = F.softplus(-logits).masked_fill(~occupied, 0).sum() / occupied.sum()
  return empty**2 + full**2


def _at_surface(volume, index):
  """[B, C, X, Y, Z] at the surface voxels: [B, S, C] float32."""
  sample = torch.arange(len(index), device=index.device)[:, None].expand(index.shape[:2])
  return volume[sample, :, index[..., 0], index[..., 1], index[..., 2]].float()


def _distance(prediction, target):
  """Mean Euclidean distance over surface voxels; no gradient where it is 0."""
  squared = (prediction - target).square().sum(-1)
  positive = squared > 0
  return torch.where(positive, torch.where(positive, squared, 1).sqrt(), 0).mean()


if __name__ == '__main__':
  main()
