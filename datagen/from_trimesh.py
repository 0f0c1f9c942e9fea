"""What trimesh makes of a file -> a `TexturedMesh`: its materials, textures and scene graph."""

import io

import numpy as np
import PIL.Image
import trimesh
from trimesh.visual.color import DEFAULT_COLOR
from trimesh.visual.material import PBRMaterial

from cvn.errors import UserError
from datagen.images import to_rgba
from datagen.mesh import CUTOUT_ALPHA, NO_COLOR, TexturedMesh

INVISIBLE_ALPHA = 0.05  # a material with less is a modeller's helper, no glass: faces are dropped
MAX_TEXTURE_SIDE = 2048  # pixels; larger images are shrunk, a voxel covers 30 of these anyway
MAX_TEXTURES = 1 << 29  # bytes that all textures of a mesh may take


def from_trimesh(loaded: trimesh.Scene | trimesh.Trimesh, *, gltf: bool = False) -> TexturedMesh:
  """All triangles of a scene, in the scene's frame, with their colours.

  Material, vertex and face colours and the texture multiply in glTF. In other files a texture
  stands alone: MTL's text says that `Kd` multiplies `map_Kd`, but exporters write there what the
  texture replaces (0 0 0, a grey, the texture's mean), and the product is far too dark. A black
  material leaves vertex colours alone likewise.

  A texture is real when it was read from a file or is larger than 2x2 pixels: trimesh puts a 2x2
  one of its own where there is none. Without texture coordinates it is taken as its mean colour.

  Faces without area and faces of invisible materials are left out.

  Args:
    loaded: what trimesh made of a file.
    gltf: the file is glTF, where factors and vertex colours are linear (they are converted to
      sRGB; textures are sRGB already) and where alpha counts only if the material's mode says so.
      Files written by trimesh are no exception, although it writes sRGB values there unconverted:
      every viewer shows such a file too light.

  Returns:
    The mesh; not normalised, and not checked.

  Raises:
    OSError, ValueError: a texture that is no image.
    UserError: textures that are too large together, or faces without vertices.
  """
  scene = loaded if isinstance(loaded, trimesh.Scene) else trimesh.Scene(loaded)
  parts, textures, files, known = [_EMPTY], [], {}, {}
  offset = 0
  for node in scene.graph.nodes_geometry:
    transform, name = scene.graph[node]
    geometry = scene.geometry[name]
    if not isinstance(geometry, trimesh.Trimesh) or not len(geometry.faces):
      continue  # points and paths have no surface
    vertices = trimesh.transform_points(np.asarray(geometry.vertices, np.float64), transform)
    faces = np.asarray(geometry.faces, np.int64)
    if faces.min() < 0 or faces.max() >= len(vertices):
      raise UserError(f'a face names a vertex that is not there: there are {len(vertices)}')
    colors, uv, picture = _appearance(geometry, gltf)
    texture = -1
    if picture is not None:
      image, cutoff = picture
      file = files.setdefault(id(image), _file_of(image))
      texture = known.setdefault((file, cutoff), len(textures))
      if texture == len(textures):
        textures.append(_pixels(image, cutoff))
        if sum(pixels.nbytes for pixels in textures) > MAX_TEXTURES:
          raise UserError(f'its textures take more than {MAX_TEXTURES >> 20} MiB')
    if texture >= 0 and uv is None:
      colors *= textures[texture].mean((0, 1), dtype=np.float32) / np.float32(255)
      texture = -1
    if texture < 0:
      uv = np.zeros((len(faces), 3, 2), np.float32)
    keep = _has_area(vertices, faces) & (colors[..., 3].max(-1) >= INVISIBLE_ALPHA)
    used = np.zeros(len(vertices), bool)
    used[faces[keep]] = True
    vertices[~used] = 0  # they may be anything, NaN too
    # A mirroring transform turns faces inside out: their corners go backwards.
    corners = [2, 1, 0] if np.linalg.det(transform[:3, :3]) < 0 else [0, 1, 2]
    parts.append(
      (
        vertices,
        (faces + offset)[keep][:, corners],
        colors[keep][:, corners],
        uv[keep][:, corners],
        np.full(np.count_nonzero(keep), texture, np.int32),
      )
    )
    offset += len(vertices)
  arrays = (np.concatenate(column) for column in zip(*parts, strict=True))
  return TexturedMesh(*arrays, tuple(textures))


_EMPTY = (
  np.zeros((0, 3)),
  np.zeros((0, 3), np.int64),
  np.zeros((0, 3, 4), np.float32),
  np.zeros((0, 3, 2), np.float32),
  np.zeros(0, np.int32),
)


def _has_area(vertices, faces):
  """[F] bool; true also for faces with NaN, which `check` is to see."""
  with np.errstate(invalid='ignore', over='ignore'):
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return (np.cross(b - a, c - a) != 0).any(-1)


