"""What a reader of meshes ignored or guessed, in words. A data set keeps them as bits of a number.

The order of `NOTES` is the order of the bits: new ones go to the end.
"""

from collections.abc import Iterable

MATERIAL_GUESSED = 'a material is guessed: none is named, or its name differs in case or comment'
PICTURE_GUESSED = 'a file is taken from another folder than the one that is named'
ALPHA_IGNORED = 'alpha is ignored: with it nothing would be visible'
EXTENSION_IGNORED = 'an optional glTF extension is not understood'
NOT_TRIANGLES = 'points or lines are left out'
COLOR_RANGE_GUESSED = 'colours are taken to count to 255, unlike what their type says'
NO_COORDINATES = 'a texture without texture coordinates is taken as its mean colour'
MASK_OPTIONS = 'the alpha map lies otherwise on the surface than the colour map: taken to lie alike'
BAD_COORDINATES = 'texture coordinates that are missing or no numbers'
COLORS_IGNORED = 'vertex or face colours beside a texture or other colours are ignored'
POSE = 'a skinned or morphed shape is taken in the pose that the file shows without animation'
TEXT_GUESSED = 'a text that is not UTF-8 is taken as Latin-1'

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
  """A number that has the bit of each note."""
  return sum(1 << NOTES.index(note) for note in set(notes))


def from_bits(bits: float) -> tuple[str, ...]:
  """The notes whose bits a number has, in the order of `NOTES`."""
  return tuple(note for n, note in enumerate(NOTES) if int(bits) >> n & 1)
