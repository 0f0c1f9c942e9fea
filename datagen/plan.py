"""The models that a data set is to hold, their rows, and whether an existing data set agrees."""

import itertools
import os
import re
from collections import Counter
from collections.abc import Sequence

from cvn import dataset as dataset_lib
from cvn.dataset import Dataset, Manifest, Model
from cvn.errors import UserError
from datagen import sources
from datagen.pipeline import Settings
from datagen.sources import SourceModel, mesh_folder
from datagen.splits import read_splits, split_of

VERSION = 4  # of what is generated: the same settings and version give the same bytes


def list_models(
  source: str, categories: Sequence[str], input_dir: str | None, limit: int | None, seed: int
) -> list[SourceModel]:
  """All models to make, category by category.

  Raises:
    UserError: there are none, or two have the same id. Errors of the source are passed on.
  """
  wanted = [c.strip() for c in categories if c.strip()]
  if not wanted:
    raise UserError('--category names no category')
  if len(set(wanted)) < len(wanted):
    raise UserError(f'--category repeats a category: {",".join(wanted)}')
  listing = sources.source(source).list_models
  if source == 'meshes':
    for name in wanted:
      if not re.fullmatch(r'\w[\w .-]*', name):
        raise UserError(
          f'--category={name} is not a name, and --source=meshes does not support patterns'
        )
    if len(wanted) > 1:
      listing = mesh_folder.list_folders
  models = [m for c in wanted for m in listing(c, input_dir, limit, seed)]
  if not models:
    raise UserError(f'{input_dir or source} has no model of category {",".join(wanted)}')
  model_id, count = Counter(m.id for m in models).most_common(1)[0]
  if count > 1:
    raise UserError(f'{count} models have the id {model_id}: use one data set for each category')
  return models


def keep_listed(
  models: Sequence[SourceModel], folder: str, limit: int | None
) -> tuple[list[SourceModel], str]:
  """Keeps the models named in lists of ids, each with its list's split.

  Args:
    models: the models, category by category.
    folder: folder of the lists.
    limit: maximum number of models of each category; None keeps all.

  Returns:
    (the models, one line about differences between lists and models).

  Raises:
    UserError: a category has no lists, or they name none of the models.
  """
  lists = {c: read_splits(folder, c) for c in dict.fromkeys(m.category for m in models)}
  listed = [m._replace(split=lists[m.category][m.id]) for m in models if m.id in lists[m.category]]
  if not listed:
    raise UserError(f'the lists in {folder} name none of the models, such as {models[0].id}')
  absent = sum(map(len, lists.values())) - len(listed)
  note = (
    f'{folder}: {len(listed)} models listed and found, {absent} listed but not found,'
    f' {len(models) - len(listed)} found but not listed (left out)'
  )
  by_category = itertools.groupby(listed, key=lambda m: m.category)
  return [m for _, group in by_category for m in itertools.islice(group, limit)], note


def plan(
  models: Sequence[SourceModel], source: str, *, input_dir: str | None = None
) -> list[Model]:
  """The manifest's entries for models.

  Args:
    models: the models as listed by their source. A hash of the id replaces a missing split.
    source: name of the source.
    input_dir: paths are stored relative to it, so that the folder can move.
  """
  return [
    Model(
      id=m.id,
      category=m.category,
      split=m.split or split_of(m.id),
      source=source,
      path=_relative(m.path, input_dir),
      licence=m.licence,
      creator=m.creator,
      content=m.content,
      up=m.up,
      turn=m.turn,
    )
    for m in models
  ]


def _relative(path: str, input_dir: str | None) -> str:
  """A path relative to the input folder, or to the folder of the input file."""
  if not path:
    return ''
  if input_dir and os.path.isdir(input_dir):
    return os.path.relpath(path, input_dir)
  return os.path.basename(path)


def _without(model: Model) -> Model:
  """A model without the fields whose changes cause it to be made again."""
  return model._replace(content='', up='y', turn=0.0)


def open_or_create(
  root: str, models: Sequence[Model], settings: Settings, *, append: bool
) -> tuple[Dataset, list[int]]:
  """Creates the data set, or opens an existing one that agrees.

  Args:
    root: its folder or URL.
    models: the models that it is to hold.
    settings: how its records are made.
    append: whether to add models that an existing data set does not hold.

  Returns:
    (the data set, the row of each model). Models whose files, `up` or `turn` have changed count as
    not made.

  Raises:
    UserError: the existing data set was made with other settings, holds another model of the same
      id, or lacks models without `append`.
  """
  settings_json = {
    'shading': settings.shading,
    'tolerance': settings.tolerance,
    'similarity': settings.similarity,
    'version': VERSION,
  }
  manifest = Manifest(
    tuple(models),
    settings.azimuths,
    settings.image_size,
    settings.grid_size,
    dataset_lib.SURFACE_CAPACITY,
    settings_json,
  )
  if dataset_lib.read_json(root, 'manifest.json') is None:
    return dataset_lib.create(root, manifest), list(range(len(models)))
  dataset = dataset_lib.open_dataset(root)
  old = dataset.manifest
  way_out = 'choose another --output, or delete it'
  for name in sorted(manifest.settings | old.settings):
    was, now = old.settings.get(name), manifest.settings.get(name)
    if was != now:
      raise UserError(f'{root} holds a data set with {name} {was}, not {now}: {way_out}')
  if old._replace(models=()) != manifest._replace(models=()):
    raise UserError(f'{root} holds a data set with other sizes or views: {way_out}')
  row_of = {m.id: row for row, m in enumerate(old.models)}
  changed = {
    row_of[m.id]: m
    for m in models
    if m.id in row_of
    and _without(old.models[row_of[m.id]]) == _without(m)
    and old.models[row_of[m.id]] != m
  }
  for m in models:
    if m.id in row_of and row_of[m.id] not in changed and old.models[row_of[m.id]] != m:
      differs = [
        f'{name} {was!r}, not {now!r}'
        for name, was, now in zip(Model._fields, old.models[row_of[m.id]], m, strict=True)
        if was != now
      ]
      raise UserError(f'{root} holds a model {m.id} with {", ".join(differs)}: {way_out}')
  new = [m for m in models if m.id not in row_of]
  if new and not append:
    raise UserError(
      f'{root} holds a data set of {len(old.models)} models without {len(new)} of these'
      f' {len(models)} (first: {new[0].id}): give --append to add them, or {way_out}'
    )
  if changed:
    dataset = dataset_lib.replan(dataset, changed)
  if new:
    dataset = dataset_lib.extend(dataset, new)
    row_of |= {m.id: len(old.models) + n for n, m in enumerate(new)}
  return dataset, [row_of[m.id] for m in models]
