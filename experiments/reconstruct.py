r"""Images -> coloured voxel meshes: a GLB, a PLY, a panel PNG and the object's mask for each.

python -m experiments.reconstruct --image=FILE|FOLDER[,...] --shape=WORKDIR --color=WORKDIR \
  --output=DIR [--mask=FILE[,...]] [--[no]framed] [--up=z] [--alpha=0.2] [--threshold=0.8] [--flip]
  [--carve]

NAME_mask.png shows which part of the image was taken as the object; cvn/photo/masks.py says how it
is found, and --mask gives a better one. Doubts are printed as warnings.

An image that fails is reported on stderr and the others are still reconstructed; the exit status is
then 1.
"""

import os
import sys
import time
from collections.abc import Mapping
from typing import Any

import jax
import numpy as np
from absl import flags
from PIL import Image
from tqdm import tqdm

from cvn import blending, checkpoint, export, figures, infer, metrics, photo
from cvn.errors import UserError
from cvn.files import atomic_write
from cvn.infer import Network
from experiments.lib import cli, photos


def define_flags(f: flags.FlagValues) -> None:
  own = {'flag_values': f}
  flags.DEFINE_multi_string(
    'image',
    None,
    'Image files or folders of them, separated by commas; the flag may be repeated.',
    **own,
  )
  flags.DEFINE_multi_string(
    'mask',
    [],
    'Masks in the order of the images: images of the same size, white (or opaque) on the object.',
    **own,
  )
  flags.DEFINE_bool(
    'framed',
    None,
    "Whether images are framed like a data set's views and stay as they are; by default, only those"
    ' that look so.',
    **own,
  )
  flags.DEFINE_enum('up', 'y', ['y', 'z'], 'The axis that points up in PLY files.', **own)
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
  options = {k: f[k].value for k in ('alpha', 'threshold', 'flip', 'carve', 'up')}
  paths = photos.expand_folders(photos.split_names(f.image))
  masks = photos.assign_masks(paths, photos.split_names(f.mask))
  return reconstruct_all(masks, f.shape, f.color, f.output, framed=f.framed, **options)


def reconstruct_all(
  masks: Mapping[str, str | None],
  shape_workdir: str,
  color_workdir: str,
  output: str,
  *,
  framed: bool | None,
  **options: Any,
) -> int:
  """Reconstructs pictures; returns the exit status, 1 if one of them failed.

  Args:
    masks: the pictures, and a file with the mask of each or None.
    shape_workdir: the run of the shape network.
    color_workdir: the run of the colour network.
    output: the folder of the results.
    framed: see `photo.load_photo`.
    **options: of `reconstruct_view`.

  Raises:
    UserError: no picture can be reconstructed.
  """
  if not masks:
    raise UserError('--image names no file')
  stems = {p: os.path.join(output, name) for p, name in photos.output_names([*masks]).items()}
  taken = {os.path.realpath(f'{s}{end}.png') for s in stems.values() for end in ('', '_mask')}
  for path in (*masks, *filter(None, masks.values())):
    if os.path.realpath(path) in taken:
      raise UserError(f'the results would overwrite {path}: give another folder as --output')
  shape, color = infer.load(shape_workdir, 'shape'), infer.load(color_workdir, 'color')
  known = photos.known_categories(*map(checkpoint.read_config, (shape_workdir, color_workdir)))
  if known:
    print(f'the networks know only {", ".join(known)}')
  failures = 0
  for path in tqdm(masks, unit='picture', disable=None):
    start = time.perf_counter()
    try:
      picture = photo.load_photo(path, mask=masks[path], framed=framed)
      for warning in picture.warnings:
        tqdm.write(f'warning: {warning}', sys.stderr)
      count = reconstruct_view(picture.view, stems[path], shape, color, **options)
      photos.write_mask(f'{stems[path]}_mask.png', picture)
    except UserError as e:
      failures += 1
      tqdm.write(f'error: {path}: {str(e).removeprefix(path).lstrip(": ")}', sys.stderr)
      continue
    seconds = time.perf_counter() - start
    how = f'object by {picture.source}, {count} voxels, {seconds:.1f} s'
    tqdm.write(f'{path} -> {stems[path]}.glb .ply .png _mask.png  ({how})')
  if failures:
    tqdm.write(f'error: {failures} of {len(masks)} pictures failed', sys.stderr)
  return int(failures > 0)


def reconstruct_view(
  view: np.ndarray,
  stem: str,
  shape: Network,
  color: Network,
  *,
  alpha: float,
  threshold: float,
  flip: bool,
  carve: bool,
  up: str,
) -> int:
  """One view -> stem.glb, stem.ply and stem.png; returns the number of occupied voxels."""
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
  export.write_ply(f'{stem}.ply', voxels, up=up)
  with atomic_write(f'{stem}.png') as temporary:
    Image.fromarray(figures.reconstruction_panel(view, found)).save(temporary)
  return count


if __name__ == '__main__':
  main()
