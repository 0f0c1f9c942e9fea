"""Training: the state, and the compiled functions that change or evaluate it.

A network is a module of cvn.networks, and an objective one of cvn.objectives: what the network is
trained for. A batch is a `data.ShapeBatch` for shapes, otherwise a `data.Batch`, as stored or
decoded. Every function takes all that it needs and returns all that it changes.
"""

import math
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax
from flax import linen as nn

from cvn import data, layers, objectives, surface
from cvn.networks import ColorNetwork, Trunk
from cvn.objectives import Objective
from cvn.recipe import Recipe, norm_decay


class TrainState(NamedTuple):
  """All that changes from step to step."""

  params: Any
  batch_stats: Any  # running BatchNorm statistics
  opt_state: Any  # of `make_optimizer`, the same for every recipe
  step: jax.Array  # [] int32, steps taken


Metrics = dict[str, jax.Array]  # scalars
Step = Callable[[TrainState, Any], tuple[TrainState, Metrics]]


def create_state(key: jax.Array, network: nn.Module) -> TrainState:
  """The state before the first step: Glorot-uniform kernels, zero biases.

  Args:
    key: for the parameters.
    network: from cvn.networks.
  """
  image = jnp.zeros((1, network.image_size, network.image_size, 3))
  variables = jax.jit(lambda k: network.init(k, image, train=False))(key)
  params = variables['params']
  opt_state = _adam(optax.constant_schedule(0.0)).init(params)
  return TrainState(params, variables['batch_stats'], opt_state, jnp.zeros((), jnp.int32))


def make_optimizer(
  recipe: Recipe, *, batch_size: int, total_samples: float = math.inf
) -> optax.GradientTransformation:
  """Adam with the recipe's learning rate.

  Args:
    recipe: its learning rate and schedule are used.
    batch_size: samples in a step.
    total_samples: of the whole training, for schedules that end with it.
  """
  schedule = recipe.schedule(recipe.learning_rate, total_samples)
  return _adam(lambda step: schedule((step * batch_size).astype(jnp.float32)))


def make_step(
  network: nn.Module,
  objective: Objective,
  recipe: Recipe,
  *,
  total_samples: float = math.inf,
  parts: int = 1,
) -> Step:
  """One optimisation step, compiled; the state that goes in is donated.

  If the loss or a gradient is not finite, the state comes back as it went in.

  Args:
    network: from cvn.networks; its fields choose mixed precision and the layers' implementation.
    objective: from cvn.objectives.
    recipe: loss, learning rate and penalty.
    total_samples: of the whole training, for schedules that end with it.
    parts: of the batch that are computed one after the other, for less memory. Gradients, batch
      statistics and metrics are the means over them; so batch normalisation and MSFCEL see a part
      at a time.

  Returns:
    step(state, batch) -> (state, metrics). The loss is that before the step, and `gradient_norm`
    the Euclidean norm of all gradients.
  """

  def loss(params, batch_stats, batch):
    return _loss(params, batch_stats, batch, network, objective, recipe, True)

  return _compile_step(loss, recipe, total_samples, parts)


def make_surface_step(
  network: ColorNetwork, recipe: Recipe, *, total_samples: float = math.inf, parts: int = 1
) -> Step:
  """`make_step` for the colour network, with its heads computed at surface voxels alone.

  Batch statistics differ from those of `make_step`, see cvn.surface.

  Args:
    network: its fields choose mixed precision and the layers' implementation.
    recipe: loss, learning rate and penalty.
    total_samples: of the whole training, for schedules that end with it.
    parts: of the batch that are computed one after the other, as in `make_step`.

  Returns:
    step(state, batch) -> (state, metrics), as of `make_step`.
  """
  trunk = Trunk(network.image_size, network.grid_size, network.mixed, network.implementation)

  def loss(params, batch_stats, batch):
    return _surface_loss(params, batch_stats, batch, trunk, recipe)

  return _compile_step(loss, recipe, total_samples, parts)


def make_recalibration(network: nn.Module) -> Callable[[TrainState, Iterable[Any]], TrainState]:
  """Batch-norm recalibration: statistics averaged over some batches, with the last parameters.

  Running statistics come from the parameters of many steps. Where these move fast they fit none of
  them, and a network that does well on batches of its own does badly on single views.

  Args:
    network: from cvn.networks.

  Returns:
    recalibrate(state, batches) -> the state with the mean of the batches' statistics.
  """

  @jax.jit
  def statistics(params, batch_stats, batch):
    variables = {'params': params, 'batch_stats': batch_stats}
    image = data.decode(batch).image
    return network.apply(variables, image, train=True, mutable='batch_stats')[1]['batch_stats']

  def recalibrate(state, batches):
    total, count = None, 0
    for batch in batches:
      found = statistics(state.params, state.batch_stats, batch)
      total, count = found if total is None else jax.tree.map(jnp.add, total, found), count + 1
    return state._replace(batch_stats=jax.tree.map(lambda x: x / count, total))

  return recalibrate


