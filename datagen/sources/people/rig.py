"""Joints of a body, and linear blend skinning.

A bone rotates everything below it about its beginning. Rotations are given in the frame of the body
at rest, so they mean the same whatever the parents do: bone b maps the point p to M_b p, with M_b =
M_parent [R_b about b's beginning].
"""

from collections.abc import Mapping

import numpy as np

from datagen.sources.people.data import BodyData


def joints(data: BodyData, vertices: np.ndarray) -> dict[str, np.ndarray]:
  """Where each bone begins, [3], in a body with these vertices [V, 3]."""
  return {b: vertices[at].mean(0) for b, at in zip(data.bones, data.head, strict=True)}


def bone_transforms(
  data: BodyData, at: Mapping[str, np.ndarray], turns: Mapping[str, np.ndarray]
) -> np.ndarray:
  """The transforms of the bones from the body at rest.

  Args:
    data: the rig.
    at: where each bone begins.
    turns: bone -> [3, 3] rotation; other bones do not rotate.

  Returns:
    [B, 4, 4] affine transforms.
  """
  transforms = np.tile(np.eye(4), (len(data.bones), 1, 1))
  for k, (bone, parent) in enumerate(zip(data.bones, data.parent, strict=True)):
    own = transforms[k]
    if bone in turns:
      own[:3, :3] = turns[bone]
      own[:3, 3] = at[bone] - turns[bone] @ at[bone]
    if parent >= 0:
      transforms[k] = transforms[parent] @ own
  return transforms


def skin(vertices: np.ndarray, weights: np.ndarray, transforms: np.ndarray) -> np.ndarray:
  """Blends the bones' transforms by weight: v' = sum_b w_b M_b v.

  Args:
    vertices: [N, 3] at rest.
    weights: [N, B], rows of sum 1.
    transforms: [B, 4, 4].

  Returns:
    [N, 3].
  """
  blend = (weights @ transforms[:, :3].reshape(len(transforms), 12)).reshape(-1, 3, 4)
  return np.einsum('nij,nj->ni', blend[:, :, :3], vertices) + blend[:, :, 3]


def rotation(axis, degrees: float) -> np.ndarray:
  """The right-handed rotation [3, 3] about an axis [3] (Rodrigues)."""
  x, y, z = np.asarray(axis, float) / np.linalg.norm(axis)
  k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
  a = np.deg2rad(degrees)
  return np.eye(3) + np.sin(a) * k + (1 - np.cos(a)) * k @ k


def swing(source, target) -> np.ndarray:
  """The shortest rotation [3, 3] from one direction to another."""
  a, b = (np.asarray(v, float) / np.linalg.norm(v) for v in (source, target))
  axis = np.cross(a, b)
  if np.linalg.norm(axis) < 1e-9:  # the same, or opposite: any axis across will do
    return np.eye(3) if a @ b > 0 else rotation(np.cross(a, np.roll(a, 1) + [0.1, 0, 0]), 180)
  return rotation(axis, np.rad2deg(np.arctan2(np.linalg.norm(axis), a @ b)))
