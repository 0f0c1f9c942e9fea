r"""Pictures -> coloured voxel meshes: a GLB, a PLY, a panel PNG and the object's mask for each.

python -m experiments.reconstruct --image=FILE|FOLDER[,...] --shape=WORKDIR --color=WORKDIR \
  --output=DIR [--mask=FILE[,...]] [--[no]framed] [--up=z] [--alpha=0.2] [--threshold=0.8] [--flip]
  [--carve]

NAME_mask.png shows which part of the picture was taken as the object; cvn/photo/masks.py says how
it is found. Doubts are printed as warnings. A better mask is given with --mask. A picture that
fails is named on stderr and the others are still done; the exit status is then 1.
"""

import os
import sys
import time

import jax
import numpy as np
from absl import flags
from PIL import Image
from tqdm import tqdm

from cvn import blending, checkpoint, environment, errors, export, figures, infer, metrics, photo
from cvn.errors import UserError
from cvn.files import atomic_write
from cvn.infer import Network
from experiments.lib import photos


def define_flags(f: flags.FlagValues) -> None:
  """The program's flags. Not at import: there the names of several programs would collide."""
  own = {'flag_values': f}
  flags.DEFINE_multi_string(
    'image',
    None,
    'Pictures or folders of pictures: names separated by commas; the flag may be repeated.',
    **own,
  )
  flags.DEFINE_multi_string(
    'mask',
    [],
    'Masks, one a picture in the same order: pictures of the same size, white (or opaque) where the'
    ' object is.',
    **own,
  )
  flags.DEFINE_bool(
    'framed',
    None,
    "Whether pictures are framed as a data set's views, so that nothing is cropped or scaled; by"
    ' default, those that look so.',
    **own,
  )
  flags.DEFINE_enum('up', 'y', ['y', 'z'], 'The axis that points up in PLY files.', **own)
  flags.DEFINE_string('shape', None, "The trained shape network's workdir.", **own)
  flags.DEFINE_string('color', None, "The trained colour network's workdir.", **own)
  flags.DEFINE_string('output', None, 'The folder the results go to.', **own)
  flags.DEFINE_float(
    'alpha',
    blending.ALPHA,
    'In (0, 1]: the smaller, the more the sampled colours count.',
    **own,
  )
  flags.DEFINE_float(
    'threshold',
    metrics.OCCUPIED,
    'In (0, 1): the probability from which on a voxel is occupied.',
    **own,
  )
  flags.DEFINE_bool(
    'flip', False, 'Take means with what the networks say of the mirrored picture.', **own
  )
  flags.DEFINE_bool(
    'carve',
    False,
    "Carve the shape by the picture's silhouette, seen from the azimuth of the data set's views"
    ' that fits it best: for pictures framed as these are.',
    **own,
  )
  flags.mark_flags_as_required(['image', 'shape', 'color', 'output'], f)
  flags.register_validator('alpha', lambda x: 0 < x <= 1, 'must be in (0, 1]', f)
  flags.register_validator('threshold', lambda x: 0 < x < 1, 'must be in (0, 1)', f)


def main(_) -> int:
  return run(flags.FLAGS)


def run(f: flags.FlagValues) -> int:
  """Reconstructs as the flags say; returns the exit status."""
  paths = photos.expand_folders(photos.split_names(f.image))
  if not paths:
    raise UserError('--image names no file')
  masks = photos.assign_masks(paths, photos.split_names(f.mask))
  stems = {p: os.path.join(f.output, name) for p, name in photos.output_names(paths).items()}
  taken = {os.path.realpath(f'{s}{end}.png') for s in stems.values() for end in ('', '_mask')}
  for path in (*paths, *filter(None, masks.values())):
    if os.path.realpath(path) in taken:
      raise UserError(f'the results would overwrite {path}: give another folder as --output')
  shape, color = infer.load(f.shape, 'shape'), infer.load(f.color, 'color')
  known = photos.known_categories(*map(checkpoint.read_config, (f.shape, f.color)))
  if known:
    print(f'the networks know {", ".join(known)}, and nothing else')
  failures = 0
  for path in tqdm(paths, unit='picture', disable=None):
    start = time.perf_counter()
    try:
      picture = photo.load_photo(path, mask=masks[path], framed=f.framed)
      found = photos.how_unusual(path, picture.view, shape)
      for warning in (*picture.warnings, *found):
        tqdm.write(f'warning: {warning}', sys.stderr)
      options = {k: f[k].value for k in ('alpha', 'threshold', 'flip', 'carve', 'up')}
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
    tqdm.write(f'error: {failures} of {len(paths)} pictures failed', sys.stderr)
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
  environment.prepare()
  define_flags(flags.FLAGS)
  errors.run(main)
