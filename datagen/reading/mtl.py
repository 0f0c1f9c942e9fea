"""Materials of MTL files, as programs write them."""

from collections.abc import Iterable, Mapping
from typing import NamedTuple

from datagen.reading import notes as notes_lib
from datagen.reading.surroundings import read_text

# How many words stand behind an option of a texture; more than one may be left out.
_OPTIONS = {
  b'-blendu': 1, b'-blendv': 1, b'-bm': 1, b'-boost': 1, b'-cc': 1, b'-clamp': 1, b'-imfchan': 1,
  b'-mm': 2, b'-o': 3, b'-s': 3, b'-t': 3, b'-texres': 1, b'-type': 1,
}  # fmt: skip


class Map(NamedTuple):
  """A texture in an MTL file."""

  name: str
  scale: tuple[float, float] = (1.0, 1.0)
  offset: tuple[float, float] = (0.0, 0.0)
  clamp: bool = False


class Material(NamedTuple):
  """A material: its colour, alpha and textures."""

  name: str
  color: tuple[float, float, float] | None = None  # Kd as it is written
  dissolve: float = 1.0
  texture: Map | None = None  # map_Kd
  mask: Map | None = None  # map_d
  folder: str = ''  # of the MTL file, where its textures are looked for


def read_mtl(content: bytes, folder: str, notes: set[str]) -> list[Material]:
  """The materials of a file.

  `d` is the alpha, `Tr` its complement; `Tr 1` is ignored, because some programs write it for
  opaque materials. `Kd` with one number is a grey.

  Args:
    content: the file's bytes.
    folder: its folder.
    notes: set that gets notes of guesses.
  """
  materials: list[Material] = []
  for line in read_text(content, notes).split(b'\n'):
    key, _, rest = line.strip().replace(b'\t', b' ').partition(b' ')
    key, rest = key.lower(), rest.strip()
    if key == b'newmtl':
      materials.append(Material(_text(rest), folder=folder))
      continue
    if not materials:
      continue
    change = {}
    numbers = _leading_numbers(rest.split())
    if key == b'kd' and numbers:
      numbers = numbers[:3]
      change['color'] = tuple(numbers + numbers[-1:] * (3 - len(numbers)))
    elif key in (b'd', b'tr'):
      numbers = _leading_numbers(rest.removeprefix(b'-halo').split())
      if numbers:
        alpha = numbers[0] if key == b'd' else 1 - numbers[0] if numbers[0] < 1 else 1.0
        change['dissolve'] = min(max(alpha, 0.0), 1.0)
    elif key in (b'map_kd', b'map_d', b'map_tr'):
      texture = _map(rest)
      if texture.name:
        change['texture' if key == b'map_kd' else 'mask'] = texture
    if change:
      materials[-1] = materials[-1]._replace(**change)
  return materials


def find_material(materials: Mapping[str, Material], name: str, notes: set[str]) -> Material | None:
  """The material that a mesh names.

  Blanks may differ, a comment may follow the name, and case may differ if only one material fits.

  Args:
    materials: by their names.
    name: as the mesh writes it.
    notes: set that gets a note of a guess.
  """
  for n, fold in enumerate((_plain, _without_comment, _without_case)):
    found = [m for key, m in materials.items() if fold(key) == fold(name)]
    if found:
      if n == 2:
        notes.add(notes_lib.MATERIAL_GUESSED)
      return found[0]
  return None


def _plain(name):
  return ' '.join(name.split()).strip('"')


def _without_comment(name):
  return _plain(name).split(' #')[0]


def _without_case(name):
  return _without_comment(name).casefold()


def _map(rest):
  """A `Map` from the text after `map_Kd`: options, then a name that may contain blanks."""
  words = rest.split(b' ')
  found, at = Map(''), 0
  while at < len(words):
    option = words[at].lower()
    if option == b'':
      at += 1
      continue
    if option not in _OPTIONS:
      break
    at += 1
    given: list[bytes] = []
    while at < len(words) - 1 and len(given) < _OPTIONS[option]:
      if words[at]:
        if given and not _leading_numbers([words[at]]):
          break
        given.append(words[at])
      at += 1
    numbers = _leading_numbers(given)
    if option == b'-s' and numbers:
      found = found._replace(scale=tuple((numbers + [1.0])[:2]))
    elif option == b'-o' and numbers:
      found = found._replace(offset=tuple((numbers + [0.0])[:2]))
    elif option == b'-clamp':
      found = found._replace(clamp=given[:1] == [b'on'])
  name = _text(b' '.join(words[at:]).strip())
  return found._replace(name=name.strip('"').strip())


def _text(name):
  return name.decode(errors='replace')


def _leading_numbers(words: Iterable[bytes]) -> list[float]:
  """The words before the first one that is not a number."""
  numbers = []
  for word in words:
    try:
      numbers.append(float(word))
    except ValueError:
      break
  return numbers
