r"""The paper's user study as a page: which of two methods' coloured 3D models do people prefer?

python -m experiments.study --data=DIR --workdir=DIR [--ours=blended_0.2]
  [--against=regression,flow] [--shapes=5] [--study_seed=0] [--output=DIR] [...]

Of each category random test models are taken, 5 where there are as many, and of each a random view.
Every method makes a model of it, and subjects choose between ours and each of the others. In the
folder --output:

  study.html   the page, all in one file: hand it to the subjects; it works without a network
  key.json     which result is whose; for experiments.study.chart, not for the subjects

Each subject sees the pairs in an order and on sides of their own. The answers are a file that the
page saves.
"""

import io
import json
import math
import os
from collections.abc import Sequence

import numpy as np
from absl import flags
from PIL import Image
from tqdm import tqdm

from cvn import environment, errors, figures
from cvn.files import atomic_write
from cvn.grid import ColoredVoxels
from experiments.lib import picks, protocol
from experiments.lib.assets import to_png
from experiments.lib.picks import Pick
from experiments.lib.protocol import Plan
from experiments.lib.stages import argv
from experiments.study import page, shapes
from experiments.study.page import Pair, Sheet, Study

FRAMES = 32  # pictures of a turn; a multiple of 4, for the four sides
COLUMNS = 8
QUALITY = 88  # of WebP: the page has some 2,000 pictures in 15 MB
GREY = (246, 246, 246)  # behind the object: about the views', and one that WebP keeps
MARGIN = 8  # pixels around the object


def define_flags(f: flags.FlagValues) -> None:
  """The program's flags. Not at import: there the names of several programs would collide."""
  protocol.define_flags(f)
  shapes.define_flags(f)
  own = {'flag_values': f}
  flags.DEFINE_integer(
    'size',
    420,
    'Pixels of the pictures before what is empty in all of them is cut away.',
    lower_bound=32,
    upper_bound=1024,
    **own,
  )
  flags.DEFINE_string('output', None, 'A folder; user_study in --workdir by default.', **own)


def main(_) -> int:
  return run(flags.FLAGS)


def run(f: flags.FlagValues) -> int:
  """Makes the page as the flags say; returns the exit status."""
  plan = protocol.read_flags(f)
  shown = shapes.choose(plan, shapes=f.shapes, seed=f.study_seed)
  output = f.output or os.path.join(plan.workdir, 'user_study')
  make_study(plan, shown, f.ours, f.against, seed=f.study_seed, size=f.size, output=output)
  return 0


def make_study(
  plan: Plan,
  shown: Sequence[Pick],
  ours: str,
  against: Sequence[str],
  *,
  seed: int,
  size: int,
  output: str,
) -> None:
  """Reconstructs, draws and writes the page and its key.

  Args:
    plan: how networks are trained.
    shown: the test models and their views.
    ours: the method that is in every pair.
    against: the methods it is compared with.
    seed: of names and of the order of pairs.
    size: pixels of pictures before the cut.
    output: the folder.
  """
  count = shapes.describe(shown)
  print(f'{count}; seed {seed}')
  methods = [ours, *against]
  rng = np.random.default_rng(seed)
  names = [f'r{n:03d}' for n in rng.permutation(len(shown) * len(methods))]
  views, sheets, key, order = [], {}, {}, []
  progress = tqdm(shown, desc='draw', unit='shape', disable=None)
  for n, results in enumerate(shapes.reconstruct(plan, shown, methods)):
    order.append(results.pick)
    views.append(to_png(crop_to_object(results.record.views[results.pick.view])))
    made = draw_turntables(list(results.voxels.values()), results.pick.azimuth, size)
    for method, sheet in zip(methods, made, strict=True):
      name = names[len(sheets)]
      sheets[name] = sheet
      key[name] = {'shape': n, 'method': method}
    progress.update()
  progress.close()
  about = f'{count}, chosen with seed {seed}.'
  pairs = make_pairs(key, ours, rng)
  sheets = dict(sorted(sheets.items()))
  study = Study(about, tuple(views), sheets, FRAMES, COLUMNS, pairs)
  report = {
    'argv': argv(),
    'page': page.identify(study),
    'study_seed': seed,
    'ours': ours,
    'titles': {m: protocol.METHODS[m].title for m in methods},
    'shapes': [picks.to_json(p) for p in order],
    'results': dict(sorted(key.items())),
    'pairs': {name: pair.sheets for name, pair in pairs.items()},
  }
  report |= shapes.describe_networks(plan, shown, methods)
  path = os.path.join(output, 'study.html')
  with atomic_write(path) as temporary, open(temporary, 'w', encoding='utf-8') as out:
    out.write(page.render(study))
  with atomic_write(os.path.join(output, 'key.json')) as temporary, open(temporary, 'w') as out:
    json.dump(report, out, indent=1)
  print(f'{len(pairs)} pairs, {os.path.getsize(path) / 1e6:.1f} MB: {path}')
  print(f"which is whose, not for the subjects' eyes: {os.path.join(output, 'key.json')}")


