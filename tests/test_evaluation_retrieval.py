import jax
import numpy as np
import pytest
from scipy.spatial.distance import cdist

from cvn import readouts
from cvn.evaluation import retrieval
from cvn.infer import Network
from cvn.networks import Encoder, ShapeNetwork


def test_ious_are_those_of_the_sets():
  rng = np.random.default_rng(0)
  queries, candidates = rng.random((3, 50)) < 0.4, rng.random((600, 50)) < 0.4
  expected = 1 - cdist(queries, candidates, 'jaccard')
  np.testing.assert_allclose(retrieval.ious(queries, candidates), expected, atol=1e-6)


def test_two_empty_masks_are_alike():
  masks = np.zeros((2, 8), bool)
  masks[1, 3] = True
  np.testing.assert_array_equal(retrieval.ious(masks, masks), np.eye(2))


def test_ious_of_surfaces_are_those_of_their_volumes():
  rng = np.random.default_rng(2)
  true, *others = rng.random((4, 8, 8, 8)) < 0.2
  expected = retrieval.ious(true.reshape(1, -1), np.reshape(others, (3, -1)))[0]
  found = retrieval.surface_ious(true, [np.argwhere(o).astype(np.uint8) for o in others])
  np.testing.assert_allclose(found, expected, atol=1e-6)


def test_codes_are_what_the_encoder_goes_on_with():
  """The layer behind them, applied to them, gives the encoder's features."""
  views = np.random.default_rng(0).random((2, 32, 32, 4), np.float32)
  module = ShapeNetwork(32, 16)
  image, _, _ = readouts.prepare(views)
  variables = module.init(jax.random.key(0), image, train=False)
  found = retrieval.codes(Network('shape', module, variables), views)
  assert found.shape == (2, 512) and np.ptp(found, 0).max() > 0
  own = jax.device_get({k: v['trunk']['encoder'] for k, v in variables.items()})
  expected = Encoder(128).apply(own, image, train=False)
  p, s = own['params']['latent1'], own['batch_stats']['latent1']['norm']
  y = found @ p['kernel'] + p['bias'] - s['mean']
  y = y / np.sqrt(s['var'] + 1e-3) * p['norm']['scale'] + p['norm']['bias']
  np.testing.assert_allclose(np.where(y > 0, y, np.expm1(y)), expected, atol=1e-4)


def test_cosines_are_those_of_the_centred_features():
  rng = np.random.default_rng(1)
  queries, candidates = rng.normal(size=(4, 7)), 5 + rng.normal(size=(30, 7))
  mean = candidates.mean(0)
  expected = 1 - cdist(queries - mean, candidates - mean, 'cosine')
  np.testing.assert_allclose(retrieval.cosines(queries, candidates), expected, atol=1e-12)
  assert list(retrieval.cosines(candidates, candidates).argmax(1)) == list(range(30))


@pytest.mark.parametrize('function', [retrieval.ious, retrieval.cosines])
def test_what_does_not_fit_is_refused(function):
  with pytest.raises(ValueError, match=r'\[Q, . ?\w*\] and \[C, .\] are due'):
    function(np.zeros((2, 3)), np.zeros((2, 4)))
