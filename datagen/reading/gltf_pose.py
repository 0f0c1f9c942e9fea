"""Positions of a glTF scene's nodes, and vertices moved by skins, all without animation."""

import numpy as np

from datagen.reading.gltf_accessors import Document, items, raw_values, values


def local(node: dict) -> np.ndarray:
  """[4, 4] from a node to its parent."""
  if 'matrix' in node:
    return np.array(node['matrix'], np.float64).reshape(4, 4).T
  return _composed(
    np.array(node.get('translation', (0, 0, 0)), np.float64)[None],
    np.array(node.get('rotation', (0, 0, 0, 1)), np.float64)[None],
    np.array(node.get('scale', (1, 1, 1)), np.float64)[None],
  )[0]


def _composed(translation, rotation, scale):
  """[N, 4, 4] from translations [N, 3], unit quaternions [N, 4] (x, y, z, w) and scales [N, 3]."""
  norm = np.linalg.norm(rotation, axis=1, keepdims=True)
  x, y, z, w = (rotation / np.where(norm > 0, norm, 1)).T
  matrix = np.tile(np.eye(4), (len(rotation), 1, 1))
  turned = np.array(
    [
      [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
      [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
      [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
  )
  matrix[:, :3, :3] = np.moveaxis(turned, -1, 0) * scale[:, None]
  matrix[:, :3, 3] = translation
  return matrix


def worlds(document: Document) -> dict[int, np.ndarray]:
  """[4, 4] from each node to the world, also for joints, which scenes need not contain."""
  nodes = items(document, 'nodes')
  if not items(document, 'skins'):
    return {}
  parent = {child: n for n, node in enumerate(nodes) for child in node.get('children', [])}
  found: dict[int, np.ndarray] = {}
  for n in range(len(nodes)):
    path = []
    while n is not None and n not in found and len(path) <= len(nodes):
      path.append(n)
      n = parent.get(n)
    for m in reversed(path):
      above = parent.get(m)
      outer = np.eye(4) if above is None else found.get(above, np.eye(4))
      found[m] = outer @ local(nodes[m])
  return found


def joint_matrices(document: Document, skin: int, worlds: dict[int, np.ndarray]) -> np.ndarray:
  """[J, 4, 4] from a skin's mesh to the world."""
  described = items(document, 'skins')[skin]
  matrices = np.stack([worlds[joint] for joint in described['joints']])
  if 'inverseBindMatrices' in described:
    inverse = values(document, described['inverseBindMatrices']).reshape(-1, 4, 4)
    matrices = matrices @ np.swapaxes(inverse[: len(matrices)], 1, 2)
  return matrices


def instances(document: Document, extension: dict) -> np.ndarray:
  """[N, 4, 4] of the copies of EXT_mesh_gpu_instancing."""
  given = {name: values(document, index) for name, index in extension['attributes'].items()}
  count = max((len(v) for v in given.values()), default=1)
  rest = {'TRANSLATION': (0, 0, 0), 'ROTATION': (0, 0, 0, 1), 'SCALE': (1, 1, 1)}
  return _composed(
    *(
      given.get(name, np.tile(np.array(value, np.float64), (count, 1)))
      for name, value in rest.items()
    )
  )


def skinned(
  document: Document, attributes: dict, vertices: np.ndarray, joints: np.ndarray
) -> np.ndarray:
  """[V, 3] vertices moved by their joints [J, 4, 4]."""
  moved, total = np.zeros_like(vertices), np.zeros(len(vertices))
  for n in range(8):
    if f'JOINTS_{n}' not in attributes or f'WEIGHTS_{n}' not in attributes:
      break
    joint = raw_values(document, attributes[f'JOINTS_{n}']).astype(np.int64)
    weight = values(document, attributes[f'WEIGHTS_{n}'])
    for k in range(joint.shape[1]):
      matrix = joints[joint[:, k]]
      point = np.einsum('nij,nj->ni', matrix[:, :3, :3], vertices) + matrix[:, :3, 3]
      moved += weight[:, k : k + 1] * point
      total += weight[:, k]
  lone = total <= 0  # vertices that no joint moves
  return np.where(lone[:, None], vertices, moved / np.where(lone, 1, total)[:, None])
