"""Parts, the common form of all readers, and their assembly to a `TexturedMesh`.

A part has vertices in the scene's frame, a colour at each corner of its faces that already combines
material, vertex and face colour (sRGB), and images with a sampler each. The readers decide what a
colour means; here images are decoded and invisible faces left out.

Corner alpha below 1 is glass; a face below `INVISIBLE_ALPHA` is a modelling aid and left out. The
same holds for each pixel of an image whose alpha blends. An image whose alpha masks has holes.
"""

import io
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import PIL.Image
from scipy import ndimage

from cvn.errors import UserError
from datagen.geometry.mesh import CUTOUT_ALPHA, REPEAT, TexturedMesh
from datagen.reading import notes as notes_lib
from datagen.reading.images import check_image, to_rgba

INVISIBLE_ALPHA = 0.05
MAX_TEXTURE_SIDE = 2048  # pixels; larger images are shrunk, a voxel covers 30 of these anyway
MAX_TEXTURES = 1 << 29  # bytes that all textures of a mesh may take
RIM = 5  # pixels: where alpha is between 0 and 1 all around this far, it is glass and no rim

OPAQUE, MASK, BLEND, UNKNOWN = 'opaque', 'mask', 'blend', 'unknown'  # what a picture's alpha means


class Picture(NamedTuple):
  """An image file used as a texture."""

  content: bytes
  name: str  # for messages
  alpha: str = UNKNOWN
  cutoff: float = CUTOUT_ALPHA  # of MASK
  wrap: tuple[str, str] = REPEAT  # along u and v
  mask: bytes | None = None  # another picture: its alpha or, without, its grey is the alpha
  color: tuple[float, ...] | None = None  # with a mask alone: the colour that it masks


class Part(NamedTuple):
  """V vertices and F triangles of one piece of a scene."""

  vertices: np.ndarray  # [V, 3] float64
  faces: np.ndarray  # [F, 3] int64
  colors: np.ndarray  # [F, 3, 4] float32, sRGB and alpha
  uv: np.ndarray | None = None  # [F, 3, 2] float64, v up; NaN where a face has none
  texture: np.ndarray | None = None  # [F] int32 into `pictures`; -1 where a face has none
  pictures: tuple[Picture, ...] = ()


def placed(part: Part, matrix: np.ndarray) -> Part:
  """A part moved by a [4, 4] matrix. If it mirrors, faces are flipped and still look outwards."""
  vertices = part.vertices @ matrix[:3, :3].T + matrix[:3, 3]
  if not np.linalg.det(matrix[:3, :3]) < 0:
    return part._replace(vertices=vertices)
  return part._replace(
    vertices=vertices,
    faces=part.faces[:, ::-1],
    colors=part.colors[:, ::-1],
    uv=None if part.uv is None else part.uv[:, ::-1],
  )


def assemble(parts: Iterable[Part], notes: set[str]) -> TexturedMesh:
  """Joins all parts to one mesh, not normalised and not checked.

  Faces without area and invisible faces are left out. If nothing would remain, alpha is ignored:
  nobody makes an invisible model.

  Args:
    parts: the parts of the scene.
    notes: set that gets notes of what is ignored.

  Raises:
    UserError: an unreadable image, textures that are too large together, or faces with vertices
      that do not exist.
  """
  columns: list[tuple] = [_EMPTY]
  textures: list[np.ndarray] = []
  wraps: list[tuple[str, str]] = []
  known: dict[Picture, int] = {}
  offset, size = 0, 0
  for part in parts:
    if not len(part.faces):
      continue
    if part.faces.min() < 0 or part.faces.max() >= len(part.vertices):
      raise UserError(
        f'a face names a vertex that is out of bounds: there are {len(part.vertices)}'
      )
    slots = []
    for picture in part.pictures:
      key = picture._replace(name='')  # the same content under two names is one texture
      if key not in known:
        known[key] = len(textures)
        textures.append(_pixels(picture, notes))
        wraps.append(picture.wrap)
        size += textures[-1].nbytes
        if size > MAX_TEXTURES:
          raise UserError(f'its textures take more than {MAX_TEXTURES >> 20} MiB')
      slots.append(known[key])
    colors, uv, texture = _laid_on(part, slots, textures, wraps, notes)
    keep = _has_area(part.vertices, part.faces)
    used = np.zeros(len(part.vertices), bool)
    used[part.faces[keep]] = True
    # Other vertices may be anything, NaN too.
    vertices = np.where(used[:, None], part.vertices, 0)
    columns.append((vertices, part.faces[keep] + offset, colors[keep], uv[keep], texture[keep]))
    offset += len(vertices)
  vertices, faces, colors, uv, texture = (
    np.concatenate(column) for column in zip(*columns, strict=True)
  )
  visible = colors[..., 3].max(-1, initial=0) >= INVISIBLE_ALPHA
  if not visible.all():
    if visible.any():
      faces, colors, uv, texture = (a[visible] for a in (faces, colors, uv, texture))
    else:
      notes.add(notes_lib.ALPHA_IGNORED)
      colors[..., 3] = 1
  return TexturedMesh(vertices, faces, colors, uv, texture, tuple(textures), wraps=tuple(wraps))


