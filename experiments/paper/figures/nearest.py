r"""The paper's Figure "nn_sampling": colours from the nearest foreground, and from the plain flow.

python -m experiments.paper.figures.nearest --data=DIR --workdir=DIR [--per_category=1]
  [--models=all] [--epochs=...] [--quick]

The program prints, over all views of all test models, the share of reconstructed voxels whose flow
points at the background, and the surface PSNR of sampled and blended colours with and without the
search for the nearest foreground. The figure shows the models of each category with the highest
share, each in the view where the share is highest: the input, colours sampled through the plain
flow and from the nearest foreground, and the voxels whose flow points at the background. The
program trains what is missing and reuses what is there; the figure goes to
WORKDIR/figures/nearest.png.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from absl import flags
from tqdm import tqdm

from cvn import blending, data, figures, metrics, readouts, sampler
from cvn.dataset import Dataset, Record, open_dataset, read_record
from cvn.errors import UserError
from cvn.grid import ColoredVoxels
from cvn.infer import Reconstruction
from experiments.lib import cli, markdown, picks, pictures, protocol, scoring
from experiments.lib.picks import Pick
from experiments.lib.protocol import Plan, Predictor

METHOD = 'blended_0.2'
TITLES = (
  'input',
  'sampled through\nthe plain flow',
  'from the nearest\nforeground',
  'background\n(red)',
)
ON_BACKGROUND, ON_FOREGROUND = (0.9, 0.1, 0.1), (0.75, 0.75, 0.75)  # sRGB
MEASURES = ('share', 'plain', 'nearest', 'plain_blended', 'nearest_blended')


class Sampled(NamedTuple):
  """A view's reconstruction, coloured in several ways."""

  occupancy: np.ndarray  # [X, Y, Z] bool
  background: np.ndarray  # [X, Y, Z] bool: the flow points at the background
  plain: np.ndarray  # [X, Y, Z, 3] the colours of the pixels that the flow points at
  nearest: np.ndarray  # [X, Y, Z, 3] those of the nearest foreground pixels
  plain_blended: np.ndarray  # [X, Y, Z, 3] blended with the regressed colours
  nearest_blended: np.ndarray


def define_flags(f: flags.FlagValues) -> None:
  pictures.define_flags(f, 'nearest')
  flags.DEFINE_integer('per_category', 1, 'Models to show of each category.', 1, flag_values=f)


@cli.program(define_flags)
def main(f: flags.FlagValues) -> None:
  make_figure(protocol.read_flags(f), name=f.name, tile=f.tile, per_category=f.per_category)


def make_figure(plan: Plan, *, name: str, tile: int, per_category: int) -> None:
  """Measures all test models, prints, draws and writes.

  Args:
    plan: how networks are trained.
    name: of the files.
    tile: size of each small picture in pixels.
    per_category: models to show of each category.

  Raises:
    UserError: there is no finished test model.
  """
  dataset = open_dataset(plan.data)
  rows = data.select_rows(
    dataset, 'test', categories=protocol.categories(plan), sources=plan.sources
  )
  if len(rows) == 0:
    raise UserError(f'{plan.data} has no finished model in the split test')
  categories = [dataset.manifest.models[row].category for row in rows]
  predictors = pictures.find_predictors(plan, categories, METHOD)
  measured = []
  for row, category in zip(
    tqdm(rows, desc='sample', unit='model', disable=None), categories, strict=True
  ):
    record = read_record(dataset, row)
    measured.append(measure_model(record, predictors[category], dataset.manifest.grid_size))
  summary = summarize(categories, np.array(measured))
  print(f'\n{to_markdown(summary)}\n')
  shown = pick_highest(dataset, rows, np.array(measured)[..., 0], per_category)
  tiles = [draw_row(dataset, p, predictors[p.model.category], tile=tile) for p in shown]
  found = pictures.find_runs(plan, shown, (METHOD,))
  caption = (
    'The test models of each category with the highest mean share of voxels whose flow points at'
    ' the background, in the view where it is highest. The share is'
    f' {summary["all"]["share"]:.1%} over all views of all {len(rows)} test models.'
    f' {pictures.say_training(found)}'
  )
  image = pictures.arrange(tiles, TITLES, shown)
  pictures.write(plan, name, image, caption, shown, (METHOD,), found, measures=summary)


