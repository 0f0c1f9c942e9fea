r"""Compares this project with numbers printed by the authors' program.

python -m experiments.parity --golden_dir=DIR

DIR holds ops.npz, net_shape.npz, net_color.npz and metrics.npz (see golden.py). The program prints
one line for each quantity: name, largest error, tolerance, and ok or FAIL. The exit status is 1 if
any quantity fails.

Errors are absolute with three exceptions. Gradient norms and Adam losses are compared relatively,
except for a bias in front of a batch normalisation: it has no effect, so its gradient vanishes.
`blended` is the share of entries that are off by more than 1e-3, because the authors' nearest
sampler jumps where rounding moves a flow across the edge of a pixel. Those jumps would change the
colour network's gradient norms by up to 2 %, so its loss and gradients are computed on volumes with
the authors' rounding (golden.one_by_one_line). Its outputs are compared without that correction,
and so are the Adam steps of both networks: those of cvn.train.make_step, which users run.
"""

import functools
import os
import sys
from collections.abc import Callable, Iterator
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from absl import flags

from cvn import blending, layers, losses, metrics, objectives, sampler, train
from cvn.data import Batch, ShapeBatch
from cvn.errors import UserError
from cvn.grid import ColoredVoxels
from cvn.networks import ColorNetwork, ShapeNetwork
from cvn.objectives import Objective
from cvn.ops import deconv, normalization
from cvn.recipe import RELEASE
from experiments.lib import cli
from experiments.parity import golden as files


class Line(NamedTuple):
  """One compared quantity."""

  name: str
  error: float
  tolerance: float


def define_flags(f: flags.FlagValues) -> None:
  flags.DEFINE_string('golden_dir', None, 'Folder of the golden values.', flag_values=f)
  flags.mark_flags_as_required(['golden_dir'], f)


@cli.program(define_flags)
def main(f: flags.FlagValues) -> int:
  return compare(f.golden_dir)


def compare(folder: str) -> int:
  """Compares everything in a folder of golden values; returns the exit status."""
  checks = (
    ('ops', files.OPS, check_ops),
    ('metrics', None, check_metrics),
    ('net_shape', files.SHAPE, check_shape),
    ('net_color', files.COLOR, check_color),
  )
  # Read all files first, so that a missing one shows at once and not after minutes.
  golden = {name: files.read(os.path.join(folder, f'{name}.npz'), k) for name, k, _ in checks}
  verdicts = [print_line(name, line) for name, _, check in checks for line in check(golden[name])]
  failed = verdicts.count(False)
  print(f'{len(verdicts)} quantities compared, {failed} out of tolerance', file=sys.stderr)
  return int(failed > 0)


def is_good(line: Line) -> bool:
  """Whether the quantity is within its tolerance; NaN is not."""
  return bool(line.error <= line.tolerance)


def print_line(group: str, line: Line) -> bool:
  """Prints one line; returns whether the quantity is within its tolerance."""
  good = is_good(line)
  numbers = f'{line.error:8.2e} {line.tolerance:8.2e}'
  print(f'{group + "/" + line.name:<62} {numbers} {"ok" if good else "FAIL"}', flush=True)
  return good


def check_ops(golden: dict[str, np.ndarray]) -> Iterator[Line]:
  """Losses, convolutions and the sampler, each alone."""

  def line(name, value):
    return Line(name, largest_error(value, golden[name]), 1e-5)

  loss, grad = jax.value_and_grad(losses.msfcel)(golden['msfcel_logits'], golden['msfcel_target'])
  yield line('msfcel_loss', loss)
  yield line('msfcel_grad', grad)
  names = ('regressed', 'blended', 'pred_flow', 'target', 'target_flow')
  color = [golden[f'color_{n}'] for n in names]
  surface = np.all(golden['color_target'] > -0.5, axis=-1)
  yield line(
    'color_loss_l1', losses.color_objective(*color, surface, distance=RELEASE.surface_distance)[0]
  )
  kernel = golden['deconv3d_kernel_dhw_out_in'].swapaxes(-1, -2)
  volume = layers.as_pending(golden['deconv3d_x'])
  yield line('deconv3d_y', deconv.deconv(*volume[:3], kernel, volume.activation)[0])
  # The layer, with a normalisation that changes nothing; its activation is applied to both sides.
  kernel = golden['conv2d_kernel']
  one, zero = np.ones(kernel.shape[-1], np.float32), np.zeros(kernel.shape[-1], np.float32)
  variables = {
    'params': {'kernel': kernel, 'bias': zero, 'norm': {'scale': one, 'bias': zero}},
    'batch_stats': {'norm': {'mean': zero, 'var': one - normalization.EPSILON}},
  }
  layer = layers.Conv2D(kernel.shape[-1], kernel.shape[0])
  value = layer.apply(variables, golden['conv2d_x'], train=False)
  target = normalization.ELU.value(golden['conv2d_y'])
  yield Line('conv2d_y', largest_error(value, target), 1e-5)
  yield line(
    'sampler_nearest_color', sampler.nearest(golden['sampler_image'], golden['sampler_flow_xy'])
  )


