"""DAE (Collada) files, read by pycollada -> parts, one for each primitive.

A texture replaces the material's colour, and so do vertex colours, as in OBJ files. Skins and
morphs are taken in the pose that the file shows without animation.
"""

import io
import re
from collections.abc import Iterator

import collada
import numpy as np
from collada import common, material, polylist, scene, triangleset
from collada.controller import Morph, Skin

from cvn.errors import UserError
from datagen.reading import headers
from datagen.reading import notes as notes_lib
from datagen.reading.colors import as_rgba, grey
from datagen.reading.parts import MASK, UNKNOWN, Part, Picture, placed
from datagen.reading.polygons import cut_mixed
from datagen.reading.surroundings import Surroundings, find_named

UPRIGHT = {  # a file's upward axis -> what turns it to y
  b'X': np.array([[0.0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]),
  b'Z': np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]]),
}
WRAPS = {'WRAP': 'repeat', 'MIRROR': 'mirror', 'CLAMP': 'clamp', 'BORDER': 'clamp', 'NONE': 'clamp'}
OPAQUE_FROM = {  # how a material's alpha follows from `transparent`, as Collada 1.5 names it
  'A_ONE': lambda color: color[3],
  'A_ZERO': lambda color: 1 - color[3],
  'RGB_ZERO': lambda color: 1 - np.dot(color[:3], (0.2126, 0.7152, 0.0722)),
  'RGB_ONE': lambda color: np.dot(color[:3], (0.2126, 0.7152, 0.0722)),
}


def read_dae(content: bytes, around: Surroundings) -> Iterator[Part]:
  """The parts of the scene, with y up.

  Args:
    content: the file's bytes, checked by `headers.check_dae`.
    around: the file's surroundings, where images are searched for.

  Raises:
    UserError: too many faces. Errors of `find_named` are passed on.
    Exception: it is not such a file.
  """
  document = collada.Collada(io.BytesIO(content), ignore=[common.DaeError])
  if document.xmlnode is None or not str(document.xmlnode.getroot().tag).endswith('COLLADA'):
    raise UserError('it is not a COLLADA document')
  up = re.search(rb'<up_axis>\s*([XZ])_UP', content)
  turn = UPRIGHT[up[1]] if up else np.eye(4)
  nodes = [] if document.scene is None else list(document.scene.nodes)
  todo = [(node, turn) for node in reversed(nodes)]
  joints = None
  known: dict[tuple, list[Part]] = {}
  faces = 0
  while todo:
    node, matrix = todo.pop()
    if isinstance(node, scene.Node):
      below = matrix @ np.asarray(node.matrix, np.float64)
      todo += [(child, below) for child in reversed(node.children or [])]
      continue
    geometry, move = getattr(node, 'geometry', None), None
    if isinstance(node, scene.ControllerNode):
      if joints is None:
        joints = _joints(nodes, turn)
      geometry, move, matrix = _controlled(node.controller, joints, matrix, around.notes)
    elif not isinstance(node, scene.GeometryNode):
      continue
    skinned = isinstance(node, scene.ControllerNode)
    key = (id(node) if skinned else id(geometry), *map(id, _targets(node).values()))
    if key not in known:
      known[key] = list(_parts(document, geometry, node, move, around))
    for part in known[key]:
      faces += len(part.faces)
      if faces > headers.MAX_FACES:
        raise UserError(f'its scene has more than {headers.MAX_FACES} faces')
      yield placed(part, matrix)


def _targets(node):
  return {m.symbol: m.target for m in node.materials}


def _joints(nodes, turn):
  """[4, 4] transforms of joints to the world, by each of the joint's names."""
  found: dict[str, np.ndarray] = {}
  todo = [(node, turn) for node in reversed(nodes)]
  while todo:
    node, matrix = todo.pop()
    if isinstance(node, scene.Node):
      matrix = matrix @ np.asarray(node.matrix, np.float64)
      for key in ('id', 'sid', 'name'):
        name = None if node.xmlnode is None else node.xmlnode.get(key)
        if name:
          found.setdefault(name, matrix)
      todo += [(child, matrix) for child in reversed(node.children or [])]
  return found