def make_pairs(key: dict[str, dict], ours: str, rng: np.random.Generator) -> dict[str, Pair]:
  """Every shape's result of ours with that of each other method, in random order.

  Args:
    key: {result: {'shape': number, 'method': method}}.
    ours: the method that is in every pair.
    rng: of the order.
  """
  own = {k['shape']: name for name, k in key.items() if k['method'] == ours}
  found = [
    Pair(k['shape'], tuple(sorted((own[k['shape']], name))))
    for name, k in key.items()
    if k['method'] != ours
  ]
  return {f'p{n:03d}': found[i] for n, i in enumerate(rng.permutation(len(found)))}


def crop_to_object(view: np.ndarray) -> np.ndarray:
  """The square around the object in a view: uint8 [H, W, 4] -> [S, S, 3] on `GREY`."""
  rows, columns = np.nonzero(view[..., 3]) if view[..., 3].any() else np.indices(view.shape[:2])
  low = np.array([rows.min(), columns.min()])
  high = np.array([rows.max(), columns.max()]) + 1
  side = int((high - low).max()) + 2 * MARGIN
  top, left = (low + high - side) // 2 + side  # in the padded picture
  around = ((side, side), (side, side), (0, 0))
  padded = np.pad(figures.over(view, background=GREY), around, constant_values=GREY[0])
  return padded[top : top + side, left : left + side]


def draw_turntables(results: list[ColoredVoxels], azimuth: float, size: int) -> list[Sheet]:
  """Pictures from all around, the first from `azimuth`; all are cut to one frame.

  Args:
    results: of one shape.
    azimuth: degrees.
    size: pixels before the cut.
  """
  turn = [
    np.stack(
      [
        figures.draw_voxels(r, azimuth + 360 * n / FRAMES, size=size, background=GREY)
        for n in range(FRAMES)
      ]
    )
    for r in results
  ]
  rows, columns = common_frame(turn)
  return [_make_sheet(frames[:, rows, columns]) for frames in turn]


def common_frame(turns: list[np.ndarray]) -> tuple[slice, slice]:
  """Rows and columns that hold all that is drawn, the axis of the turn in the middle.

  Args:
    turns: of uint8 pictures [F, S, S, 3] on `GREY`.
  """
  size = turns[0].shape[1]
  drawn = np.any([(t != GREY).any((0, 3)) for t in turns], axis=0)
  if not drawn.any():
    return slice(0, size), slice(0, size)
  rows, columns = (np.flatnonzero(drawn.any(axis)) for axis in (1, 0))
  half = max(size / 2 - columns[0], columns[-1] + 1 - size / 2)
  left = max(0, math.floor(size / 2 - half) - MARGIN)
  top, bottom = max(0, rows[0] - MARGIN), min(size, rows[-1] + 1 + MARGIN)
  return slice(int(top), int(bottom)), slice(left, size - left)


def _make_sheet(frames: np.ndarray) -> Sheet:
  """[F, H, W, 3] as one image."""
  height, width = frames.shape[1:3]
  lines = frames.reshape(-1, COLUMNS, height, width, 3).swapaxes(1, 2)
  file = io.BytesIO()
  image = Image.fromarray(lines.reshape(-1, COLUMNS * width, 3))
  image.save(file, 'webp', quality=QUALITY, method=4)
  return Sheet(file.getvalue(), width, height)


if __name__ == '__main__':
  environment.prepare()
  define_flags(flags.FLAGS)
  errors.run(main)
