"""What the report is made of: sections of blocks, which become HTML and Markdown.

All texts are plain, but for code between backquotes: whoever writes them out escapes them.
"""

from collections.abc import Sequence
from typing import NamedTuple


class Heading(NamedTuple):
  """Stands above a part of a section."""

  text: str


class Text(NamedTuple):
  """A paragraph."""

  text: str


class Missing(NamedTuple):
  """In the place of something that was not made: what, and the command that makes it."""

  what: str
  command: str


class Items(NamedTuple):
  """A list of lines."""

  lines: Sequence[str]


class Cell(NamedTuple):
  """A number in a table."""

  text: str
  detail: str = ''  # set small behind it
  best: bool = False


class Table(NamedTuple):
  """Numbers or words with heads above and a label before each row."""

  caption: str
  groups: Sequence[tuple[str, int]]  # heads over several columns, and over how many; may be empty
  columns: Sequence[str]
  rows: Sequence[tuple[str, Sequence[Cell]]]
  words: bool = False  # whether cells are words, set to the left, and not numbers


class Picture(NamedTuple):
  """A plot, or a picture that one of the project's programs made."""

  name: str  # of its file, without the suffix
  png: bytes
  caption: str
  svg: str = ''  # the same as an <svg> element, preferred where it can be shown
  width: int = 0  # at most, in CSS pixels; 0: all that there are


class Commands(NamedTuple):
  """Commands in the order in which they ran, and their seconds (NaN: not measured)."""

  title: str
  lines: Sequence[tuple[str, float]]


class Turnable(NamedTuple):
  """A model that can be turned."""

  title: str
  note: str
  glb: bytes  # compressed by gzip; empty where there is nothing to show


class Example(NamedTuple):
  """A view, and the models that belong to it, which turn together."""

  title: str
  view: bytes  # PNG
  azimuth: float  # degrees that the models are first seen from
  models: Sequence[Turnable]
  credit: str


class Examples(NamedTuple):
  """Examples, and the same as one still picture."""

  examples: Sequence[Example]
  still: Picture


Block = Heading | Text | Missing | Items | Table | Picture | Commands | Examples


class Section(NamedTuple):
  """A part of the report with a heading of its own."""

  anchor: str
  title: str
  blocks: Sequence[Block]


class Report(NamedTuple):
  """Everything."""

  title: str
  abstract: Sequence[str]  # paragraphs
  made: str  # when and by what
  sections: Sequence[Section]
