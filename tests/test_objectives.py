"""What each network is trained for, against the same written out densely with numpy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cvn import losses, objectives
from cvn.data import Batch
from cvn.grid import PADDING_INDEX
from cvn.networks import ColorVolumes
from cvn.recipe import PAPER, RELEASE

SIZE, SLOTS, IMAGE = 8, 20, 16


def make_batch(seed=0):
  rng = np.random.default_rng(seed)
  places = np.stack([rng.permutation(SIZE**3)[:SLOTS] for _ in range(2)])
  index = np.stack(np.unravel_index(places, (SIZE,) * 3), -1).astype(np.int32)
  index[0, -5:] = PADDING_INDEX
  return Batch(
    rng.random((2, IMAGE, IMAGE, 3), np.float32),
    index,
    rng.random((2, SLOTS, 3), np.float32),
    rng.random((2, SLOTS, 2), np.float32),
  )


def make_volume(channels, seed=1):
  return np.random.default_rng(seed).random((2, *(SIZE,) * 3, channels), np.float32)


def at_surface(volume, batch):
  """Pairs (predicted, slot) of all real surface voxels."""
  for b in range(2):
    for s, place in enumerate(batch.index[b]):
      if place[0] != PADDING_INDEX:
        yield volume[(b, *place)], (b, s)


@pytest.mark.parametrize('recipe', [PAPER, RELEASE])
@pytest.mark.parametrize(
  ('objective', 'channels', 'field'),
  [(objectives.regression, 3, 'color'), (objectives.flow, 2, 'flow')],
)
def test_models_of_one_head_have_its_term_alone(objective, channels, field, recipe):
  batch, volume = make_batch(), make_volume(channels)
  differences = np.array([p - getattr(batch, field)[at] for p, at in at_surface(volume, batch)])
  expected = (
    np.linalg.norm(differences, axis=-1).mean() if recipe is PAPER else np.abs(differences).mean()
  )
  loss, found = jax.jit(lambda v: objective(v, batch, recipe, True))(volume)
  np.testing.assert_allclose(loss, expected, rtol=1e-5)
  assert found == {}


def test_the_unified_network_adds_both_losses():
  batch, logits = make_batch(), make_volume(1) - 0.5
  volumes = ColorVolumes(make_volume(3, 2), make_volume(2, 3), make_volume(1, 4))
  loss, found = objectives.joint((logits, volumes), batch, PAPER, True)
  color, terms = objectives.color(volumes, batch, PAPER, True)
  shape, _ = objectives.shape(logits, batch, PAPER, True)
  np.testing.assert_allclose(loss, color + shape, rtol=1e-6)
  np.testing.assert_allclose(loss, found['shape'] + sum(terms.values()), rtol=1e-6)


def test_the_joint_baseline_is_compared_with_every_voxel():
  batch, volume = make_batch(), make_volume(3)
  target = np.full_like(volume, -0.5)
  for _, (b, s) in at_surface(volume, batch):
    target[(b, *batch.index[b, s])] = batch.color[b, s]
  loss, _ = objectives.r2n2(volume, batch, PAPER, True)
  np.testing.assert_allclose(loss, ((volume - target) ** 2).sum(-1).mean(), rtol=1e-5)
  perfect, found = objectives.r2n2(target, batch, PAPER, False)
  assert (perfect, found['iou']) == (0, 1)


def test_shapes_are_trained_by_the_loss_that_is_asked_for():
  batch, logits = make_batch(), make_volume(1) * 4 - 2
  occupancy = np.zeros(logits.shape, bool)
  for _, (b, s) in at_surface(logits, batch):
    occupancy[(b, *batch.index[b, s])] = True
  for loss in (losses.msfcel, losses.cross_entropy):
    recipe = PAPER._replace(shape_loss=loss)
    found, _ = objectives.shape(logits, batch, recipe, True)
    np.testing.assert_allclose(found, loss(jnp.asarray(logits), occupancy), rtol=1e-5)
  _, told = objectives.shape(jnp.where(occupancy, 9.0, -9.0), batch, PAPER, False)
  assert told['iou'] == 1
