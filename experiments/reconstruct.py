r"""Pictures -> coloured voxel meshes: a GLB, a PLY and a panel PNG for each.

python -m experiments.reconstruct --image=FILE[,FILE...] --shape=WORKDIR --color=WORKDIR \
  --output=DIR

A picture that fails is named on stderr and the others are still done; the exit status is then 1.
"""

import os
import sys
import time
from collections.abc import Sequence

import jax
import numpy as np
from absl import flags
from PIL import Image
from tqdm import tqdm

from cvn import blending, checkpoint, errors, export, figures, photo, reconstruct
from cvn.errors import UserError
from cvn.files import atomic_write

_IMAGE = flags.DEFINE_multi_string(
  'image', None, 'Pictures: names separated by commas; the flag may be repeated.'
)
_SHAPE = flags.DEFINE_string('shape', None, "The trained shape network's workdir.")
_COLOR = flags.DEFINE_string('color', None, "The trained colour network's workdir.")
_OUTPUT = flags.DEFINE_string('output', None, 'The folder the results go to.')
_ALPHA = flags.DEFINE_float(
  'alpha', blending.ALPHA, 'In (0, 1]: the smaller, the more the sampled colours count.'
)
_THRESHOLD = flags.DEFINE_float(
  'threshold', reconstruct.OCCUPIED, 'In (0, 1): the probability from which on a voxel is occupied.'
)
flags.mark_flags_as_required(['image', 'shape', 'color', 'output'])
flags.register_validator('alpha', lambda x: 0 < x <= 1, message='must be in (0, 1]')
flags.register_validator('threshold', lambda x: 0 < x < 1, message='must be in (0, 1)')


def main(_) -> int:
  paths = split_names(_IMAGE.value)
  if not paths:
    raise UserError('--image names no file')
  names = output_names(paths)
  taken = {os.path.realpath(os.path.join(_OUTPUT.value, n + '.png')) for n in names.values()}
  for path in paths:
    if os.path.realpath(path) in taken:
      raise UserError(f'the results would overwrite {path}: give another folder as --output')
  _, shape = checkpoint.load_network(_SHAPE.value, 'shape')
  _, color = checkpoint.load_network(_COLOR.value, 'color')
  failures = 0
  for path in tqdm(paths, unit='picture', disable=None):
    start = time.perf_counter()
    try:
      stem = os.path.join(_OUTPUT.value, names[path])
      count = reconstruct_file(path, stem, shape, color)
    except UserError as e:
      failures += 1
      tqdm.write(f'error: {path}: {str(e).removeprefix(path).lstrip(": ")}', sys.stderr)
      continue
    seconds = time.perf_counter() - start
    tqdm.write(f'{path} -> {stem}.glb .ply .png  ({count} voxels, {seconds:.1f} s)')
  if failures:
    tqdm.write(f'error: {failures} of {len(paths)} pictures failed', sys.stderr)
  return int(failures > 0)


def split_names(values: Sequence[str]) -> list[str]:
  """Names separated by commas, each once; a comma that is part of a file's name stays one."""
  names = []
  for value in values:
    names += [value] if os.path.exists(value) else [v.strip() for v in value.split(',')]
  return list(dict.fromkeys(n for n in names if n))


def output_names(paths: Sequence[str]) -> dict[str, str]:
  """A name for each picture's results: its own, with a number where another has it already."""
  names = {}
  for path in paths:
    stem = os.path.splitext(os.path.basename(path))[0]
    name, number = stem, 1
    while name in names.values():
      number += 1
      name = f'{stem}_{number}'
    names[path] = name
  return names


def reconstruct_file(path: str, stem: str, shape, color) -> int:
  """One picture -> stem.glb, stem.ply and stem.png; returns the number of occupied voxels."""
  view = photo.load_view(path)
  batch = reconstruct.reconstruct(
    shape, color, view[None].astype(np.float32) / 255, alpha=_ALPHA.value
  )
  one = jax.tree.map(lambda x: np.asarray(x)[0], batch)
  voxels = reconstruct.to_voxels(one, _THRESHOLD.value)
  count = int(np.sum(voxels.occupancy))
  if count == 0:
    raise UserError(
      f'no voxel reaches --threshold={_THRESHOLD.value}, the highest probability is'
      f' {one.probability.max():.3g}: lower the threshold, or train the shape network longer'
    )
  export.write_glb(f'{stem}.glb', voxels)
  export.write_ply(f'{stem}.ply', voxels)
  with atomic_write(f'{stem}.png') as temporary:
    Image.fromarray(figures.reconstruction_panel(view, one, voxels)).save(temporary)
  return count


if __name__ == '__main__':
  errors.run(main)
