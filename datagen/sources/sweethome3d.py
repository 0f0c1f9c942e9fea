"""Source `sweethome3d`: furniture libraries of Sweet Home 3D, and the models of the program itself.

A category selects pieces by their names in the catalogue, and by their tags, since the name of a
Ford Focus does not say that it is a car. `--category=NAME` selects one of `CATEGORIES`,
`--category='NAME=PATTERN'` all pieces with the regular expression in their names.

The catalogue's rotation makes a model upright (y) and turns it to the front (+z); the catalogue's
size stretches it, as in the program. Variants of one model, such as a table in three woods or a car
in two trims, have names with the same beginning and stay in one split.
"""

import os
import posixpath
import re
import zlib
from collections import Counter
from typing import NamedTuple

import numpy as np

from cvn.errors import UserError
from datagen.geometry.mesh import TexturedMesh
from datagen.reading import EXTENSIONS, read_mesh
from datagen.reading.files import archive_files
from datagen.sources import SourceModel
from datagen.sources.furniture_catalogue import Piece, read_catalogue
from datagen.sources.java3d_materials import with_built_in_materials
from datagen.splits import split_of

LIBRARIES = ('.sh3f', '.jar')
HELP = "a furniture library (.sh3f), the program's own .jar, or a folder with some"
_NEVER = '(?!)'


class Choice(NamedTuple):
  """The pieces of a category: regular expressions, ignoring case."""

  name: str  # found in the name
  tag: str = _NEVER  # or the whole of a tag
  unless: str = _NEVER  # but not found in the name


CATEGORIES = {
  'car': Choice(r'\bcar$', 'car', r'truck|\bbus\b|toy|model|cable|rail'),
  'chair': Choice(r'chair$|chair with ', 'chair', r'puff|lift'),
  'guitar': Choice(r'guitar$'),
  'human': Choice(r'\b(man|woman|boy|girl)$', 'human|people', r'^mannequin$|snow'),
  'table': Choice(
    r'\b(table|desk)$|\btable (with|on) |^table tennis$', 'table', r'bedside|changing|football'
  ),
}


def list_models(
  category: str, input_dir: str | None, limit: int | None, seed: int
) -> list[SourceModel]:
  """The pieces of a category, library by library.

  An id is the catalogue's own, `Library_piece`. Pieces that share an id, for example from two
  versions of a library, get a checksum at the end.

  Args:
    category: one of `CATEGORIES`, or a name with a pattern such as 'sofa=sofa|couch'.
    input_dir: a library, or a folder with libraries in it or in its subfolders.
    limit: maximum number of models; None takes all.
    seed: unused.

  Raises:
    UserError: an unknown category, an invalid pattern, or no readable library.
  """
  del seed
  name, choice = _choice(category)
  chosen = [
    (path, piece)
    for path, pieces in _catalogues(input_dir)
    for piece in dict.fromkeys(pieces)
    if _is_chosen(piece, choice)
  ]
  ids = [_plain(piece.id or f'{_stem(path)} {piece.model}') for path, piece in chosen]
  shared = Counter(ids)
  models = []
  for id, (path, piece) in zip(ids, chosen, strict=True):
    if shared[id] > 1:
      where = repr((os.path.relpath(path, input_dir), piece))
      id = f'{id}_{zlib.crc32(where.encode(errors="replace")):08x}'
    models.append(
      SourceModel(
        id=id,
        category=name,
        path=path,
        detail=piece,
        split=split_of(family(piece.model)),
        licence=piece.licence,
        creator=piece.creator,
      )
    )
  return models[: limit or None]


def load(model: SourceModel) -> TexturedMesh:
  """Reads a piece's model, rotated and stretched as its catalogue says.

  Raises:
    UserError: it cannot be read, or the catalogue's numbers make no sense.
  """
  piece = model.detail
  if not piece.model.lower().endswith(EXTENSIONS):
    known = ' '.join(EXTENSIONS)
    raise UserError(
      f'{model.path}: {piece.model or "no model"} is not in a supported format: {known}'
    )
  with archive_files(model.path) as files:
    mesh = read_mesh(with_built_in_materials(files), piece.model)
  return place(mesh, piece)