def _appearance(geometry, gltf):
  """One geometry's (corner colours [F, 3, 4], uv [F, 3, 2] or None, arguments of `_pixels`)."""
  faces, visual = geometry.faces, geometry.visual
  vertex, face = geometry.vertex_attributes.get('color'), geometry.face_attributes.get('color')
  material, uv, picture = None, None, None
  if visual.kind == 'texture':
    material, picture = _material(visual.material, gltf)
    vertex = visual.vertex_attributes.get('color', vertex)  # COLOR_0 beside a material
    if visual.uv is not None and np.shape(visual.uv) == (len(geometry.vertices), 2):
      # Each face moves to the first tile: far from 0, float32 has no digits left for a texel.
      uv = np.where(np.abs(visual.uv) < 1e9, visual.uv, 0)[faces]  # nor NaN
      uv = (uv - np.floor(uv.min(1, keepdims=True))).astype(np.float32)
  elif visual.kind == 'vertex':
    vertex = visual.vertex_colors
  elif visual.kind == 'face':
    face = visual.face_colors

  colors = np.ones((len(faces), 3, 4), np.float32)
  if vertex is not None:
    vertex = _as_rgba(vertex)
    colors *= (_linear_to_srgb(vertex) if gltf else vertex)[faces]
  if face is not None:
    colors *= _as_rgba(face)[:, None]
  others = not (picture is None and vertex is None and face is None)
  if material is None or (others and not gltf and not material[:3].any()):
    colors[..., :3] *= 1 if others else NO_COLOR
    colors[..., 3] *= 1 if material is None else material[3]
  else:
    colors *= material
  return colors, uv, picture


def _material(material, gltf):
  """(RGBA [4] or None where the material has no colour, arguments of `_pixels` or None)."""
  cutoff = None
  if isinstance(material, PBRMaterial):
    image, color = material.baseColorTexture, material.baseColorFactor
    color = np.ones(4, np.float32) if color is None else _as_rgba(color)
    if gltf:
      color = _linear_to_srgb(color)
      if material.alphaMode == 'MASK':
        cutoff = 0.5 if material.alphaCutoff is None else material.alphaCutoff
        cutoff /= max(color[3], 1e-6)
      elif material.alphaMode != 'BLEND':
        cutoff = 0.0
      color[3] = 1 if cutoff is not None else color[3]
  else:
    image = getattr(material, 'image', None)
    mtl = getattr(material, 'kwargs', {})
    # `diffuse` is `Kd` cut off at 1, or a grey of trimesh's own where there is none.
    color = mtl.get('kd', getattr(material, 'diffuse', None))
    color = None if color is None or np.array_equal(color, DEFAULT_COLOR) else _as_rgba(color)
    alpha = _dissolve(mtl)
    if color is not None:
      color[3] *= alpha
  if image is None or (image.format is None and max(image.size) <= 2):
    return color, None
  if not gltf and color is not None:
    color[:3] = 1
  return color, (image, cutoff)


def _dissolve(mtl):
  """The alpha of an MTL material, from `d` or its complement `Tr`; 1 where neither is given.

  `Tr 1` is ignored: some programs mean opaque by it.
  """
  for name, alpha in (('d', lambda x: x), ('tr', lambda x: 1 - x if x < 1 else 1.0)):
    try:
      return float(np.clip(alpha(float(mtl[name][-1])), 0, 1))
    except (KeyError, IndexError, ValueError):
      continue
  return 1.0


def _file_of(image):
  """What is the same for two images that were opened from the same content."""
  stream = getattr(image, 'fp', None)
  return stream.getvalue() if isinstance(stream, io.BytesIO) and not stream.closed else id(image)


def _pixels(image: PIL.Image.Image, cutoff: float | None) -> np.ndarray:
  """[H, W, 4] uint8 of an image; alpha is cut at `cutoff` to 0 and 255 where that is given."""
  pixels = to_rgba(image, MAX_TEXTURE_SIDE)
  if cutoff is not None:
    pixels[..., 3] = np.where(pixels[..., 3] >= 255 * cutoff, 255, 0)
  if pixels[..., 3].max() < 255 * CUTOUT_ALPHA:
    pixels[..., 3] = 255  # glass, or an alpha that means something else: a hole has a rim
  return pixels


def _as_rgba(colors):
  """[..., 3 or 4] of any type -> [..., 4] float32 in [0, 1]."""
  colors = np.asarray(colors)
  if colors.dtype.kind in 'iu':
    colors = colors / np.float32(np.iinfo(colors.dtype).max)
  colors = np.nan_to_num(colors).astype(np.float32)
  if colors.size and colors.max() > 2:  # floats that count to 255
    colors = colors / np.float32(255)
  if colors.shape[-1] == 3:
    colors = np.concatenate([colors, np.ones_like(colors[..., :1])], -1)
  return np.clip(colors, 0, 1)


def _linear_to_srgb(rgba):
  """IEC 61966-2-1's curve on the first three channels."""
  rgb = rgba[..., :3]
  curve = np.where(
    rgb <= 0.0031308, 12.92 * rgb, 1.055 * np.maximum(rgb, 1e-6) ** (1 / 2.4) - 0.055
  )
  return np.concatenate([curve.astype(np.float32), rgba[..., 3:]], -1)