def sample(views: np.ndarray, found: Sequence[Reconstruction]) -> list[Sampled]:
  """Reconstructions of views [V, H, W, 4] uint8, coloured in both ways."""
  results = []
  for view, one in zip(views[:, None], found, strict=True):
    background = 1 - readouts.foreground_of(view)[..., None].astype(np.float32)
    flow = one.flow[None]
    plain = sampler.nearest(data.composite(view), flow)
    blended = blending.blend(plain, one.regressed[None], one.weight[None, ..., None])
    hit = sampler.nearest(background, flow)[..., 0] > 0
    arrays = (one.occupancy, hit[0], plain[0], one.sampled, blended[0], one.color)
    results.append(Sampled(*map(np.asarray, arrays)))
  return results


def measure_model(record: Record, predict: Predictor, grid_size: int) -> np.ndarray:
  """The `MEASURES` of all views of a model, [V, 5]; NaN for views without occupied voxels."""
  true = scoring.to_voxels(record, grid_size)
  rows = []
  for one in sample(record.views, predict(record.views)):
    partner = metrics.aligned_colors(one.occupancy, true)
    share = np.mean(one.background[one.occupancy]) if len(partner) else np.nan
    psnrs = [metrics.psnr(colors[one.occupancy], partner).rgb for colors in one[2:]]
    rows.append([share, *np.minimum(psnrs, scoring.PSNR_CEILING)])
  return np.array(rows)


def summarize(categories: Sequence[str], measured: np.ndarray) -> dict[str, dict[str, float]]:
  """Means over all views of each category's models, and of all models.

  Args:
    categories: of the models.
    measured: [models, V, 5] `MEASURES`.
  """
  groups = {c: [x == c for x in categories] for c in dict.fromkeys(categories)}
  groups['all'] = [True] * len(categories)
  summary = {}
  for name, chosen in groups.items():
    values = measured[chosen].reshape(-1, len(MEASURES))
    values = values[~np.isnan(values[:, 0])]
    means = values.mean(0).tolist() if len(values) else [None] * len(MEASURES)
    summary[name] = {'models': sum(chosen), **dict(zip(MEASURES, means, strict=True))}
  return summary


def to_markdown(summary: Mapping[str, Mapping[str, float]]) -> str:
  """The summary as a table."""
  head = ('', 'test models', 'flow on background')
  head += ('sampled, plain', 'sampled, nearest', 'blended, plain', 'blended, nearest')
  lines = []
  for name, means in summary.items():
    share, *psnrs = (means[k] for k in MEASURES)
    cells = [f'{share:.1%}', *(f'{x:.3f} dB' for x in psnrs)] if share is not None else []
    lines.append([name, means['models'], *(cells or [markdown.NONE] * len(MEASURES))])
  return markdown.numbers(head, lines)


def pick_highest(
  dataset: Dataset, rows: Sequence[int], shares: np.ndarray, per_category: int
) -> list[Pick]:
  """The models with the highest mean share of their category, each in its highest view.

  Args:
    dataset: the data set.
    rows: of the models.
    shares: [models, V], NaN for views without occupied voxels.
    per_category: models of a category.
  """
  shares = np.nan_to_num(shares)
  counts: Counter[str] = Counter()
  found = []
  for n in np.argsort(-shares.mean(1), kind='stable'):
    pick = picks.of(dataset, rows[n], shares[n].argmax())
    counts[pick.model.category] += 1
    if counts[pick.model.category] <= per_category:
      found.append(pick)
  return found


def draw_row(dataset: Dataset, pick: Pick, predict: Predictor, *, tile: int) -> list[np.ndarray]:
  """The pictures of a pick in the order of `TITLES`."""
  shown = pictures.read(dataset, pick)
  (one,) = sample(shown.view[None], predict(shown.view[None]))
  marked = np.where(one.background[..., None], ON_BACKGROUND, ON_FOREGROUND)
  return [
    figures.enlarge(shown.view, tile),
    *(
      pictures.draw(ColoredVoxels(one.occupancy, color), pick, tile=tile)
      for color in (one.plain, one.nearest, marked)
    ),
  ]


if __name__ == '__main__':
  main()
