"""Notes: what a reader of meshes ignored or guessed. A data set stores them as bits of a number.

The order of `NOTES` is the order of the bits, so new notes go to the end.
"""

from collections.abc import Iterable

MATERIAL_GUESSED = 'a material was guessed: none is named, or the name differs in case or comment'
PICTURE_GUESSED = 'a file was taken from another folder than the named one'
ALPHA_IGNORED = 'alpha was ignored, because nothing would be visible with it'
EXTENSION_IGNORED = 'an optional glTF extension is not supported'
NOT_TRIANGLES = 'points or lines were left out'
COLOR_RANGE_GUESSED = 'colours were divided by 255, although their type has another range'
NO_COORDINATES = 'a texture without texture coordinates was replaced by its mean colour'
MASK_OPTIONS = 'the options of an alpha map differ from those of its colour map and were ignored'
BAD_COORDINATES = 'texture coordinates are missing or invalid'
COLORS_IGNORED = 'vertex or face colours were ignored in favour of a texture or other colours'
POSE = 'a skinned or morphed shape was taken in the pose without animation'
TEXT_GUESSED = 'a text that is not UTF-8 was read as Latin-1'

NOTES = (
  MATERIAL_GUESSED,
  PICTURE_GUESSED,
  ALPHA_IGNORED,
  EXTENSION_IGNORED,
  NOT_TRIANGLES,
  COLOR_RANGE_GUESSED,
  NO_COORDINATES,
  MASK_OPTIONS,
  BAD_COORDINATES,
  COLORS_IGNORED,
  POSE,
  TEXT_GUESSED,
)  # at most 24: a float32 holds that many bits


def to_bits(notes: Iterable[str]) -> int:
  """The number with the bit of each note."""
  return sum(1 << NOTES.index(note) for note in set(notes))


def from_bits(bits: float) -> tuple[str, ...]:
  """The notes whose bits are set, in the order of `NOTES`."""
  return tuple(note for n, note in enumerate(NOTES) if int(bits) >> n & 1)
