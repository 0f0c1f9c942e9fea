"""Pictures of volumes and flows: pure drawing, numpy and Pillow only.

Images are uint8 [H, W, 3], sRGB, row 0 on top. Volumes are [X, Y, Z, ...] as in cvn.grid, and
cameras are those of cvn.camera, here also raised above the object.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from cvn import camera, grid
from cvn.boundary import Faces, find_faces

WHITE = (255, 255, 255)
SUPERSAMPLING = 2  # pixels are averaged over 2 x 2 samples
AMBIENT = 0.72  # brightness of a face turned away from the light
LIGHT = (-0.45, 0.75, 0.5)  # towards the light: left, up and back from where the viewer looks

# The flow's colour at the image's corners (u, v) = (0, 0), (1, 0), (0, 1), (1, 1), bilinear
# between: blue top left, red top right, green bottom left, yellow bottom right. The four are no
# plane's corners folded over: every (u, v) has a colour of its own.
FLOW_CORNERS = np.array([[0.10, 0.30, 1.00], [1.00, 0.15, 0.45], [0.00, 0.75, 0.30], [1.0, 0.9, 0]])

# The blend weight's colours (paper, Figure "res_vis"): at 0 the regressed colour counts, at 1 the
# sampled one.
WEIGHT_COLORS = np.array([[0.10, 0.25, 0.85], [1.00, 0.87, 0.10]])

MARGIN = 1.03  # of a raised camera's frame around the cube; the level camera's is the same
PANEL_AZIMUTH = 30  # degrees: where a panel shows its volumes from
RESULT_AZIMUTHS = (315, 150)  # degrees: the result's two other sides
FONT_SIZE = 12  # pixels
_TEXT_COLOR = (40, 40, 40)


def flow_color_code(flow: Any) -> Any:
  """The paper's colour code of a flow field (Figure "flow_field", a): a colour for each (u, v).

  Args:
    flow: [..., 2] (u, v) in [0, 1].

  Returns:
    [..., 3] float sRGB in [0, 1].
  """
  u, v = flow[..., :1], flow[..., 1:]
  top = FLOW_CORNERS[0] * (1 - u) + FLOW_CORNERS[1] * u
  bottom = FLOW_CORNERS[2] * (1 - u) + FLOW_CORNERS[3] * u
  return top * (1 - v) + bottom * v


def weight_color_code(weight: Any) -> np.ndarray:
  """Blend weights [...] in [0, 1] -> [..., 3]: yellow trusts the sampled colour, blue the other."""
  w = np.asarray(weight)[..., None]
  return WEIGHT_COLORS[0] * (1 - w) + WEIGHT_COLORS[1] * w


def draw_voxels(
  voxels: grid.ColoredVoxels,
  azimuth: float,
  *,
  elevation: float = 20,
  size: int = 128,
  background: Sequence[int] = WHITE,
) -> np.ndarray:
  """Draws coloured voxels with one light, as seen by a camera that holds the whole cube.

  At elevation 0 this is the camera of the data set's views, so the two can be compared; a raised
  camera sees the cube's corners wider apart and takes a wider angle.

  Args:
    voxels: occupancy [X, X, X] bool and color [X, X, X, 3] in [0, 1].
    azimuth: degrees, as in cvn.camera.
    elevation: degrees above the horizon.
    size: height and width in pixels.
    background: sRGB, 0 to 255.

  Returns:
    uint8 [size, size, 3].
  """
  occupancy = np.asarray(voxels.occupancy, bool)
  color = np.asarray(voxels.color, np.float32)
  n, samples = len(occupancy), size * SUPERSAMPLING
  view = _raised_camera(azimuth, elevation, samples)
  eye = -view.R.T @ view.T

  faces = find_faces(occupancy)
  to_plane = (faces.corners[:, 0] / n - 0.5 - eye)[np.arange(len(faces.axis)), faces.axis]
  faces = Faces(*(x[faces.sign * to_plane < 0] for x in faces))
  # Painter's order: of cubes that fill space, a ray meets the one with the nearer centre first.
  distance = np.linalg.norm(grid.index_to_world(faces.voxel, size=n) - eye, axis=-1)
  faces = Faces(*(x[np.argsort(-distance)] for x in faces))
  light = np.array(LIGHT) / np.linalg.norm(LIGHT) @ (view.R * [[1], [-1], [-1]])
  brightness = AMBIENT + (1 - AMBIENT) * np.maximum(0, faces.sign * light[faces.axis])
  colors = brightness[:, None] * color[tuple(faces.voxel.T)]

  # A face becomes a lattice of points, so dense that each pixel it covers gets one: a square cell
  # is hit for spacings up to 1 / sqrt(2).
  pixel, _ = camera.project(faces.corners / n - 0.5, view)
  edges = np.linalg.norm(pixel - np.roll(pixel, 1, axis=1), axis=-1)
  steps = int(np.ceil(np.sqrt(2) * edges.max(initial=1)))
  x, y = (v.ravel() for v in np.meshgrid(*[(np.arange(steps) + 0.5) / steps] * 2))
  weights = np.stack([(1 - x) * (1 - y), x * (1 - y), x * y, (1 - x) * y], -1)
  column, row = np.moveaxis(weights @ pixel, -1, 0).astype(int)  # [F, points]
  inside = (column >= 0) & (column < samples) & (row >= 0) & (row < samples)
  image = np.empty((samples, samples, 3), np.float32)
  image[:] = np.asarray(background, np.float32) / 255
  owner = np.full((samples, samples), -1)
  face = np.broadcast_to(np.arange(len(colors))[:, None], column.shape)
  owner[row[inside], column[inside]] = face[inside]  # the last one written stays
  image[owner >= 0] = colors[owner[owner >= 0]]
  image = image.reshape(size, SUPERSAMPLING, size, SUPERSAMPLING, 3).mean((1, 3))
  return to_uint8(image)


def to_uint8(image: Any) -> np.ndarray:
  """Colours in [0, 1] -> 0 to 255, rounded."""
  return np.round(np.clip(np.asarray(image), 0, 1) * 255).astype(np.uint8)


def over(image: Any, *, background: Sequence[int] = WHITE) -> np.ndarray:
  """A uint8 image [H, W, 3 or 4] on a plain background: uint8 [H, W, 3]."""
  image = np.asarray(image)
  if image.shape[-1] == 3:
    return image
  alpha = image[..., 3:] / 255
  return to_uint8((image[..., :3] * alpha + np.asarray(background) * (1 - alpha)) / 255)


def enlarge(image: Any, size: int) -> np.ndarray:
  """A uint8 image [H, W, 3 or 4] on white, size x size pixels, none of them smoothed."""
  return np.asarray(Image.fromarray(over(image)).resize((size, size), Image.Resampling.NEAREST))


def trim(rows: Sequence[Sequence[np.ndarray]], *, margin: int = 4) -> list[list[np.ndarray]]:
  """Crops white margins shared by all images of a row (above, below) or column (left, right).

  Args:
    rows: uint8 images [H, W, 3] of one size; rows of one length.
    margin: pixels of white to keep.
  """
  ink = np.any(np.array(rows) < 255, axis=-1)  # [rows, columns, H, W]

  def extent(marked):
    places = np.flatnonzero(marked)
    if len(places) == 0:
      return slice(None)
    return slice(max(0, places[0] - margin), places[-1] + 1 + margin)

  heights = [extent(x) for x in ink.any((1, 3))]
  widths = [extent(x) for x in ink.any((0, 2))]
  return [
    [x[h, w] for x, w in zip(row, widths, strict=True)]
    for row, h in zip(rows, heights, strict=True)
  ]


def stack(images: Sequence[np.ndarray]) -> np.ndarray:
  """Stacks uint8 images [H, W, 3] of any widths, left-aligned on white."""
  canvas = np.empty((sum(len(x) for x in images), max(x.shape[1] for x in images), 3), np.uint8)
  canvas[:] = WHITE
  top = 0
  for image in images:
    canvas[top : top + len(image), : image.shape[1]] = image
    top += len(image)
  return canvas


def grid_of_images(
  rows: Sequence[Sequence[np.ndarray | None]],
  *,
  column_titles: Sequence[str] = (),
  row_titles: Sequence[str] = (),
  gap: int = 4,
  background: Sequence[int] = WHITE,
) -> np.ndarray:
  """Lays images out in rows and columns, with captions.

  Args:
    rows: uint8 images [H, W, 3 or 4] of any sizes, or None for an empty place; rows may be short.
    column_titles: text above each column; a line break makes a second line.
    row_titles: text left of each row.
    gap: pixels around each image.
    background: sRGB, 0 to 255; also what transparent pixels show.

  Returns:
    uint8 [H, W, 3].
  """
  count = max([len(row) for row in rows] + [len(column_titles)])
  cells = [[None if x is None else over(x, background=background) for x in row] for row in rows]
  widths = [
    max([r[c].shape[1] for r in cells if c < len(r) and r[c] is not None] + [1])
    for c in range(count)
  ]
  heights = [max([x.shape[0] for x in row if x is not None] + [1]) for row in cells]
  font = ImageFont.load_default(size=FONT_SIZE)
  measure = ImageDraw.Draw(Image.new('RGB', (1, 1)))

  def extent(text):
    left, top, right, bottom = measure.multiline_textbbox((0, 0), text, font=font)
    return int(np.ceil(right - left)), int(np.ceil(bottom - top)) + 6

  for c, title in enumerate(column_titles):
    widths[c] = max(widths[c], extent(title)[0])
  margin_left = max([extent(t)[0] + 2 * gap for t in row_titles], default=0)
  margin_top = max([extent(t)[1] + gap for t in column_titles], default=0)

  x = margin_left + np.concatenate([[0], np.cumsum(np.array(widths, int) + gap)]) + gap
  y = margin_top + np.concatenate([[0], np.cumsum(np.array(heights, int) + gap)]) + gap
  canvas = np.empty((y[-1], x[-1], 3), np.uint8)
  canvas[:] = background
  for r, row in enumerate(cells):
    for c, image in enumerate(row):
      if image is not None:
        h, w = image.shape[:2]
        left = x[c] + (widths[c] - w) // 2
        canvas[y[r] : y[r] + h, left : left + w] = image

  picture = Image.fromarray(canvas)
  draw = ImageDraw.Draw(picture)
  for c, text in enumerate(column_titles):
    at = (x[c] + widths[c] / 2, margin_top)
    draw.multiline_text(at, text, _TEXT_COLOR, font, anchor='md', align='center')
  for r, text in enumerate(row_titles):
    draw.multiline_text((gap, y[r] + heights[r] / 2), text, _TEXT_COLOR, font, anchor='lm')
  return np.asarray(picture)


def reconstruction_panel(view: np.ndarray, reconstruction: Any, *, size: int = 192) -> np.ndarray:
  """The volumes between a view and its reconstruction (paper, Figure "res_vis").

  Input, flow in the colour code, sampled colour, regressed colour, the blend's weight (yellow: the
  sampled colour counts, blue: the regressed), blended colour, and the result from two other sides.
  The volumes are shown on the result's occupied voxels.

  Args:
    view: uint8 [H, W, 3 or 4].
    reconstruction: a `cvn.infer.Reconstruction` of this view, by a shape and a colour network.
    size: height and width of each image in pixels, at least 160 for the captions.

  Returns:
    uint8 [H, W, 3].
  """

  voxels = grid.ColoredVoxels(
    np.asarray(reconstruction.occupancy), np.asarray(reconstruction.color)
  )

  def on_surface(color):
    return draw_voxels(voxels._replace(color=color), PANEL_AZIMUTH, size=size)

  weight = weight_color_code(reconstruction.weight)
  rows = [
    {
      'input': enlarge(view, size),
      'flow': on_surface(flow_color_code(reconstruction.flow)),
      'sampled': on_surface(reconstruction.sampled),
      'regressed': on_surface(reconstruction.regressed),
    },
    {
      'weight (yellow: sampled)': on_surface(weight),
      'blended': on_surface(reconstruction.color),
      **{f'result from {a}°': draw_voxels(voxels, a, size=size) for a in RESULT_AZIMUTHS},
    },
  ]
  return stack([grid_of_images([list(r.values())], column_titles=list(r)) for r in rows])


def _raised_camera(azimuth: float, elevation: float, size: int) -> camera.Camera:
  """The camera of cvn.camera raised by `elevation` degrees; its frame holds the cube."""
  level = camera.camera_at(azimuth, image_size=size)
  e = np.deg2rad(elevation)
  c, s = np.cos(e), np.sin(e)
  tilt = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
  # The cube turned through all azimuths sweeps a cylinder: one scale then fits every azimuth.
  angle, height = np.meshgrid(np.linspace(0, 2 * np.pi, 72), [-0.5, 0.5])
  rim = np.stack([np.sqrt(0.5) * np.cos(angle), height, np.sqrt(0.5) * np.sin(angle)], -1)
  x, y, z = np.moveaxis(rim @ tilt.T + level.T, -1, 0)
  bound = max(np.abs(x / z).max(), np.abs(y / z).max())
  half_width = max(camera.HALF_WIDTH, MARGIN * bound)
  K = level.K.copy()
  K[0, 0] = K[1, 1] = 0.5 * size / half_width
  return camera.Camera(K, tilt @ level.R, level.T)
