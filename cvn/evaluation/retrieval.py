"""Retrieval baselines: the training model most similar to an image, or to the truth.

A network that only recognises what it has seen does no better than retrieving the training model of
the most similar view (Tatarchenko et al. 2019). The training model nearest to the truth is an upper
bound for retrieval; it uses the truth, so it is not a method.
"""

import functools
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np

from cvn import readouts
from cvn.infer import Network

CODE = 'latent0'  # the encoder's layer whose result is the code of an image
_ROWS = 256  # candidates at a time


def ious(queries: np.ndarray, candidates: np.ndarray) -> np.ndarray:
  """The intersection over union of each query with each candidate; 1 where both are empty.

  Args:
    queries: [Q, N] bool.
    candidates: [C, N] bool.

  Returns:
    [Q, C] float32.

  Raises:
    ValueError: the shapes do not fit.
  """
  if queries.ndim != 2 or candidates.ndim != 2 or queries.shape[1] != candidates.shape[1]:
    raise ValueError(f'[Q, N] and [C, N] are due: {queries.shape}, {candidates.shape}')
  wide = queries.astype(np.float32)
  count = wide.sum(1)
  found = np.empty((len(queries), len(candidates)), np.float32)
  for start in range(0, len(candidates), _ROWS):
    some = candidates[start : start + _ROWS].astype(np.float32)
    intersection = wide @ some.T
    union = count[:, None] + some.sum(1) - intersection
    found[:, start : start + _ROWS] = np.where(union > 0, intersection / np.maximum(union, 1), 1)
  return found


def surface_ious(true: np.ndarray, surfaces: Sequence[np.ndarray]) -> np.ndarray:
  """The intersection over union of a shape with each of many surfaces.

  Args:
    true: [X, X, X] bool, with at least one occupied voxel.
    surfaces: [S, 3] integer indices of each surface.

  Returns:
    [N] for N surfaces.
  """
  flat, count = true.ravel(), true.sum()
  found = []
  for s in surfaces:
    common = flat[np.ravel_multi_index(np.asarray(s, np.int64).T, true.shape)].sum()
    found.append(common / (count + len(s) - common))
  return np.array(found)


def codes(network: Network, views: Any) -> np.ndarray:
  """The encoder's codes of views, [B, 512].

  Args:
    network: of any kind.
    views: [B, H, W, 4 or 3], as in cvn.readouts.
  """
  return np.asarray(_codes(network.module, network.variables, views))


@functools.partial(jax.jit, static_argnums=0)
def _codes(module, variables, views):
  image, _, _ = readouts.prepare(views)
  _, state = module.apply(
    variables,
    image,
    train=False,
    capture_intermediates=lambda layer, _: layer.name == CODE,
    mutable='intermediates',
  )
  (code,) = jax.tree.leaves(state)
  return code


def cosines(queries: np.ndarray, candidates: np.ndarray) -> np.ndarray:
  """The cosine similarity of each query [Q, F] with each candidate [C, F]: [Q, C].

  Both are first centred by the candidates' mean: what all pictures share says nothing.

  Args:
    queries: features of pictures.
    candidates: features of the pictures to choose from.

  Raises:
    ValueError: the shapes do not fit.
  """
  if queries.ndim != 2 or candidates.ndim != 2 or queries.shape[1] != candidates.shape[1]:
    raise ValueError(f'[Q, F] and [C, F] are due: {queries.shape}, {candidates.shape}')
  mean = candidates.mean(0)
  queries, candidates = (
    x / np.maximum(np.linalg.norm(x, axis=1, keepdims=True), 1e-12)
    for x in (queries - mean, candidates - mean)
  )
  return queries @ candidates.T