def check_metrics(golden: dict[str, np.ndarray]) -> Iterator[Line]:
  """IoU and surface PSNR of predicted volumes, by way of the test-time colours."""
  for model, name in files.list_views(golden):
    view = f'{model}_{name}'
    true_color = golden[f'{model}_gt_color'].astype(np.float32)
    true = ColoredVoxels(np.all(true_color > -0.5, axis=-1), true_color)
    occupancy, regressed, confidence, flow = (
      golden[f'{view}_{k}'].astype(np.float32)[None]
      for k in ('occupancy', 'regressed', 'confidence_of_regressed', 'flow_xy')
    )
    image = golden[f'{view}_image'].astype(np.float32)[None] / 255
    sampled = sampler.nearest_foreground(image, flow, sampler.foreground_from_color(image))
    weight = blending.recalculate_weight(1 - confidence[..., None])
    blended = np.asarray(blending.blend(sampled, regressed, weight))[0]
    iou = metrics.iou(occupancy[0] > 0.8, true.occupancy)
    psnr = metrics.surface_psnr(ColoredVoxels(occupancy[0] >= 0.8, blended), true)
    yield Line(f'{view}_iou', largest_error(iou, golden[f'{view}_iou']), 1e-6)
    yield Line(f'{view}_psnr_rgb', largest_error(psnr.rgb, golden[f'{view}_psnr_rgb']), 1e-3)
    yield Line(f'{view}_psnr_ycbcr', largest_error(psnr.ycbcr, golden[f'{view}_psnr_ycbcr']), 1e-3)


def check_shape(golden: dict[str, np.ndarray]) -> Iterator[Line]:
  """The shape network: outputs, loss, gradients, Adam steps."""
  image, mask, _ = files.draw_input(golden)
  network = ShapeNetwork()
  params = draw_params(golden, network)
  logits, _ = _forward(network, params, image)
  yield from compare_outputs(golden, {'logits': logits})

  def loss(params, image, mask):
    logits, _ = _forward(network, params, image)
    return losses.msfcel(logits, mask)

  yield from check_gradients(golden, params, loss, (image, mask), tolerance=1e-3)
  batch = ShapeBatch(image, files.list_voxels(mask))
  yield from check_steps(golden, network, objectives.shape, params, batch)


def check_color(golden: dict[str, np.ndarray]) -> Iterator[Line]:
  """The colour network: outputs, loss, gradients, Adam steps."""
  image, mask, generator = files.draw_input(golden)
  color = np.where(mask, generator.rand(*mask.shape[:-1], 3), -1).astype(np.float32)
  flow = np.where(mask, generator.rand(*mask.shape[:-1], 2), -1).astype(np.float32)
  network = ColorNetwork()
  params = draw_params(golden, network)
  volumes, stats = _forward(network, params, image)
  blended = blending.blend(RELEASE.sample(image, volumes.flow), volumes.regressed, volumes.weight)
  yield from compare_outputs(
    golden,
    {
      'regressed': volumes.regressed,
      'confidence_of_regressed': 1 - volumes.weight,
      'flow_xy': volumes.flow,
      'blended': blended,
    },
  )

  def loss(params, image, mask, color, flow, lines):
    volumes, _ = _forward(network, params, image)
    regressed = files.apply_line(volumes.regressed, lines[0])
    estimated = files.apply_line(volumes.flow, lines[1])
    blended = blending.blend(RELEASE.sample(image, estimated), regressed, volumes.weight)
    return losses.color_objective(
      regressed, blended, estimated, color, flow, mask[..., 0], distance=RELEASE.surface_distance
    )[0]

  lines = (
    files.one_by_one_line(
      volumes.regressed, params['regressed']['conv'], stats['regressed']['conv']
    ),
    files.one_by_one_line(volumes.flow, params['flow']['deconv'], stats['flow']['deconv']),
  )
  inputs = (image, mask, color, flow, lines)
  yield from check_gradients(golden, params, loss, inputs, tolerance=5e-3)
  index = files.list_voxels(mask)
  batch = Batch(image, index, files.at_voxels(color, index), files.at_voxels(flow, index))
  yield from check_steps(golden, network, objectives.color, params, batch)


