"""Views of a coloured mesh, with alpha and depth from the same rays, traced by Mitsuba.

Shading is deferred: Mitsuba finds the face that each ray meets, and the colour there is
`datagen.geometry.mesh.albedo`, the function that also colours the voxels. Surfaces have two sides.
A pixel is foreground if the ray through its centre meets the surface, so alpha is 0 or 255 and
edges are hard, as in the authors' data. Its colour is the mean over those of its SAMPLES x SAMPLES
rays that meet the surface. Depth is the distance along the viewing axis, of the centre's ray. Where
alpha is 0, the colour is 0 and the depth infinite.

Rays continue through holes in textures (`datagen.geometry.mesh.is_surface`), up to MAX_LAYERS of
them.
"""

from collections.abc import Sequence
from typing import NamedTuple

import mitsuba as mi
import numpy as np

from cvn.camera import IMAGE_SIZE, Camera, project
from datagen.geometry.mesh import TexturedMesh, albedo, is_surface

SHADINGS = ('flat', 'lit')
SAMPLES = 3  # a pixel's rays along either axis; odd, so that one of them goes through its centre
MAX_LAYERS = 16

# Soft shading: even light from everywhere, and a square lamp above, at the object's front left.
# Radiance seen of a white surface that faces the lamp is about 1.
AMBIENT_RADIANCE = 0.5
LAMP_RADIANCE = 12.0
LAMP_POSITION = (-2.0, 4.0, 3.0)
LAMP_HALF_SIZE = 1.0
LIT_SAMPLES = 36  # rays a pixel, a square for the sampler


class RenderedViews(NamedTuple):
  """V views of one mesh."""

  rgba: np.ndarray  # [V, H, W, 4] u8, sRGB; alpha is 0 or 255
  depth: np.ndarray  # [V, H, W] float32, along the viewing axis in world units; inf where empty
  seen: np.ndarray  # [F] bool, faces that some ray of some view meets


def render(
  mesh: TexturedMesh,
  cameras: Sequence[Camera],
  *,
  image_size: int = IMAGE_SIZE,
  shading: str = 'flat',
) -> RenderedViews:
  """Renders a mesh through each camera.

  Args:
    mesh: the mesh, normalised.
    cameras: pinhole cameras with square pixels, made for `image_size`.
    image_size: height and width of the views in pixels.
    shading: 'flat' shows the albedo; 'lit' adds soft light.

  Returns:
    The views, in the order of the cameras.

  Raises:
    ValueError: an unknown shading.
  """
  if shading not in SHADINGS:
    raise ValueError(f'shading {shading!r} is none of {SHADINGS}')
  mi.set_variant('scalar_rgb')
  shape = to_mitsuba(mesh)
  scene = _scene(shape)
  lit_scene = _lit_scene(shape) if shading == 'lit' else None
  rgba = np.zeros((len(cameras), image_size, image_size, 4), np.uint8)
  depth = np.full((len(cameras), image_size, image_size), np.inf, np.float32)
  seen = np.zeros(len(mesh.faces), bool)
  used = mesh.vertices[np.unique(mesh.faces)]
  for view, camera in enumerate(cameras):
    row, column, face, weight = _trace(mesh, scene, camera, image_size, used)
    seen[face] = True
    central = (row % SAMPLES == SAMPLES // 2) & (column % SAMPLES == SAMPLES // 2)
    row, column = row // SAMPLES, column // SAMPLES
    point = _points(mesh, face[central], weight[central])
    depth[view, row[central], column[central]] = project(point, camera)[1]

    pixel = row * image_size + column
    count = np.bincount(pixel, minlength=image_size**2)
    color = albedo(mesh, face, weight)[:, :3]
    total = [np.bincount(pixel, c, minlength=image_size**2) for c in color.T]
    mean = (np.stack(total, -1) / np.maximum(count, 1)[:, None]).reshape(image_size, image_size, 3)
    if lit_scene is not None:
      mean = _to_srgb(_to_linear(mean) * _irradiance(lit_scene, camera, image_size))
    foreground = np.isfinite(depth[view])
    rgba[view, foreground, :3] = np.round(mean[foreground] * 255)
    rgba[view, foreground, 3] = 255
  return RenderedViews(rgba, depth, seen)


def to_mitsuba(mesh: TexturedMesh):
  """The mesh's triangles after a dummy face: a ray that meets nothing reports face 0."""
  vertices, faces = mesh.vertices, np.concatenate([np.zeros((1, 3), np.int64), mesh.faces])
  white = {'type': 'twosided', 'bsdf': {'type': 'diffuse', 'reflectance': 1.0}}
  properties = mi.Properties()
  properties['bsdf'] = mi.load_dict(white)
  shape = mi.Mesh('mesh', len(vertices), len(faces), props=properties)
  params = mi.traverse(shape)
  params['vertex_positions'] = vertices.astype(np.float32).ravel()
  params['faces'] = faces.astype(np.uint32).ravel()
  params.update()
  return shape


def _scene(shape):
  """A scene of the shape alone."""
  return mi.load_dict({'type': 'scene', 'shape': shape})


def _sensor(camera: Camera, image_size: int, samples: int, sampler: dict, crop: Sequence[int]):
  """Our camera as a Mitsuba sensor, whose axes are x left, y up, z forward.

  Args:
    camera: the camera.
    image_size: height and width of its image in pixels.
    samples: film pixels for each pixel, along either axis.
    sampler: Mitsuba's description of a sampler.
    crop: (left, top, right, bottom) in film pixels; the rest is not rendered.
  """
  to_world = np.eye(4)
  to_world[:3, :3] = (camera.R * [[-1], [-1], [1]]).T
  to_world[:3, 3] = -camera.R.T @ camera.T
  left, top, right, bottom = crop
  size = image_size * samples
  return mi.load_dict(
    {
      'type': 'perspective',
      'fov': float(np.rad2deg(2 * np.arctan(0.5 * image_size / camera.K[0, 0]))),
      'near_clip': 0.01,
      'to_world': mi.ScalarTransform4f(to_world),
      'sampler': sampler,
      'film': {
        'type': 'hdrfilm',
        'width': size,
        'height': size,
        'crop_offset_x': left,
        'crop_offset_y': top,
        'crop_width': right - left,
        'crop_height': bottom - top,
        'rfilter': {'type': 'box'},
        'pixel_format': 'rgba',
        'component_format': 'float32',
      },
    }
  )


def _trace(mesh, scene, camera, image_size, used):
  """The intersections of one view's rays.

  Args:
    mesh: the mesh.
    scene: its Mitsuba scene.
    camera: camera of the view.
    image_size: its height and width in pixels.
    used: [U, 3] the vertices that faces use.

  Returns:
    row, column [N] of the N rays that meet the mesh, in steps of 1 / SAMPLES of a pixel; face [N];
    barycentric weights [N, 3].
  """
  size = image_size * SAMPLES
  corners = project(used, camera)[0] * SAMPLES
  left, top = np.clip(np.floor(corners.min(0)), 0, size - 1).astype(int).tolist()
  right, bottom = np.clip(np.ceil(corners.max(0)), [left + 1, top + 1], size).astype(int).tolist()
  centers = {'type': 'stratified', 'sample_count': 1, 'jitter': False}
  sensor = _sensor(camera, image_size, SAMPLES, centers, (left, top, right, bottom))
  integrator = mi.load_dict({'type': 'aov', 'aovs': 'face:prim_index'})
  number = np.asarray(mi.render(scene, sensor=sensor, integrator=integrator, spp=1))[..., -1]
  row, column = np.nonzero(number > 0.5)
  face = np.round(number[row, column]).astype(np.int64) - 1  # the dummy is no face
  row, column = row + top, column + left

  pixel = np.stack([column + 0.5, row + 0.5, np.full(len(row), float(SAMPLES))], -1) / SAMPLES
  direction = pixel @ (np.linalg.inv(camera.K).T @ camera.R)
  origin = -camera.R.T @ camera.T
  weight = _barycentric(mesh, face, origin, direction)
  face, weight = _look_through(mesh, scene, origin, direction, face, weight)
  hit = face >= 0
  return row[hit], column[hit], face[hit], weight[hit]


def _barycentric(mesh, face, origin, direction):
  """Barycentric weights [N, 3] of rays from one point in the planes of the faces that they meet.

  The weight of a corner is the volume spanned by the ray and the other two corners, seen from the
  origin, divided by the sum of all three.
  """
  met, of_ray = np.unique(face, return_inverse=True)
  a, b, c = np.moveaxis(mesh.vertices[mesh.faces[met]] - origin, 1, 0)
  opposite = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], 1)
  volume = np.einsum('nkc,nc->nk', opposite[of_ray], direction)
  volume *= np.sign(volume.sum(-1, keepdims=True))
  # Mitsuba intersects in float32: a hair outside is on the edge.
  weight = np.maximum(volume, 0)
  total = weight.sum(-1, keepdims=True)
  return np.where(total > 0, weight / np.where(total > 0, total, 1), [1, 0, 0])


