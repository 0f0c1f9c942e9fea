import numpy as np
import pytest
from scipy.spatial.distance import cdist

from cvn.evaluation import retrieval


def test_ious_are_those_of_the_sets():
  rng = np.random.default_rng(0)
  queries, candidates = rng.random((3, 50)) < 0.4, rng.random((600, 50)) < 0.4
  expected = 1 - cdist(queries, candidates, 'jaccard')
  np.testing.assert_allclose(retrieval.ious(queries, candidates), expected, atol=1e-6)


def test_two_empty_masks_are_alike():
  masks = np.zeros((2, 8), bool)
  masks[1, 3] = True
  np.testing.assert_array_equal(retrieval.ious(masks, masks), np.eye(2))


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
