"""Training: the state, and one compiled step for each network.

`kind` is a key of `networks.NETWORKS`; cvn.objectives says what each is trained for. A batch is a
`data.ShapeBatch` for shapes, else a `data.Batch`, as stored or decoded. All that a step needs comes
in, all that it changes goes out.
"""

import math
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax

from cvn import data, layers, networks, objectives, surface
from cvn.networks import Trunk
from cvn.recipe import Recipe, norm_decay

NETWORKS = {kind: network() for kind, network in networks.NETWORKS.items()}

_ADAM = optax.scale_by_adam(b1=0.9, b2=0.999, eps=1e-8)


class TrainState(NamedTuple):
  """All that changes from step to step."""

  params: Any
  batch_stats: Any  # running BatchNorm statistics
  opt_state: Any  # Adam's moments
  step: jax.Array  # [] int32, steps taken


def create_state(key: jax.Array, kind: str) -> TrainState:
  """The state before the first step: Glorot-uniform kernels, zero biases.

  Args:
    key: of the parameters.
    kind: of network.
  """
  network = NETWORKS[kind]
  image = jnp.zeros((1, network.image_size, network.image_size, 3))
  variables = jax.jit(lambda k: network.init(k, image, train=False))(key)
  params = variables['params']
  return TrainState(params, variables['batch_stats'], _ADAM.init(params), jnp.zeros((), jnp.int32))


def make_step(
  kind: str,
  recipe: Recipe,
  *,
  samples: float = math.inf,
  mixed: bool = False,
  implementation: str = 'auto',
) -> Callable[[TrainState, Any], tuple[TrainState, dict[str, jax.Array]]]:
  """One optimisation step, compiled; the state that goes in is donated.

  Args:
    kind: of network.
    recipe: loss, schedules, penalty.
    samples: of the whole training, for schedules that end with it.
    mixed: whether products are of bfloat16 numbers.
    implementation: of the network's layers, see cvn/ops/dispatch.py.

  Returns:
    step(state, batch) -> (state, metrics): scalars, the loss before the step among them.
  """

  network = NETWORKS[kind].clone(mixed=mixed, implementation=implementation)

  def objective(params, batch_stats, batch):
    return _objective(params, batch_stats, batch, network, kind, recipe, True)

  return _compile_step(objective, recipe, samples)


def make_surface_step(
  recipe: Recipe, *, samples: float = math.inf, mixed: bool = False
) -> Callable[[TrainState, Any], tuple[TrainState, dict[str, jax.Array]]]:
  """The same for the colour network, its heads computed at surface voxels alone.

  Batch statistics differ from `make_step`'s, see cvn.surface.
  """
  color = NETWORKS['color']
  trunk = Trunk(color.image_size, color.grid_size, mixed)

  def objective(params, batch_stats, batch):
    return _surface_objective(params, batch_stats, batch, trunk, recipe)

  return _compile_step(objective, recipe, samples)


def _compile_step(objective, recipe, total):
  """The step of an objective (params, batch statistics, batch) -> (loss, (metrics, statistics))."""

  def step(state, batch):
    samples = (state.step * len(batch.image)).astype(jnp.float32)
    rate = recipe.learning_rate * recipe.schedule(samples, total)
    decay = norm_decay(samples, len(batch.image))
    (_, (found, batch_stats)), gradient = jax.value_and_grad(objective, has_aux=True)(
      state.params, state.batch_stats, batch
    )
    update, opt_state = _ADAM.update(gradient, state.opt_state)
    params = jax.tree.map(lambda p, u: p - rate * u, state.params, update)
    running = jax.tree.map(
      lambda old, new: decay * old + (1 - decay) * new, state.batch_stats, batch_stats
    )
    return TrainState(params, running, opt_state, state.step + 1), found

  return jax.jit(step, donate_argnums=0)


def make_statistics(
  kind: str, *, mixed: bool = False
) -> Callable[[TrainState, Iterable[Any]], TrainState]:
  """Statistics taken anew, instead of running ones: a mean over batches, with the last parameters.

  Running statistics are of the parameters of many steps. Where these move fast they fit none of
  them, and a network that does well on batches of its own does badly on single views.

  Args:
    kind: of network.
    mixed: as of `make_step`.

  Returns:
    renew(state, batches) -> the state with the mean of the batches' statistics.
  """
  network = NETWORKS[kind].clone(mixed=mixed)

  @jax.jit
  def statistics(params, batch_stats, batch):
    variables = {'params': params, 'batch_stats': batch_stats}
    image = data.decode(batch).image
    return network.apply(variables, image, train=True, mutable='batch_stats')[1]['batch_stats']

  def renew(state, batches):
    total, count = None, 0
    for batch in batches:
      found = statistics(state.params, state.batch_stats, batch)
      total, count = found if total is None else jax.tree.map(jnp.add, total, found), count + 1
    return state._replace(batch_stats=jax.tree.map(lambda x: x / count, total))

  return renew


def make_eval(kind: str, recipe: Recipe) -> Callable[[TrainState, Any], dict[str, jax.Array]]:
  """The metrics of a batch with running statistics, compiled: the loss, and the IoU of a shape."""

  def evaluate(state, batch):
    _, (found, _) = _objective(
      state.params, state.batch_stats, batch, NETWORKS[kind], kind, recipe, False
    )
    return found

  return jax.jit(evaluate)


def _objective(params, batch_stats, batch, network, kind, recipe, train):
  """(loss, (metrics, batch statistics))."""
  batch = data.decode(batch)
  output, mutated = network.apply(
    {'params': params, 'batch_stats': batch_stats}, batch.image, train=train, mutable='batch_stats'
  )
  loss, found = objectives.OBJECTIVES[kind](output, batch, recipe, train)
  if recipe.kernel_penalty:
    loss = loss + recipe.kernel_penalty * _kernel_sum(params)
  return loss, ({'loss': loss, **found}, mutated['batch_stats'])


def _surface_objective(params, batch_stats, batch, trunk, recipe):
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

  near = surface.near_cells(batch.index, trunk.grid_size)
  loss, (found, statistics) = surface.by_capacity(
    heads_loss, near, heads, layers.materialize(features), batch, near
  )
  if recipe.kernel_penalty:
    loss = loss + recipe.kernel_penalty * _kernel_sum(params)
  return loss, ({'loss': loss, **found}, {'trunk': mutated['batch_stats'], **statistics})


def _kernel_sum(params):
  leaves = jax.tree_util.tree_leaves_with_path(params)
  return sum(jnp.sum(jnp.abs(x)) for path, x in leaves if path[-1].key == 'kernel')
