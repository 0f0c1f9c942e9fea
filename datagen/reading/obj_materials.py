"""The materials of an OBJ file, applied to its faces."""

import numpy as np

from datagen.reading import notes as notes_lib
from datagen.reading.colors import as_rgba, grey
from datagen.reading.mtl import Material, find_material, read_mtl
from datagen.reading.parts import MASK, UNKNOWN, Part, Picture
from datagen.reading.surroundings import Surroundings, find_named


def named_materials(
  names: list[str], libraries: list[str], used: np.ndarray, around: Surroundings
) -> list[Material | None]:
  """The material of each name; an undefined one is added to `missing`.

  Args:
    names: the names in the OBJ file's `usemtl` lines, in order.
    libraries: the files in its `mtllib` lines.
    used: [F] indices of the faces' names; -1 for a face without one.
    around: the file's surroundings.

  Returns:
    A `Material` or None for each name, and one more for faces without a name: the only material, if
    there is just one.
  """
  found: dict[str, Material] = {}
  lost = False
  files = []
  for library in libraries:
    file = find_named(around, library)
    if file is None and len(library.split()) > 1:  # several names in one line
      around.missing.discard(library.strip().strip('"\'').strip())
      several = [find_named(around, name) for name in library.split()]
      files += [f for f in several if f is not None]
      lost |= None in several
    elif file is None:
      lost = True
    else:
      files.append(file)
  if not files and (names or libraries):  # one of the mesh's own name, as after renaming
    name = f'{around.stem}.mtl'
    there = name in around.missing
    file = find_named(around, name)
    if file is not None:
      files.append(file)
      around.notes.add(notes_lib.MATERIAL_GUESSED)
    elif not there:
      around.missing.discard(name)
  for name, content in files:
    folder = name.rpartition('/')[0]
    own = {material.name: material for material in read_mtl(content, folder, around.notes)}
    found = own | found  # of a name that is there again, a file's last and the first file's
  result: list[Material | None] = []
  resolved: dict[str, Material | None] = {}
  met = set(used.tolist())
  for n, name in enumerate(names):
    if name not in resolved and n in met:
      resolved[name] = find_material(found, name, around.notes)
      if resolved[name] is None and not lost and name.strip():
        around.missing.add(f'material {name.strip()}')
    result.append(resolved.get(name))
  alone = next(iter(found.values())) if len(found) == 1 else None
  if alone is not None and -1 in met:
    around.notes.add(notes_lib.MATERIAL_GUESSED)
  return [*result, alone]


def dressed(
  part: Part,
  uv: np.ndarray | None,
  material: np.ndarray,
  materials: list[Material | None],
  around: Surroundings,
) -> Part:
  """A part with the colours and textures of its faces' materials.

  Args:
    part: its colours are those of its vertices, NaN where they have none.
    uv: [F, 3, 2] as in the file, NaN where a face has none.
    material: [F] indices into `materials`; -1 is the last.
    materials: from `named_materials`.
    around: the file's surroundings.
  """
  colors, count = part.colors, len(part.faces)
  own = ~np.isnan(colors[..., 0]).any(1)
  result = np.where(own[:, None, None], colors, grey(count))
  result[..., 3] = 1
  texture = np.full(count, -1, np.int32)
  uv = np.full((count, 3, 2), np.nan) if uv is None else uv
  pictures: list[Picture] = []
  slots: dict[tuple, int] = {}
  for n, described in enumerate(materials):
    n = n if n < len(materials) - 1 else -1
    of_it = np.flatnonzero(material == n) if described is not None else ()
    if not len(of_it):
      continue
    color = described.color
    if color is not None:
      rgba = as_rgba(np.array(color), around.notes)
      plain = of_it[~own[of_it]]
      result[plain, :, :3] = rgba[:3]
    result[of_it, :, 3] = described.dissolve
    picture = _picture(described, around)
    if picture is None:
      continue
    if picture.color is None:
      if own[of_it].any():
        around.notes.add(notes_lib.COLORS_IGNORED)
      result[of_it, :, :3] = 1
    else:
      result[of_it, :, :3] = np.where(own[of_it, None, None], result[of_it, :, :3], 1)
    laid = described.texture or described.mask
    uv[of_it] = uv[of_it] * laid.scale + laid.offset
    texture[of_it] = slots.setdefault(picture, len(slots))
    if len(slots) > len(pictures):
      pictures.append(picture)
  return part._replace(colors=result, uv=uv, texture=texture, pictures=tuple(pictures))


def _picture(material, around):
  """The `Picture` of a material, or None if it names none or none exists."""
  texture = mask = None
  if material.texture is not None:
    texture = find_named(around, material.texture.name, material.folder)
  if material.mask is not None:
    mask = find_named(around, material.mask.name, material.folder)
  if texture is None and mask is None:
    return None
  if texture is not None and mask is not None:
    if material.mask._replace(name='') != material.texture._replace(name=''):
      around.notes.add(notes_lib.MASK_OPTIONS)
  laid = material.texture if texture is not None else material.mask
  wrap = ('clamp', 'clamp') if laid.clamp else ('repeat', 'repeat')
  color = None
  if texture is None:
    color = tuple(float(c) for c in as_rgba(np.array(material.color or (0.6, 0.6, 0.6)))[:3])
  name, content = texture or mask
  return Picture(
    content, name, MASK if mask else UNKNOWN, wrap=wrap, mask=mask and mask[1], color=color
  )