_EMPTY = (
  np.zeros((0, 3)),
  np.zeros((0, 3), np.int64),
  np.zeros((0, 3, 4), np.float32),
  np.zeros((0, 3, 2), np.float32),
  np.zeros(0, np.int32),
)


def _has_area(vertices, faces):
  """[F] bool; also True for faces with NaN, so that `check` finds them."""
  with np.errstate(invalid='ignore', over='ignore'):
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return (np.cross(b - a, c - a) != 0).any(-1)


def _laid_on(part, slots, textures, wraps, notes):
  """Colours, uv [F, 3, 2] float32 and texture [F] of a part.

  A texture without texture coordinates becomes its mean colour.
  """
  colors, count = part.colors, len(part.faces)
  uv, texture = np.zeros((count, 3, 2), np.float32), np.full(count, -1, np.int32)
  if not slots or part.texture is None:
    return colors, uv, texture
  given = np.zeros((count, 3, 2)) if part.uv is None else part.uv
  has_uv = np.zeros(count, bool) if part.uv is None else ~np.isnan(part.uv).any((1, 2))
  colors = colors.copy()
  for n, slot in enumerate(slots):
    of_it = part.texture == n
    bare = of_it & ~has_uv
    if bare.any():
      notes.add(notes_lib.NO_COORDINATES if not has_uv[of_it].any() else notes_lib.BAD_COORDINATES)
      colors[bare] *= textures[slot].mean((0, 1), dtype=np.float32) / np.float32(255)
      colors[bare, :, 3] = part.colors[bare, :, 3]
    of_it &= has_uv
    texture[of_it] = slot
    uv[of_it] = _near_zero(given[of_it], wraps[slot])
  return colors, uv, texture


def _near_zero(uv, wrap):
  """Moves each face to the first tile: far from 0, float32 cannot resolve a texel."""
  uv = np.where(np.abs(uv) < 1e9, uv, 0)
  for axis, mode in enumerate(wrap):
    if mode == 'clamp':
      uv[..., axis] = uv[..., axis].clip(-1e4, 1e4)
    else:
      period = 2 if mode == 'mirror' else 1
      low = uv[..., axis].min(1, keepdims=True)
      uv[..., axis] -= period * np.floor(low / period)
  return uv.astype(np.float32)


def _pixels(picture, notes):
  """[H, W, 4] uint8 of an image, with alpha 0 in holes and 255 elsewhere."""
  pixels = None if picture.color is not None else _opened(picture.content, picture.name)
  if picture.mask is not None:
    mask = _opened(picture.mask, picture.name)
    solid = mask[..., 3].min() == 255
    alpha = mask[..., :3].mean(-1).astype(np.uint8) if solid else mask[..., 3]
    if pixels is None:
      pixels = np.empty((*alpha.shape, 4), np.uint8)
      pixels[..., :3] = np.round(255 * np.array(picture.color[:3]))
    else:
      height, width = pixels.shape[:2]
      if alpha.shape != (height, width):
        alpha = np.asarray(PIL.Image.fromarray(alpha).resize((width, height)))
    pixels[..., 3] = alpha
  alpha = pixels[..., 3]
  if picture.alpha == OPAQUE or alpha.min() == 255:
    solid = np.True_
  elif picture.alpha == MASK:
    solid = alpha >= 255 * picture.cutoff
  elif picture.alpha == BLEND:
    solid = alpha >= 255 * INVISIBLE_ALPHA
  else:  # a rim is cut in its middle, but a wide stretch of half an alpha is glass
    seen = alpha >= 255 * INVISIBLE_ALPHA
    solid = (alpha >= 255 * CUTOUT_ALPHA) | ndimage.minimum_filter(seen, RIM, mode='wrap')
  if not solid.any():  # an alpha that means something else
    notes.add(notes_lib.ALPHA_IGNORED)
    solid = np.True_
  pixels[..., 3] = np.where(solid, 255, 0)
  return pixels


def _opened(content, name):
  try:
    check_image(content)
  except UserError as e:
    raise UserError(f'{name} {e}') from e
  try:
    with PIL.Image.open(io.BytesIO(content)) as image:
      return to_rgba(image, MAX_TEXTURE_SIDE)
  except MemoryError:
    raise
  except Exception as e:  # PIL's readers raise whatever broken data lead them to
    raise UserError(f'{name} is a damaged image: {" ".join(str(e).split())[:100]}') from e
