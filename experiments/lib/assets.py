"""The parts of pages: templates, style sheets and scripts, which are files, and pictures."""

import io
import string
from importlib import resources

import numpy as np
from PIL import Image


def read(package: str, name: str) -> str:
  """The text of a file of a package."""
  return resources.files(package).joinpath(name).read_text(encoding='utf-8')


def fill(package: str, name: str, **parts: str) -> str:
  """A page with its places ${name} filled by parts that are already escaped."""
  return string.Template(read(package, name)).substitute(parts)


def to_png(image: np.ndarray) -> bytes:
  """A uint8 image [H, W, 3] as the bytes of a PNG file."""
  file = io.BytesIO()
  Image.fromarray(image).save(file, 'png')
  return file.getvalue()
