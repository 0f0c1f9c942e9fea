"""Pictures for whole surfaces: boards, tiles, stone, tufts, sheets with a border.

They are stretched over a part (`Material.period` is None) or repeat. Their features are several
voxels wide, and colours of fine features are near each other (`materials.close`).
"""

import numpy as np

from datagen.sources.shapes import materials as mt

SIZE = 256  # texels


def _uv():
  t = (np.arange(SIZE) + 0.5) / SIZE
  return np.meshgrid(t, t[::-1])


def boards(rng, color, count: int) -> mt.Material:
  """Boards side by side along the part, each of its own tone, with grain and dark seams."""
  u, v = _uv()
  at = u * count
  board = np.floor(at).astype(int)
  tone = rng.uniform(0.82, 1.18, count)[board]
  phase = rng.uniform(size=count)[board]
  grain = np.sin(2 * np.pi * (at + 0.25 * np.sin(2 * np.pi * (v + phase)) + phase))
  seam = np.abs(at - np.rint(at)) < 0.05
  rgb = np.asarray(color) * (tone * (1 + 0.07 * grain) * np.where(seam, 0.75, 1.0))[..., None]
  return mt.drawn(np.clip(rgb, 0.06, 0.9))._replace(grain=True)


def tiles(rng, colors, count: int) -> mt.Material:
  """Square tiles of two tones with pale joints, every other one maybe with a mark."""
  u, v = _uv()
  i, j = np.floor(u * count).astype(int), np.floor(v * count).astype(int)
  x, y = u * count % 1 - 0.5, v * count % 1 - 0.5
  ground, other, joint = mt.close(colors, mt.PATTERN)
  odd = (i + j) % 2 == 1
  rgb = np.where(odd[..., None], other, ground)
  if rng.uniform() < 0.5:
    mark = np.abs(x) + np.abs(y) < 0.28 if rng.uniform() < 0.5 else np.hypot(x, y) < 0.26
    rgb[mark & ~odd] = joint
  rgb[np.maximum(np.abs(x), np.abs(y)) > 0.46] = 0.6 * ground + 0.4 * joint
  return mt.drawn(rgb)


def stone(rng, color) -> mt.Material:
  """Clouded stone with veins."""
  u, v = _uv()
  cloud, vein = 0.0, 0.0
  for k in range(1, 4):
    a, b = rng.integers(-k, k + 1), k
    cloud = cloud + np.sin(2 * np.pi * (a * u + b * v + rng.uniform())) / k
    vein = vein + np.sin(2 * np.pi * (b * u - a * v + rng.uniform())) / k
  dark, light = mt.close([mt.shade(color, 0.85), mt.shade(color, 1.15)], 0.25)
  rgb = dark + (0.5 + 0.3 * cloud)[..., None].clip(0, 1) * (light - dark)
  line = np.exp(-((vein / 0.14) ** 2))[..., None]
  toward = mt.close(
    [color, [0.88, 0.86, 0.82] if np.mean(color) < 0.5 else [0.3, 0.28, 0.28]], 0.35
  )
  return mt.drawn(rgb + line * 0.8 * (toward[1] - rgb))


def tufted(color, *, period: float) -> mt.Material:
  """Upholstery drawn in by buttons in staggered rows, with soft folds between them."""
  x, y = _uv()
  fold = np.minimum(np.abs((x + y) % 1 - 0.5), np.abs((x - y) % 1 - 0.5))
  light = 0.82 + 0.36 * np.minimum(fold / 0.5, 1.0)
  near = [np.hypot((x - a) % 1 - 0.5, (y - b) % 1 - 0.5) for a, b in ((0, 0), (0.5, 0.5))]
  light = np.where(np.minimum(*near) < 0.14, 0.66, light)
  return mt.drawn(np.clip(np.asarray(color) * light[..., None], 0.05, 0.92))._replace(period=period)


def bordered(colors, *, width: float, round_: bool) -> mt.Material:
  """A ground with a band along its rim and a medallion in its middle."""
  u, v = _uv()
  x, y = np.abs(2 * u - 1), np.abs(2 * v - 1)
  rim = 1 - (np.hypot(x, y) if round_ else np.maximum(x, y))
  ground, band, mark = mt.close(colors, 0.5)
  rgb = np.broadcast_to(ground, u.shape + (3,)).copy()
  rgb[(rim > width) & (rim < 2.2 * width)] = band
  rgb[np.hypot(x, y) < 0.3] = mark
  return mt.drawn(rgb)