def _controlled(controller, joints, matrix, notes):
  """(geometry, motion of its vertices or None, [4, 4] for all of it) of an instance_controller."""
  notes.add(notes_lib.POSE)
  if isinstance(controller, Morph):
    return controller.source_geometry, None, matrix
  if not isinstance(controller, Skin):
    return controller.geometry, None, matrix
  names = list(controller.weight_joints)
  shape = np.asarray(controller.bind_shape_matrix, np.float64)
  moves = []
  for name in names:
    inverse = controller.joint_matrices.get(name)
    if name not in joints or inverse is None:
      return controller.geometry, None, matrix @ shape  # the pose in which it was bound
    moves.append(joints[name] @ np.asarray(inverse, np.float64) @ shape)
  moves = np.array(moves)
  weights = np.asarray(controller.weights.data, np.float64).ravel()

  def move(vertices):
    moved = vertices @ moves[0, :3, :3].T + moves[0, :3, 3]
    if np.allclose(moves, moves[0]):
      return moved
    counts = np.asarray(controller.vcounts)[: len(vertices)]
    vertex = np.repeat(np.arange(len(counts)), counts)
    table = np.asarray(controller.vertex_weight_index).reshape(-1, controller.nindices)
    table = table[: len(vertex)]
    joint, weight = (table[:, offset] for offset in controller.offsets)
    weight = weights[weight]
    at = moves[joint.clip(0)]
    points = np.einsum('nij,nj->ni', at[:, :3, :3], vertices[vertex]) + at[:, :3, 3]
    total = np.bincount(vertex, weight, len(vertices))
    sums = np.stack(
      [np.bincount(vertex, weight * points[:, k], len(vertices)) for k in range(3)], -1
    )
    return np.where((total > 0)[:, None], sums / np.where(total > 0, total, 1)[:, None], moved)

  return controller.geometry, move, np.eye(4)


def _parts(document, geometry, node, move, around):
  """The parts of one geometry, with the materials of a node."""
  inputs = {m.symbol: m.inputs for m in node.materials}
  targets = _targets(node)
  for primitive in geometry.primitives:
    if isinstance(primitive, triangleset.TriangleSet):
      counts = np.full(len(primitive.index), 3)
    elif isinstance(primitive, polylist.Polylist):  # and Polygons
      counts = np.asarray(primitive.vcounts, np.int64)
    else:
      around.notes.add(notes_lib.NOT_TRIANGLES)
      continue
    if primitive.vertex is None or not len(counts) or primitive.index is None:
      continue
    index = np.asarray(primitive.index, np.int64).reshape(-1, primitive.nindices)
    vertices = np.asarray(primitive.vertex, np.float64)
    vertices = vertices if move is None else move(vertices)
    starts = np.cumsum(counts) - counts
    own = index[:, primitive.sources['VERTEX'][0][0]]
    if own.min(initial=0) < 0 or own.max(initial=0) >= len(vertices):
      raise UserError(f'a face names a vertex that is out of bounds: there are {len(vertices)}')
    polygons = []
    for n in np.unique(counts[counts >= 3]):
      rows = np.flatnonzero(counts == n)
      polygons.append((rows, own[starts[rows, None] + np.arange(n)]))
    place, corner = cut_mixed(vertices, polygons)
    at = starts[place][:, None] + corner
    symbol = primitive.material
    effect = _effect(document, targets, symbol, around)
    colors = _vertex_colors(primitive, index, at, around.notes)
    yield _dressed(
      vertices, own[at], colors, effect, primitive, index, at, inputs.get(symbol), around
    )


def _effect(document, targets, symbol, around):
  """The effect of a primitive's material symbol, or None."""
  target = targets.get(symbol)
  if target is None and symbol:
    target = document.materials.get(symbol)
    if target is None:
      around.missing.add(f'material {symbol}')
    else:
      around.notes.add(notes_lib.MATERIAL_GUESSED)
  return None if target is None else target.effect


def _values(primitive, semantic, nth, index, at, width):
  """[F, 3, width] of an input at the triangles' corners, or None."""
  given = primitive.sources.get(semantic) or []
  if nth >= len(given):
    return None
  data = np.asarray(given[nth][4].data, np.float64)
  which = index[at, given[nth][0]]
  if data.ndim != 2 or data.shape[1] < width or not len(data):
    return None
  if len(which) and not 0 <= which.min() <= which.max() < len(data):
    return None
  return data[which]