def place(mesh: TexturedMesh, piece: Piece) -> TexturedMesh:
  """Applies the catalogue's rotation and size; both may be missing.

  Raises:
    UserError: the rotation is not one, or the size is not positive.
  """
  vertices = mesh.vertices
  if piece.rotation:
    rotation = _numbers(piece, 'modelRotation', piece.rotation.split(), 9).reshape(3, 3)
    is_one = np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-2)
    if not is_one or np.linalg.det(rotation) < 0:
      raise UserError(f'{piece.model}: modelRotation is not a rotation: {piece.rotation}')
    vertices = vertices @ rotation.T
  if any(piece.size):
    size = _numbers(piece, 'width, height and depth', piece.size, 3)
    if not (size > 0).all():
      raise UserError(f'{piece.model}: width, height and depth must be positive: {piece.size}')
    extent = np.ptp(vertices[np.unique(mesh.faces)], axis=0)
    vertices = vertices * np.divide(size, extent, out=np.ones(3), where=extent > 0)
  return mesh._replace(vertices=vertices)


def _numbers(piece, key, texts, count):
  """[count] finite numbers of a key in the catalogue."""
  try:
    numbers = np.array([float(text) for text in texts])
  except ValueError:
    numbers = np.array([])
  if numbers.shape != (count,) or not np.isfinite(numbers).all():
    raise UserError(f'{piece.model}: {key} must be {count} numbers, not {" ".join(texts)!r}')
  return numbers


def _choice(category):
  """(name, choice of pieces) of a category given by the user."""
  name, given, pattern = (part.strip() for part in category.partition('='))
  if not given and name in CATEGORIES:
    return name, CATEGORIES[name]
  if not given:
    raise UserError(
      f'--source=sweethome3d has the categories {", ".join(CATEGORIES)}, not {name!r}; for others'
      f" give a regular expression for their names: --category='{name}=PATTERN'"
    )
  if not name or not pattern:
    raise UserError(f"--category={category} must be 'NAME=PATTERN'")
  try:
    re.compile(pattern)
  except re.error as e:
    raise UserError(f'--category={category}: {pattern!r} is not a regular expression: {e}') from e
  return name, Choice(pattern)


def _is_chosen(piece, choice):
  name, tag, unless = (re.compile(pattern, re.IGNORECASE) for pattern in choice)
  wanted = name.search(piece.name) or any(tag.fullmatch(t) for t in piece.tags)
  return bool(wanted) and not unless.search(piece.name)


def _catalogues(path):
  """[(library, its pieces)] of a library, or of all libraries in a folder, sorted by path."""
  if not path:
    raise UserError(f'--source=sweethome3d needs --input: {HELP}')
  if not os.path.exists(path):
    raise UserError(f'--input={path} does not exist: give {HELP}')
  libraries = [path]
  if os.path.isdir(path):
    libraries = [
      os.path.join(folder, name)
      for folder, _, names in os.walk(path)
      for name in names
      if name.lower().endswith(LIBRARIES) and not name.startswith('.')
    ]
  found = []
  for library in sorted(libraries):
    with archive_files(library) as files:
      found.append((library, read_catalogue(files)))
  if not any(pieces for _, pieces in found):
    raise UserError(f'--input={path} has no furniture catalogue: give {HELP}')
  return found


def family(model):
  """The name that variants of a model share: the first two words of each part of its path.

  'wooden_office_pear_table/table.obj' and 'wooden_office_teak_table/table.obj' are one family.
  """
  return re.sub(r'([^-_ /]+[-_ ][^-_ /]+)[-_ ][^/]*', r'\1', posixpath.splitext(model)[0])


def _stem(path):
  return os.path.splitext(os.path.basename(path))[0]


def _plain(text):
  """The text with underscores for everything but letters, digits, dots and dashes."""
  return re.sub(r'[^A-Za-z0-9.-]+', '_', text).strip('_.')
