"""The user study's page: one HTML file that works offline.

A result is a sheet of pictures from all around, which the page turns. The names of sheets and pairs
do not reveal the methods; the key is in a file that the subjects never see.

The browser draws the order and the sides of the pairs for each subject from a seed, which is saved
with the answers. The answers of a subject are a file of this form:

  {"format": 1, "page": ..., "subject": ..., "seed": ..., "started": ..., "finished": ...,
   "answers": [{"pair": ..., "left": sheet, "right": sheet, "choice": sheet, "milliseconds": ...}]}
"""

import base64
import hashlib
import html
import json
from typing import NamedTuple

from experiments.lib import assets

ANSWERS_FORMAT = 1
SUBJECT = r'[A-Za-z0-9_\-]{1,40}'  # a regular expression for JavaScript and Python


class Sheet(NamedTuple):
  """Pictures of a result from all around, row by row in one image."""

  image: bytes  # WebP
  width: int  # of one picture, pixels
  height: int


class Pair(NamedTuple):
  """Two results to choose from."""

  picture: int
  sheets: tuple[str, str]  # names


class Study(NamedTuple):
  """The content of the page."""

  about: str
  pictures: tuple[bytes, ...]  # PNG
  sheets: dict[str, Sheet]  # by name
  frames: int  # pictures on a sheet
  columns: int  # of a sheet
  pairs: dict[str, Pair]  # by name


def identify(study: Study) -> str:
  """A name of the page that depends on its content."""
  return hashlib.sha256(repr(study).encode()).hexdigest()[:12]


def render(study: Study) -> str:
  """The page as HTML."""
  content = {
    'page': identify(study),
    'format': ANSWERS_FORMAT,
    'frames': study.frames,
    'columns': study.columns,
    'pictures': [_encode(p) for p in study.pictures],
    'sheets': {k: s._replace(image=_encode(s.image))._asdict() for k, s in study.sheets.items()},
    'pairs': [{'name': k, **p._asdict()} for k, p in study.pairs.items()],
  }
  return assets.fill(
    'experiments.study',
    'study.html',
    style=assets.read('experiments.study', 'study.css'),
    pairs=str(len(study.pairs)),
    subject=SUBJECT,
    about=html.escape(f'Page {content["page"]}. {study.about}'),
    content=json.dumps(content),
    script=assets.read('experiments.study', 'study.js'),
  )


def _encode(image: bytes) -> str:
  return base64.b64encode(image).decode()