def _vertex_colors(primitive, index, at, notes):
  """[F, 3, 4], or None if there are none or all are white."""
  colors = _values(primitive, 'COLOR', 0, index, at, 3)
  if colors is None or (colors[..., :3] == 1).all():
    return None
  colors = as_rgba(colors[..., :3], notes)
  return colors


def _dressed(vertices, faces, colors, effect, primitive, index, at, inputs, around):
  """The part with its material's colour and texture."""
  count = len(faces)
  if effect is None:
    return Part(vertices, faces, grey(count) if colors is None else colors)
  shown = effect.diffuse
  if shown is None or (isinstance(shown, tuple | list) and not any(shown[:3])):
    glow = effect.emission  # of a `constant` effect the only colour there is
    if isinstance(glow, material.Map) or (isinstance(glow, tuple | list) and any(glow[:3])):
      shown = glow
  alpha = _alpha(effect)
  if isinstance(shown, material.Map):
    picture = _picture(effect, shown, around)
    if picture is not None:
      if colors is not None:
        around.notes.add(notes_lib.COLORS_IGNORED)
      white = np.ones((count, 3, 4), np.float32)
      white[..., 3] = alpha
      uv = _values(primitive, 'TEXCOORD', _set_of(shown, primitive, inputs), index, at, 2)
      uv = None if uv is None else uv[..., :2]
      return Part(vertices, faces, white, uv, np.zeros(count, np.int32), (picture,))
    shown = None
  if colors is None:
    colors = grey(count)
    if isinstance(shown, tuple | list) and len(shown) >= 3:
      colors[..., :3] = as_rgba(np.array(shown[:3], np.float64), around.notes)[:3]
  colors = colors.copy()
  colors[..., 3] = alpha
  return Part(vertices, faces, colors)


def _alpha(effect):
  """A material's alpha. A lone transparency of 0 means opaque, as old programs write it."""
  node = effect.xmlnode
  written = (
    None
    if node is None
    else next((n for n in node.iter() if str(n.tag).endswith('}transparent')), None)
  )
  has_amount = node is not None and any(str(n.tag).endswith('}transparency') for n in node.iter())
  amount = effect.transparency
  amount = float(amount) if has_amount and isinstance(amount, int | float) else 1.0
  color = effect.transparent
  if written is None:
    return amount if amount > 0 else 1.0
  if not isinstance(color, tuple | list) or len(color) < 3:
    return 1.0
  color = [*map(float, color[:3]), float(color[3]) if len(color) > 3 else 1.0]
  mode = written.get('opaque', 'A_ONE')
  opaque = OPAQUE_FROM.get(mode, OPAQUE_FROM['A_ONE'])(color)
  if mode in ('A_ZERO', 'RGB_ZERO'):
    return float(np.clip(1 - (1 - opaque) * amount, 0, 1))
  return float(np.clip(opaque * amount, 0, 1))


def _picture(effect, shown, around):
  """The `Picture` of a texture, or None if it does not exist."""
  found = find_named(around, str(shown.sampler.surface.image.path))
  if found is None:
    return None
  mask = None
  if isinstance(effect.transparent, material.Map):
    path = str(effect.transparent.sampler.surface.image.path)
    other = find_named(around, path)
    if other is not None and other[1] != found[1]:
      if effect.opaque_mode == material.OPAQUE_MODE.RGB_ZERO:
        around.notes.add(notes_lib.ALPHA_IGNORED)
      else:
        mask = other[1]
  wrap = []
  for key in ('wrap_s', 'wrap_t'):
    node = (
      None
      if shown.sampler.xmlnode is None
      else next((n for n in shown.sampler.xmlnode.iter() if str(n.tag).endswith(key)), None)
    )
    wrap.append(WRAPS.get('' if node is None else (node.text or '').strip(), 'repeat'))
  return Picture(found[1], found[0], MASK if mask else UNKNOWN, wrap=tuple(wrap), mask=mask)


def _set_of(shown, primitive, inputs):
  """The set of texture coordinates that a texture uses."""
  given = primitive.sources.get('TEXCOORD') or []
  for semantic, _, number in inputs or []:
    if semantic == shown.texcoord:
      for n, source in enumerate(given):
        if str(source[3] or 0) == str(number or 0):
          return n
  return 0