def make_eval(
  network: nn.Module, objective: Objective, recipe: Recipe
) -> Callable[[TrainState, Any], Metrics]:
  """The metrics of a batch with running statistics, compiled: the loss, and the IoU of a shape.

  Args:
    network: from cvn.networks.
    objective: from cvn.objectives.
    recipe: loss and penalty.
  """

  def evaluate(state, batch):
    return _loss(state.params, state.batch_stats, batch, network, objective, recipe, False)[1][0]

  return jax.jit(evaluate)


def kernel_sum(params: Any) -> jax.Array:
  """The sum of absolute kernel values: what the authors' program penalises."""
  leaves = jax.tree_util.tree_leaves_with_path(params)
  return sum(jnp.sum(jnp.abs(x)) for path, x in leaves if path[-1].key == 'kernel')


def _adam(schedule):
  return optax.adam(schedule, b1=0.9, b2=0.999, eps=1e-8)


def _compile_step(loss, recipe, total_samples, parts):
  """The step of a loss (params, batch statistics, batch) -> (scalar, (metrics, statistics))."""
  gradient_of = _mean_over_parts(jax.grad(loss, has_aux=True), parts)

  def step(state, batch):
    size = len(batch.image)
    optimizer = make_optimizer(recipe, batch_size=size, total_samples=total_samples)
    gradient, (metrics, batch_stats) = gradient_of(state.params, state.batch_stats, batch)
    with jax.numpy_dtype_promotion('standard'):  # which optax counts on, whatever the caller has
      updates, opt_state = optimizer.update(gradient, state.opt_state)
    params = optax.apply_updates(state.params, updates)
    decay = norm_decay((state.step * size).astype(jnp.float32), size)
    running = jax.tree.map(
      lambda old, new: decay * old + (1 - decay) * new, state.batch_stats, batch_stats
    )
    norm = optax.tree.norm(gradient)
    finite = jnp.isfinite(metrics['loss']) & jnp.isfinite(norm)
    taken = TrainState(params, running, opt_state, state.step + 1)
    kept = jax.tree.map(lambda new, old: jnp.where(finite, new, old), taken, state)
    return kept, {**metrics, 'gradient_norm': norm}

  return jax.jit(step, donate_argnums=0)


def _mean_over_parts(function, parts):
  """function(params, batch statistics, batch) as the mean over that many parts of the batch."""
  if parts == 1:
    return function

  def mean(params, batch_stats, batch):
    # Every parts-th sample: so a part is spread over the devices as the batch is.
    split = jax.tree.map(lambda x: x.reshape(-1, parts, *x.shape[1:]).swapaxes(0, 1), batch)
    first = jax.tree.map(lambda x: x[0], split)
    zeros = jax.tree.map(
      lambda s: jnp.zeros(s.shape, s.dtype),
      jax.eval_shape(function, params, batch_stats, first),
    )

    def add(total, part):
      return jax.tree.map(jnp.add, total, function(params, batch_stats, part)), None

    total, _ = jax.lax.scan(add, zeros, split)
    return jax.tree.map(lambda x: x / parts, total)

  return mean


def _loss(params, batch_stats, batch, network, objective, recipe, train):
  """(loss, (metrics, batch statistics))."""
  batch = data.decode(batch)
  output, mutated = network.apply(
    {'params': params, 'batch_stats': batch_stats}, batch.image, train=train, mutable='batch_stats'
  )
  loss, metrics = objective(output, batch, recipe, train)
  loss = _penalised(loss, params, recipe)
  return loss, ({'loss': loss, **metrics}, mutated['batch_stats'])


def _surface_loss(params, batch_stats, batch, trunk, recipe):
  """(loss, (metrics, batch statistics)) of the colour network in training."""
  batch = data.decode(batch)
  features, mutated = trunk.apply(
    {'params': params['trunk'], 'batch_stats': batch_stats['trunk']},
    batch.image,
    train=True,
    mutable='batch_stats',
  )
  heads = {name: p for name, p in params.items() if name != 'trunk'}

  def heads_loss(capacity, heads, features, batch, near):
    places = surface.find_places(near, batch.index, capacity)
    volumes, statistics = surface.color_heads(heads, features, places, mixed=trunk.mixed)
    loss, terms = objectives.color_at_surface(volumes, batch, places.mask, recipe)
    return loss, (terms, statistics)

  features = layers.materialize(features, implementation=trunk.implementation)
  near = surface.near_cells(batch.index, trunk.grid_size)
  loss, (metrics, statistics) = surface.by_capacity(heads_loss, near, heads, features, batch, near)
  loss = _penalised(loss, params, recipe)
  return loss, ({'loss': loss, **metrics}, {'trunk': mutated['batch_stats'], **statistics})


def _penalised(loss, params, recipe):
  return loss + recipe.kernel_penalty * kernel_sum(params) if recipe.kernel_penalty else loss
