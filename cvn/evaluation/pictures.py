"""Rendered images of a coloured shape compared with those of the true shape: PSNR and SSIM.

Both shapes are drawn without light by the same simple renderer: each voxel covers the pixels whose
centres lie in the bounding box of its projection, nearer voxels cover farther ones. The cameras are
those of the data set (cvn.camera).
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from skimage.metrics import structural_similarity

from cvn import camera, grid
from cvn.data import GREY
from cvn.grid import ColoredVoxels

CEILING = 58.9  # dB: what rounding to 8 bits allows


class Likeness(NamedTuple):
  """Means over the pictures."""

  psnr: float  # dB
  ssim: float


class Pictures(NamedTuple):
  """A shape seen from all around."""

  azimuths: tuple[float, ...]  # degrees
  images: np.ndarray  # [A, H, W, 3] float in [0, 1]


def draw_all(
  voxels: ColoredVoxels,
  *,
  azimuths: Sequence[float] = camera.AZIMUTHS,
  image_size: int = camera.IMAGE_SIZE,
) -> Pictures:
  """Pictures of a coloured shape from all azimuths.

  Args:
    voxels: occupancy [X, X, X] bool, color [X, X, X, 3] in [0, 1].
    azimuths: degrees.
    image_size: in pixels.
  """
  images = [draw(voxels, a, image_size=image_size) for a in azimuths]
  return Pictures(tuple(azimuths), np.stack(images))


def compare(predicted: ColoredVoxels, true: Pictures) -> Likeness:
  """The mean PSNR and SSIM of a shape's pictures.

  No picture counts for more than `CEILING`. SSIM has Gaussian windows (Wang et al. 2004).

  Args:
    predicted: occupancy [X, X, X] bool, color [X, X, X, 3] in [0, 1].
    true: of the true shape.
  """
  options = {'gaussian_weights': True, 'sigma': 1.5, 'use_sample_covariance': False}
  psnrs, ssims = [], []
  for azimuth, image in zip(true.azimuths, true.images, strict=True):
    drawn = draw(predicted, azimuth, image_size=len(image))
    error = np.mean((drawn - image) ** 2)
    psnrs.append(CEILING if error == 0 else min(CEILING, -10 * np.log10(error)))
    ssims.append(structural_similarity(drawn, image, channel_axis=-1, data_range=1, **options))
  return Likeness(float(np.mean(psnrs)), float(np.mean(ssims)))


def draw(
  voxels: ColoredVoxels, azimuth: float, *, image_size: int = camera.IMAGE_SIZE
) -> np.ndarray:
  """Coloured voxels on grey, [H, W, 3] float in [0, 1].

  Args:
    voxels: occupancy [X, X, X] bool, color [X, X, X, 3] in [0, 1].
    azimuth: degrees.
    image_size: H = W, in pixels.
  """
  occupancy: Any = np.asarray(voxels.occupancy, bool)
  index = np.argwhere(occupancy)
  color = np.asarray(voxels.color, np.float64)[occupancy]
  view = camera.camera_at(azimuth, image_size=image_size)
  size = len(occupancy)
  center = grid.index_to_world(index, size=size)
  eye = -view.R.T @ view.T
  order = np.argsort(-np.linalg.norm(center - eye, axis=-1), kind='stable')
  center, color = center[order], color[order]
  corners = np.stack(np.meshgrid(*[[-0.5 / size, 0.5 / size]] * 3, indexing='ij'), -1)
  pixel, _ = camera.project(center[:, None] + corners.reshape(1, 8, 3), view)
  first = np.ceil(pixel.min(1) - 0.5).astype(int)  # (column, row)
  count = np.floor(pixel.max(1) - 0.5).astype(int) - first + 1
  image = np.full((image_size, image_size, 3), GREY)
  # The voxel that covers a pixel last is the nearest one: voxels come from far to near.
  owner = np.full((image_size, image_size), -1)
  number = np.arange(len(center))
  for down in range(count[:, 1].max(initial=0)):
    for right in range(count[:, 0].max(initial=0)):
      column, row = first[:, 0] + right, first[:, 1] + down
      inside = (right < count[:, 0]) & (down < count[:, 1])
      inside &= (column >= 0) & (column < image_size) & (row >= 0) & (row < image_size)
      np.maximum.at(owner, (row[inside], column[inside]), number[inside])
  image[owner >= 0] = color[owner[owner >= 0]]
  return image
