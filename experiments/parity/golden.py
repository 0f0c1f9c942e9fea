"""The format of the golden values, and the rule that redraws inputs and weights.

The authors' program printed the numbers. Nothing large is stored: images, targets and weights
follow from a seed.
"""

import ast
import re
import zipfile
import zlib
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from cvn.camera import IMAGE_SIZE
from cvn.errors import UserError
from cvn.grid import GRID_SIZE, PADDING_INDEX
from cvn.ops.normalization import EPSILON

BATCH = 4
STRIDE = 7  # between the stored voxels of a network's outputs

# The arrays of each file.
OPS = (
  *('msfcel_logits', 'msfcel_target', 'msfcel_loss', 'msfcel_grad'),
  *('color_regressed', 'color_blended', 'color_target', 'color_pred_flow', 'color_target_flow'),
  *('color_loss_l1', 'deconv3d_x', 'deconv3d_kernel_dhw_out_in', 'deconv3d_y'),
  *('conv2d_x', 'conv2d_kernel', 'conv2d_y'),
  *('sampler_image', 'sampler_flow_xy', 'sampler_nearest_color'),
)
NETWORK = ('seed', 'names', 'shapes', 'grad_l2', 'loss_total', 'l1_penalty', 'adam_losses')
SHAPE = (*NETWORK, 'out_logits')
COLOR = (
  *NETWORK,
  *('out_regressed', 'out_confidence_of_regressed', 'out_flow_xy', 'out_blended'),
)
VIEW = (
  *('occupancy', 'regressed', 'confidence_of_regressed', 'flow_xy', 'image'),
  *('iou', 'psnr_rgb', 'psnr_ycbcr'),
)

# The authors' layers and ours; kernels of the first kind are stored [..., out, in].
TRANSPOSED = {
  'Decoding/deconv1': 'trunk/decoder/deconv0',
  'Decoding/deconv2': 'trunk/decoder/deconv1',
  'Decoding/deconv3': 'trunk/decoder/deconv2',
  'Decoding/deconv4': 'head/deconv',
  'Decoding/deconv_reg_clr1': 'regressed/deconv',
  'Decoding/deconv_conf1': 'weight/deconv',
  'Decoding/deconv_flow': 'flow/deconv',
}
PLAIN = {
  **{f'Encoding/conv{i + 1}': f'trunk/encoder/conv{i}' for i in range(6)},
  **{f'Latent_variable/fc{i + 1}': f'trunk/encoder/latent{i}' for i in range(2)},
  'Decoding/deconv5': 'head/conv',
  'Decoding/deconv_reg_clr2': 'regressed/conv',
  'Decoding/conv_conf2': 'weight/conv',
}
VARIABLES = {
  'weights': 'kernel',
  'biases': 'bias',
  'bn/gamma': 'norm/scale',
  'bn/beta': 'norm/bias',
}


def read(path: str, names: Sequence[str] | None) -> dict[str, np.ndarray]:
  """The arrays of a file.

  Args:
    path: the .npz file.
    names: the arrays that it must have; None for those of metrics.npz.

  Raises:
    UserError: the file is missing or unreadable, or it lacks an array.
  """
  try:
    # Opened here because numpy leaks its own handle if the file is damaged.
    with open(path, 'rb') as raw, np.load(raw) as f:
      arrays = {k: f[k] for k in f.files}
  except FileNotFoundError as e:
    raise UserError(f'{path} is missing') from e
  except (OSError, ValueError, EOFError, TypeError, zipfile.BadZipFile, zlib.error) as e:
    raise UserError(f'{path} is not a readable .npz file: {e}') from e
  if names is None:
    found = list_views(arrays)
    if not found:
      raise UserError(f'{path} holds no view: no array is called <model>_v<number>_occupancy')
    names = [f'{model}_gt_color' for model, _ in found]
    names += [f'{model}_{view}_{k}' for model, view in found for k in VIEW]
  for name in names:
    if name not in arrays:
      raise UserError(f'{path} has no array {name}')
  return arrays


def list_views(golden: dict[str, np.ndarray]) -> list[tuple[str, str]]:
  """The pairs (model, view) of metrics.npz."""
  found = (re.fullmatch(r'(\w+)_(v\d+)_occupancy', k) for k in golden)
  return [(m[1], m[2]) for m in found if m]


def draw_input(golden: dict[str, np.ndarray]):
  """The inputs of a network.

  Returns:
    (image [B, H, W, 3] float32, mask [B, X, Y, Z, 1] bool, the generator as it stands now).
  """
  generator = np.random.RandomState(int(golden['seed']) + 7)
  image = generator.rand(BATCH, IMAGE_SIZE, IMAGE_SIZE, 3).astype(np.float32)
  return image, generator.rand(BATCH, *(GRID_SIZE,) * 3, 1) < 0.03, generator


def list_voxels(mask: np.ndarray) -> np.ndarray:
  """The voxels of a mask [B, X, Y, Z, 1] as cvn.data has them, [B, S, 3] int32 and padded."""
  found = [np.argwhere(m[..., 0]) for m in mask]
  index = np.full((len(mask), max(map(len, found)), 3), PADDING_INDEX, np.int32)
  for row, voxels in zip(index, found, strict=True):
    row[: len(voxels)] = voxels
  return index