def _points(mesh, face, weight):
  """World coordinates [N, 3] of points of faces."""
  return np.einsum('nk,nkc->nc', weight, mesh.vertices[mesh.faces[face]])


def _look_through(mesh, scene, origin, direction, face, weight):
  """Continues rays that met a hole in a texture; face -1 where they meet nothing."""
  at = np.arange(len(face))
  for _ in range(MAX_LAYERS):
    at = at[~is_surface(mesh, face[at], weight[at])]
    if not len(at):
      break
    start = (
      _points(mesh, face[at], weight[at]) + 1e-4 * direction[at]
    )  # in world units: far less than a voxel
    hits = [
      scene.ray_intersect_preliminary(mi.Ray3f(o, d))
      for o, d in zip(start.tolist(), direction[at].tolist(), strict=True)
    ]
    face[at] = [h.prim_index - 1 if h.is_valid() else -1 for h in hits]
    at = at[face[at] >= 0]
    weight[at] = _barycentric(mesh, face[at], origin, direction[at])
  return face, weight


def _lit_scene(shape):
  lamp = mi.ScalarTransform4f().look_at(origin=LAMP_POSITION, target=(0, 0, 0), up=(0, 1, 0))
  return mi.load_dict(
    {
      'type': 'scene',
      'shape': shape,
      'ambient': {'type': 'constant', 'radiance': AMBIENT_RADIANCE},
      'lamp': {
        'type': 'rectangle',
        'to_world': lamp.scale(LAMP_HALF_SIZE),
        'emitter': {'type': 'area', 'radiance': LAMP_RADIANCE},
      },
    }
  )


def _irradiance(scene, camera, image_size):
  """[H, W, 1] light that a white surface reflects to the camera, mean over each pixel's surface.

  It is direct light with soft shadows; a texture's holes cast the shadow of the whole face.
  """
  sampler = {'type': 'multijitter', 'sample_count': LIT_SAMPLES}
  sensor = _sensor(camera, image_size, 1, sampler, (0, 0, image_size, image_size))
  integrator = mi.load_dict({'type': 'direct', 'hide_emitters': True})
  image = np.asarray(mi.render(scene, sensor=sensor, integrator=integrator, spp=LIT_SAMPLES))
  return image[..., :1] / np.maximum(image[..., 3:], 1e-6)


def _to_linear(srgb):
  return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def _to_srgb(linear):
  x = np.clip(linear, 0, 1)
  return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)
