"""The split of a model: by a hash, by rank, or from lists in files."""

import hashlib
import math
import os
import re
from collections.abc import Mapping, Sequence

from cvn.dataset import SPLITS
from cvn.errors import UserError
from cvn.files import atomic_write

FRACTIONS = (0.7, 0.1, 0.2)  # train, val, test, as in the paper
SYNSETS = {  # of the paper's categories, as ShapeNet and the authors' lists name them
  'car': '02958343',
  'chair': '03001627',
  'guitar': '03467517',
  'table': '04379243',
}


def split_of(model_id: str, fractions: Sequence[float] = FRACTIONS) -> str:
  """The split of a model, a function of its id alone.

  Args:
    model_id: any text.
    fractions: shares of train, val and test, with sum 1.

  Returns:
    'train', 'val' or 'test'.
  """
  digest = hashlib.sha256(model_id.encode()).digest()
  at = int.from_bytes(digest[:8], 'big') / 2**64
  train, val, _ = fractions
  return SPLITS[(at >= train) + (at >= train + val)]


def ranked_splits(
  families: Mapping[str, str], fractions: Sequence[float] = FRACTIONS
) -> dict[str, str]:
  """Splits of a small collection, for which a hash alone would miss the shares.

  Families are ordered by their hashes. The first ones are for testing until they have the requested
  share of models, the next for validation, the rest for training. A single model is for testing.

  Args:
    families: model id -> its family; models of a family share a split.
    fractions: shares of train, val and test, with sum 1; test and val are rounded up.

  Returns:
    model id -> 'train', 'val' or 'test'.
  """
  members: dict[str, list[str]] = {}
  for model_id, family in families.items():
    members.setdefault(family, []).append(model_id)
  _, val, test = fractions
  wanted = {'test': math.ceil(test * len(families)), 'val': math.ceil(val * len(families))}
  splits: dict[str, str] = {}
  for family in sorted(members, key=lambda name: hashlib.sha256(name.encode()).digest()):
    split = next((s for s, left in wanted.items() if left > 0), 'train')
    splits |= dict.fromkeys(members[family], split)
    wanted[split] = wanted.get(split, 0) - len(members[family])
  return splits


def write_splits(folder: str, category: str, splits: Mapping[str, str]) -> None:
  """Writes the lists that `read_splits` reads, each in the order of the ids."""
  for split in SPLITS:
    ids = sorted(model_id for model_id, s in splits.items() if s == split)
    with atomic_write(os.path.join(folder, f'{split}_list_{category}.txt')) as temporary:
      with open(temporary, 'w', encoding='utf-8') as f:
        f.writelines(f'{model_id}\n' for model_id in ids)


def read_splits(folder: str, category: str) -> dict[str, str]:
  """Reads `{train,val,test}_list_<category>.txt` with one id a line, as in the authors' lists.

  A file may be named after the category's synset instead, like the authors' lists for ShapeNet. An
  id of two words, such as 'clothes1 mesh2' in the lists of people, is joined by an underscore, like
  the parts of a path in the ids of the source `meshes`. A split without a file is empty.

  Returns:
    id -> split.

  Raises:
    UserError: no such file, an unreadable one, or an id in two splits.
  """
  splits: dict[str, str] = {}
  names = dict.fromkeys([category, SYNSETS.get(category, category)])
  paths = [(s, os.path.join(folder, f'{s}_list_{name}.txt')) for name in names for s in SPLITS]
  paths = [(split, path) for split, path in paths if os.path.isfile(path)]
  if not paths:
    files = ' or '.join(f'{{train,val,test}}_list_{name}.txt' for name in names)
    raise UserError(f'{folder} has no file {files}')
  for split, path in paths:
    try:
      with open(path, encoding='utf-8') as f:
        lines = f.read().splitlines()
    except (OSError, UnicodeDecodeError) as e:
      raise UserError(f'cannot read {path}: {getattr(e, "strerror", None) or e}') from e
    for line in lines:
      model_id = re.sub(r'\s+', '_', line.strip())
      if not model_id:
        continue
      if splits.setdefault(model_id, split) != split:
        raise UserError(f'{path}: {model_id} is also in the {splits[model_id]} list')
  return splits