def at_voxels(volume: np.ndarray, index: np.ndarray) -> np.ndarray:
  """A volume [B, X, Y, Z, C] at the voxels [B, S, 3] of `list_voxels`; 0 where padded."""
  real = index[..., :1] != PADDING_INDEX
  place = np.where(real, index, 0)
  found = np.stack([v[tuple(i.T)] for v, i in zip(volume, place, strict=True)])
  return np.where(real, found, 0)


def draw_params(golden: dict[str, np.ndarray], network_params) -> dict:
  """A network's parameters, drawn by the rule of the authors' variables.

  Args:
    golden: of net_shape.npz or net_color.npz.
    network_params: the network's parameters, for their structure and shapes.

  Raises:
    UserError: the variables do not belong to this network.
  """
  drawn = {}
  for name, shape in zip(golden['names'].tolist(), golden['shapes'].tolist(), strict=True):
    try:
      shape = tuple(int(n) for n in ast.literal_eval(shape))
    except (ValueError, SyntaxError, TypeError) as e:
      raise UserError(f'the golden values have {shape!r} as the shape of {name}') from e
    value = _draw_variable(name, shape, int(golden['seed']))
    drawn[to_path(name)] = value.swapaxes(-1, -2) if _is_transposed(name) else value
  own = flatten(network_params)
  for path in sorted(own.keys() | drawn.keys()):
    theirs, ours = drawn.get(path), own.get(path)
    if theirs is None or ours is None or theirs.shape != ours.shape:
      raise UserError(
        f'{path} is {"missing" if theirs is None else list(theirs.shape)} in the golden values,'
        f' {"missing" if ours is None else list(ours.shape)} in this network'
      )
  return jax.tree_util.tree_map_with_path(lambda path, _: drawn[join(path)], network_params)


def to_path(name: str) -> str:
  """Our name for one of the authors' variables, such as 'trunk/encoder/conv0/kernel'.

  Raises:
    UserError: there is no such variable.
  """
  for ending, own in VARIABLES.items():
    layer = name.removesuffix('/' + ending)
    if layer != name and layer in TRANSPOSED | PLAIN:
      return f'{(TRANSPOSED | PLAIN)[layer]}/{own}'
  raise UserError(f'the golden values have a variable {name!r} that no network here has')


def flatten(params) -> dict[str, jax.Array]:
  """A tree of parameters by their names, 'trunk/encoder/conv0/kernel'."""
  return {join(path): x for path, x in jax.tree_util.tree_leaves_with_path(params)}


def join(path) -> str:
  """A leaf's name."""
  return jax.tree_util.keystr(path, simple=True, separator='/')


def one_by_one_line(volume: jax.Array, params, stats) -> np.ndarray:
  """The effect of the authors' rounding on a volume: [2, C], scale and shift of its logits.

  Their program sums the variance of a channel's 2^20 values in float32, one value after the other,
  which loses 5e-4 to 7e-4 of it. Ours is exact to 1e-6, so the stored volumes of two and three
  channels differ by a factor of 1.0003 in front of the sigmoid. That is next to nothing, but the
  nearest sampler then takes another pixel at one voxel in two hundred. This repeats their sum.

  Args:
    volume: [B, X, Y, Z, C] in (0, 1), ours.
    params: of the layer that made it.
    stats: its batch statistics, ours.
  """
  values = np.asarray(volume, np.float64).reshape(-1, volume.shape[-1])
  scale, bias = (np.asarray(params['norm'][k], np.float64) for k in ('scale', 'bias'))
  mean, variance = (np.asarray(stats['norm'][k], np.float64) for k in ('mean', 'var'))
  deviation = np.sqrt(variance + EPSILON)
  x = ((np.log(values / (1 - values)) - bias) / scale * deviation + mean).astype(np.float32)

  def average(v):  # a cumulative sum, unlike a sum, adds one value after the other
    return np.add.accumulate(v)[-1] / np.float32(len(v))

  their_mean = average(x)
  gain = deviation / np.sqrt(average((x - their_mean) ** 2) + EPSILON)
  offset = bias - gain * (bias + scale * (their_mean - mean) / deviation)
  return np.stack([gain, offset]).astype(np.float32)


def apply_line(volume: jax.Array, line) -> jax.Array:
  """A volume [..., C] in (0, 1) with scale and shift [2, C] applied to its logits."""
  gain, offset = (jnp.reshape(v, (1,) * (volume.ndim - 1) + (-1,)) for v in line)
  return jax.nn.sigmoid(jax.scipy.special.logit(volume) * gain + offset)


def _is_transposed(name):
  return name.endswith('/weights') and name.removesuffix('/weights') in TRANSPOSED


def _draw_variable(name, shape, seed):
  generator = np.random.RandomState((zlib.crc32(name.encode()) + seed) & 0x7FFFFFFF)
  if name.endswith('weights'):
    limit = np.sqrt(6 / (np.prod(shape[:-2]) * (shape[-1] + shape[-2])))
    return generator.uniform(-limit, limit, shape).astype(np.float32)
  return (generator.randn(*shape) * 0.1 + name.endswith('gamma')).astype(np.float32)
