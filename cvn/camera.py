"""The pinhole camera of the twelve views, and the projection K [R T] (paper, section 3.3).

Camera axes: x right, y down, z forward. Pixel coordinates are continuous, (0, 0) is the top-left
corner of the image and pixel (row, column) has its centre at (column + 0.5, row + 0.5). An
appearance-flow coordinate (u, v) is a pixel coordinate divided by the image's size: in [0, 1],
u right, v down.

The camera circles the object at elevation 0: at azimuth a it stands at
DISTANCE * (sin a, 0, cos a) and looks at the origin, so azimuth 0 sees the object's front (+z) and
azimuth 90 degrees the side that faces +x. The frame holds the whole cube [-0.5, 0.5]^3 at every
azimuth. Functions take numpy and jax arrays alike; matrices are made with numpy, in float64.
"""

from typing import Any, NamedTuple

import numpy as np

IMAGE_SIZE = 128
AZIMUTHS = tuple(range(0, 360, 30))  # degrees
DISTANCE = 2.0  # from the camera's centre to the world's origin
HALF_WIDTH = 0.4  # tangent of half the angle of view; the cube's own bound is 0.387


class Camera(NamedTuple):
  """A pinhole camera: pixel ~ K (R x + T)."""

  K: Any  # [3, 3] intrinsics, pixels
  R: Any  # [3, 3] rotation from world to camera axes
  T: Any  # [3] translation, world units


def camera_at(azimuth: float, *, image_size: int = IMAGE_SIZE) -> Camera:
  """The camera at an azimuth in degrees."""
  a = np.deg2rad(azimuth)
  focal = 0.5 * image_size / HALF_WIDTH
  center = 0.5 * image_size
  K = np.array([[focal, 0, center], [0, focal, center], [0, 0, 1]])
  R = np.array(
    [
      [np.cos(a), 0, -np.sin(a)],
      [0, -1, 0],
      [-np.sin(a), 0, -np.cos(a)],
    ]
  )
  return Camera(K, R, np.array([0.0, 0.0, DISTANCE]))


def project(points: Any, camera: Camera) -> tuple[Any, Any]:
  """Projects world points through K [R T].

  >>> pixel, depth = project(np.zeros(3), camera_at(0))  # the origin, in 128 x 128 pixels
  >>> pixel.tolist(), float(depth)
  ([64.0, 64.0], 2.0)

  Args:
    points: [..., 3] world coordinates, in front of the camera.
    camera: the camera.

  Returns:
    (pixel, depth): continuous pixel coordinates [..., 2] as (right, down), and the distance along
    the viewing axis [...] in world units.
  """
  p = points @ camera.R.T + camera.T.reshape((1,) * (points.ndim - 1) + (3,))
  q = p @ camera.K.T
  return q[..., :2] / q[..., 2:], p[..., 2]
