"""Pictures of experiments.reconstruct: which files, which masks, names for the results."""

import os
from collections.abc import Sequence
from typing import Any

from PIL import Image

from cvn.errors import UserError
from cvn.files import atomic_write
from cvn.photo import Photo

SUFFIXES = (
  *('.png', '.jpg', '.jpeg', '.jpe', '.webp', '.avif', '.heic', '.heif', '.gif', '.bmp'),
  *('.tif', '.tiff', '.jp2', '.j2k', '.ppm', '.pgm', '.tga'),
)


def split_names(values: Sequence[str]) -> list[str]:
  """Names separated by commas, each once; a comma that is part of a file's name stays one."""
  names = []
  for value in values:
    names += [value] if os.path.exists(value) else [v.strip() for v in value.split(',')]
  return list(dict.fromkeys(n for n in names if n))


def expand_folders(paths: Sequence[str]) -> list[str]:
  """The same with every folder replaced by the pictures in it, by name.

  Raises:
    UserError: a folder holds no picture or cannot be read.
  """
  found = []
  for path in paths:
    if not os.path.isdir(path):
      found.append(path)
      continue
    try:
      names = sorted(n for n in os.listdir(path) if n.lower().endswith(SUFFIXES))
    except OSError as e:
      raise UserError(f'cannot read the folder {path}: {e.strerror}') from e
    if not names:
      raise UserError(f'the folder {path} holds no image ({", ".join(SUFFIXES)})')
    found += [os.path.join(path, name) for name in names]
  return list(dict.fromkeys(found))


def assign_masks(paths: Sequence[str], masks: Sequence[str]) -> dict[str, str | None]:
  """A mask, or None, for each picture.

  Raises:
    UserError: there are masks, but not one for each picture.
  """
  if not masks:
    return dict.fromkeys(paths)
  if len(masks) != len(paths):
    raise UserError(
      f'--mask names {len(masks)} files for {len(paths)} images: give one for each image, in the'
      ' same order, or none'
    )
  return dict(zip(paths, masks, strict=True))


def output_names(paths: Sequence[str]) -> dict[str, str]:
  """A name for each picture's results: its own, with a number where another has it already."""
  names, taken = {}, set()
  for path in paths:
    stem = os.path.splitext(os.path.basename(path))[0]
    name, number = stem, 1
    while taken & {name, f'{name}_mask'}:
      number += 1
      name = f'{stem}_{number}'
    names[path] = name
    taken |= {name, f'{name}_mask'}
  return names


def write_mask(path: str, photo: Photo) -> None:
  """Writes the mask of a photo's object as a PNG, white on black, of the upright picture's size.

  Raises:
    UserError: the place cannot be written.
  """
  with atomic_write(path) as temporary:
    Image.fromarray(photo.mask).save(temporary, format='PNG')


def known_categories(*configs: dict[str, Any]) -> list[str]:
  """The categories that all of some networks were trained on; empty where that is not stored."""
  found = [set(c.get('categories') or c.get('category') or ()) for c in configs]
  return sorted(set.intersection(*found)) if found else []