def draw_params(golden: dict[str, np.ndarray], network) -> dict:
  """The network's parameters, drawn by the rule of the golden values."""
  image = jnp.zeros((1, network.image_size, network.image_size, 3))
  shapes = jax.eval_shape(lambda: network.init(jax.random.key(0), image, train=False))
  return files.draw_params(golden, shapes['params'])


def compare_outputs(golden: dict[str, np.ndarray], outputs: dict[str, jax.Array]) -> Iterator[Line]:
  """A network's volumes, at the voxels that are stored."""
  for name, output in outputs.items():
    stored = output[(slice(None), *(slice(None, None, files.STRIDE),) * 3)]
    target = golden[f'out_{name}']
    if name == 'blended':
      off = np.abs(np.asarray(stored, np.float64) - target) > 1e-3
      yield Line(f'out_{name}', float(np.mean(off)), 0.02)
    else:
      yield Line(f'out_{name}', largest_error(stored, target), 5e-4)


def check_gradients(
  golden: dict[str, np.ndarray], params, loss: Callable, inputs, *, tolerance: float
) -> Iterator[Line]:
  """Loss, penalty and gradient norms.

  Args:
    golden: the file's arrays.
    params: the network's parameters.
    loss: (params, *inputs) -> the loss without the kernel penalty.
    inputs: image and targets.
    tolerance: relative, of each variable's gradient norm.
  """

  @jax.jit
  def evaluate(params, inputs):
    def total_loss(params):
      penalty = RELEASE.kernel_penalty * train.kernel_sum(params)
      return loss(params, *inputs) + penalty, penalty

    (value, penalty), grads = jax.value_and_grad(total_loss, has_aux=True)(params)
    norms = {k: jnp.sqrt(jnp.sum(g**2)) for k, g in files.flatten(grads).items()}
    return value, penalty, norms

  value, penalty, norms = evaluate(params, inputs)
  yield Line('l1_penalty', largest_error(penalty, golden['l1_penalty']), 5e-4)
  yield Line('loss_total', largest_error(value, golden['loss_total']), 5e-4)
  for name, target in zip(golden['names'].tolist(), golden['grad_l2'], strict=True):
    norm = norms[files.to_path(name)]
    if name.endswith('/biases'):
      yield Line(f'grad_l2/{name}', largest_error(norm, target), 1e-6)
    else:
      yield Line(f'grad_l2/{name}', relative_error(norm, target), tolerance)


def check_steps(
  golden: dict[str, np.ndarray], network, objective: Objective, params, batch
) -> Iterator[Line]:
  """The losses of a few Adam steps, by the step that experiments.train takes.

  Args:
    golden: the file's arrays.
    network: from cvn.networks.
    objective: from cvn.objectives.
    params: the network's parameters.
    batch: image and targets, decoded.
  """
  step = train.make_step(network, objective, RELEASE)
  state = train.create_state(jax.random.key(0), network)._replace(params=params)
  for i, target in enumerate(golden['adam_losses']):
    state, metrics = step(state, batch)
    yield Line(f'adam_losses/{i}', relative_error(metrics['loss'], target), 1e-3)


@functools.partial(jax.jit, static_argnums=0)
def _forward(network, params, image):
  """The network in training mode: (its output, the batch's statistics)."""
  output, new = network.apply({'params': params}, image, train=True, mutable='batch_stats')
  return output, new['batch_stats']


def largest_error(value, target) -> float:
  """The largest absolute difference.

  Raises:
    UserError: the shapes differ.
  """
  value, target = np.asarray(value, np.float64), np.asarray(target, np.float64)
  if value.shape != target.shape:
    raise UserError(f'a golden value of shape {target.shape} meets one of shape {value.shape}')
  return float(np.max(np.abs(value - target)))


def relative_error(value, target) -> float:
  """The difference of two numbers over the second one."""
  return abs(float(value) - float(target)) / max(abs(float(target)), 1e-30)


if __name__ == '__main__':
  main()
