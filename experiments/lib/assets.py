"""The parts of pages: templates, style sheets and scripts, which are files, and pictures."""

import io
import re
from importlib import resources

import numpy as np
from PIL import Image


def read(package: str, name: str) -> str:
  """The text of a file of a package."""
  return resources.files(package).joinpath(name).read_text(encoding='utf-8')


def fill(package: str, name: str, **parts: str) -> str:
  """A page with its places {name} filled.

  Args:
    package: with the page.
    name: of the file.
    **parts: the contents of the places, already escaped.

  Raises:
    ValueError: the places of the page are others.
  """
  pieces = re.split(r'\{([a-z]+)\}', read(package, name))
  if {*pieces[1::2]} != {*parts}:
    raise ValueError(f'{name} has places for {pieces[1::2]}, not for {[*parts]}')
  pieces[1::2] = [parts[place] for place in pieces[1::2]]
  return ''.join(pieces)


def to_png(image: np.ndarray) -> bytes:
  """A uint8 image [H, W, 3] as the bytes of a PNG file."""
  file = io.BytesIO()
  Image.fromarray(image).save(file, 'png')
  return file.getvalue()
