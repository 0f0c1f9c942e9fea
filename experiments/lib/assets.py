"""What pages are made of: templates, style sheets and scripts, which are files, and pictures."""

import io
import re
from importlib import resources

import numpy as np
from PIL import Image


def read(package: str, name: str) -> str:
  """The text of a file of a package."""
  return resources.files(package).joinpath(name).read_text(encoding='utf-8')


def fill(package: str, name: str, **parts: str) -> str:
  """A page with its parts in the places {name} that it has for them.

  Args:
    package: that has the page.
    name: of its file.
    **parts: what is put in; as it is, so that texts must have been escaped.

  Raises:
    ValueError: the page has no such place, or has a place for another part.
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
