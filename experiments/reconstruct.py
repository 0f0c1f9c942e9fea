r"""Images -> coloured voxel meshes: a GLB, a PLY and a panel PNG for each.

python -m experiments.reconstruct --image=FILE[,FILE...] --shape=WORKDIR --color=WORKDIR \
  --output=DIR [--alpha=0.2] [--threshold=0.8] [--flip] [--carve]

An image that fails is reported on stderr and the others are still reconstructed; the exit status is
then 1.
"""

import os
import sys
import time
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np
from absl import flags
from PIL import Image
from tqdm import tqdm

from cvn import blending, export, figures, infer, metrics, photo
from cvn.errors import UserError
from cvn.files import atomic_write
from cvn.infer import Network
from experiments.lib import cli


def define_flags(f: flags.FlagValues) -> None:
  own = {'flag_values': f}
  flags.DEFINE_multi_string(
    'image', None, 'Image files separated by commas; the flag may be repeated.', **own
  )
  flags.DEFINE_string('shape', None, 'Workdir of the shape network.', **own)
  flags.DEFINE_string('color', None, 'Workdir of the colour network.', **own)
  flags.DEFINE_string('output', None, 'Folder for the results.', **own)
  flags.DEFINE_float(
    'alpha',
    blending.ALPHA,
    'Blend factor in (0, 1]: the smaller, the more weight the sampled colours get.',
    **own,
  )
  flags.DEFINE_float(
    'threshold', metrics.OCCUPIED, 'Occupancy threshold in (0, 1), a probability.', **own
  )
  flags.DEFINE_bool('flip', False, 'Test-time augmentation: average with the mirrored view.', **own)
  flags.DEFINE_bool(
    'carve',
    False,
    "Carve the shape by the object's silhouette, seen from the azimuth of the data set's views that"
    ' fits best. Only for images framed like the training views.',
    **own,
  )
  flags.mark_flags_as_required(['image', 'shape', 'color', 'output'], f)
  flags.register_validator('alpha', lambda x: 0 < x <= 1, 'must be in (0, 1]', f)
  flags.register_validator('threshold', lambda x: 0 < x < 1, 'must be in (0, 1)', f)


@cli.program(define_flags)
def main(f: flags.FlagValues) -> int:
  options = {k: f[k].value for k in ('alpha', 'threshold', 'flip', 'carve')}
  return reconstruct_all(split_names(f.image), f.shape, f.color, f.output, **options)


def reconstruct_all(
  paths: Sequence[str], shape_workdir: str, color_workdir: str, output: str, **options: Any
) -> int:
  """Reconstructs pictures; returns the exit status, 1 if one of them failed.

  Args:
    paths: of the pictures.
    shape_workdir: the run of the shape network.
    color_workdir: the run of the colour network.
    output: the folder of the results.
    **options: of `reconstruct_file`.

  Raises:
    UserError: no picture can be reconstructed.
  """
  if not paths:
    raise UserError('--image names no file')
  stems = {p: os.path.join(output, name) for p, name in output_names(paths).items()}
  taken = {os.path.realpath(f'{stem}.png') for stem in stems.values()}
  for path in paths:
    if os.path.realpath(path) in taken:
      raise UserError(f'the results would overwrite {path}: give another folder as --output')
  shape, color = infer.load(shape_workdir, 'shape'), infer.load(color_workdir, 'color')
  failures = 0
  for path in tqdm(paths, unit='picture', disable=None):
    start = time.perf_counter()
    try:
      count = reconstruct_file(path, stems[path], shape, color, **options)
    except UserError as e:
      failures += 1
      tqdm.write(f'error: {path}: {str(e).removeprefix(path).lstrip(": ")}', sys.stderr)
      continue
    seconds = time.perf_counter() - start
    tqdm.write(f'{path} -> {stems[path]}.glb .ply .png  ({count} voxels, {seconds:.1f} s)')
  if failures:
    tqdm.write(f'error: {failures} of {len(paths)} pictures failed', sys.stderr)
  return int(failures > 0)


def split_names(values: Sequence[str]) -> list[str]:
  """Names separated by commas, without duplicates; the name of an existing file may have commas."""
  names = []
  for value in values:
    names += [value] if os.path.exists(value) else [v.strip() for v in value.split(',')]
  return list(dict.fromkeys(n for n in names if n))


def output_names(paths: Sequence[str]) -> dict[str, str]:
  """A name for the results of each image: its own, with a number if it is taken."""
  names = {}
  for path in paths:
    stem = os.path.splitext(os.path.basename(path))[0]
    name, number = stem, 1
    while name in names.values():
      number += 1
      name = f'{stem}_{number}'
    names[path] = name
  return names


def reconstruct_file(
  path: str,
  stem: str,
  shape: Network,
  color: Network,
  *,
  alpha: float,
  threshold: float,
  flip: bool,
  carve: bool,
) -> int:
  """One picture -> stem.glb, stem.ply and stem.png; returns the number of occupied voxels."""
  view = photo.load_view(path)
  options = {'alpha': alpha, 'threshold': threshold, 'flip': flip, 'carve': carve}
  found = jax.device_get(infer.reconstruct(view, shape=shape, color=color, **options))
  voxels = infer.to_voxels(found)
  count = int(np.sum(voxels.occupancy))
  if count == 0:
    raise UserError(
      f'no voxel reaches --threshold={threshold}, the highest probability is'
      f' {found.probability.max():.3g}: lower the threshold, or train the shape network longer'
    )
  export.write_glb(f'{stem}.glb', voxels)
  export.write_ply(f'{stem}.ply', voxels)
  with atomic_write(f'{stem}.png') as temporary:
    Image.fromarray(figures.reconstruction_panel(view, found)).save(temporary)
  return count


if __name__ == '__main__':
  main()
