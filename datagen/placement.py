"""The orientation of models in their files, their split, licence and creator: flags and a table.

A table is a CSV file with a header. Its column `id` names the models; the other columns are any of
`COLUMNS`. Empty cells take the values of the flags.
"""

import csv
import io
import os
from collections.abc import Sequence

import numpy as np

from cvn.dataset import SPLITS
from cvn.errors import UserError
from datagen.geometry.mesh import TexturedMesh
from datagen.sources import SourceModel

TABLE = 'models.csv'  # beside the meshes
COLUMNS = ('up', 'turn', 'split', 'licence', 'creator')
UPS = {  # what points up in the file -> rows that turn it to y
  'y': ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
  'z': ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
  'x': ((0, -1, 0), (1, 0, 0), (0, 0, 1)),
  '-y': ((-1, 0, 0), (0, -1, 0), (0, 0, 1)),
  '-z': ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
  '-x': ((0, 1, 0), (-1, 0, 0), (0, 0, 1)),
}


def stand_up(mesh: TexturedMesh, up: str, turn: float) -> TexturedMesh:
  """Rotates a mesh so that y is up, then turns it about y.

  Args:
    mesh: the mesh as in its file.
    up: the file's axis that points up, a key of `UPS`.
    turn: degrees, anticlockwise from above: 180 for meshes that face -z, -90 for those that face
      +x.
  """
  if up == 'y' and turn == 0:
    return mesh
  angle = np.deg2rad(turn)
  cos, sin = np.cos(angle), np.sin(angle)
  about_y = np.array([[cos, 0, sin], [0, 1, 0], [-sin, 0, cos]])
  return mesh._replace(vertices=mesh.vertices @ (about_y @ np.array(UPS[up], float)).T)


def read_table(path: str) -> dict[str, dict[str, str]]:
  """Reads a table: id -> column -> value, without empty cells.

  Raises:
    UserError: it cannot be read, has an unknown column or value, or names a model twice.
  """
  try:
    with open(path, 'rb') as f:
      text = f.read().decode('utf-8-sig')
  except (OSError, UnicodeDecodeError) as e:
    raise UserError(f'{path} cannot be read: {getattr(e, "strerror", None) or e}') from e
  rows = csv.DictReader(io.StringIO(text), skipinitialspace=True)
  names = [(name or '').strip() for name in rows.fieldnames or ()]
  unknown = [name for name in names if name not in ('id', *COLUMNS)]
  if 'id' not in names or unknown:
    raise UserError(
      f'{path}: the first line must name the column id and any of {", ".join(COLUMNS)}'
      + (f', not {unknown[0]!r}' if unknown else '')
    )
  rows.fieldnames = names
  table: dict[str, dict[str, str]] = {}
  for row in rows:
    said = {k: v.strip() for k, v in row.items() if k in names and v and v.strip()}
    model_id = said.pop('id', '')
    if not model_id and not said:
      continue
    if not model_id or model_id in table:
      what = f'{model_id} appears twice' if model_id else 'the id is missing'
      raise UserError(f'{path}, line {rows.line_num}: {what}')
    _check(said, f'{path}, line {rows.line_num}')
    table[model_id] = said
  return table


def _check(said, where):
  if said.get('up', 'y') not in UPS:
    raise UserError(f'{where}: up is {said["up"]!r}, but must be one of {", ".join(UPS)}')
  if said.get('split', 'train') not in SPLITS:
    raise UserError(f'{where}: split is {said["split"]!r}, but must be one of {", ".join(SPLITS)}')
  try:
    turn = float(said.get('turn', 0))
  except ValueError:
    turn = np.nan
  if not np.isfinite(turn):
    raise UserError(f'{where}: turn is {said["turn"]!r}, but must be a number of degrees')


def with_metadata(
  models: Sequence[SourceModel],
  *,
  table: str | None = None,
  input_dir: str | None = None,
  up: str = 'y',
  turn: float = 0.0,
  split: str | None = None,
  licence: str | None = None,
  creator: str | None = None,
) -> list[SourceModel]:
  """Adds to models what flags and a table say.

  Args:
    models: as their source lists them.
    table: the table's file; None for `TABLE` in the input folder, if it is there.
    input_dir: that folder.
    up: of all models for which the table says nothing else; so are the others.
    turn: degrees.
    split: instead of the source's and the id's.
    licence: where the source says none.
    creator: likewise.

  Raises:
    UserError: the table cannot be read, or names none of the models.
  """
  if table is None and input_dir and os.path.isfile(os.path.join(input_dir, TABLE)):
    table = os.path.join(input_dir, TABLE)
  said = read_table(table) if table is not None else {}
  unknown = sorted(said.keys() - {m.id for m in models})
  if said and len(unknown) == len(said):
    raise UserError(
      f'{table} names none of the models: it has {unknown[0]}, the folder has {models[0].id}'
    )
  return [
    m._replace(
      up=said.get(m.id, {}).get('up', up),
      turn=float(said.get(m.id, {}).get('turn', turn)),
      split=said.get(m.id, {}).get('split', split or m.split),
      licence=said.get(m.id, {}).get('licence', m.licence or licence or ''),
      creator=said.get(m.id, {}).get('creator', m.creator or creator or ''),
    )
    for m in models
  ]
