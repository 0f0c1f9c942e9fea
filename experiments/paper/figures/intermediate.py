r"""The paper's Figure "res_vis": the volumes between a view and its result.

python -m experiments.paper.figures.intermediate --data=DIR --workdir=DIR [--figure_seed=0]
  [--per_category=1] [--models=all] [--epochs=...] [--quick]

Each row shows a random test model: the input, the adapted R2N2's result, flow, sampled colours,
regressed colours, blending weights, the result from three sides, and the truth. The volumes are
shown on the voxels that the shape network found. The program trains what is missing and reuses what
is there; the figure goes to WORKDIR/figures/intermediate.png.
"""

from collections.abc import Sequence

import numpy as np
from absl import flags
from tqdm import tqdm

from cvn import figures, infer
from cvn.dataset import open_dataset
from cvn.infer import Reconstruction
from experiments.lib import cli, picks, pictures, protocol
from experiments.lib.picks import Pick
from experiments.lib.protocol import Plan

BASELINE, METHOD = 'r2n2', 'blended_0.2'
RESULT_TURNS = (0, 120, 240)  # degrees
TITLES = (
  'input',
  'adapted R2N2',
  'flow',
  'sampled',
  'regressed',
  'weight',
  *('result' + (f', {turn}°' if turn else '') for turn in RESULT_TURNS),
  'truth',
)


def define_flags(f: flags.FlagValues) -> None:
  pictures.define_flags(f, 'intermediate')
  pictures.define_choice_flags(f, per_category=1)


@cli.program(define_flags)
def main(f: flags.FlagValues) -> None:
  chosen = {'seed': f.figure_seed, 'per_category': f.per_category}
  make_figure(protocol.read_flags(f), name=f.name, tile=f.tile, **chosen)


def make_figure(plan: Plan, *, name: str, tile: int, seed: int, per_category: int) -> None:
  """Draws and writes the figure; arguments as of `pictures.make_random`."""
  methods = (BASELINE, METHOD)
  shown = pictures.choose(plan, open_dataset(plan.data), seed=seed, per_category=per_category)
  image = draw(plan, shown, tile=tile)
  found = pictures.find_runs(plan, shown, methods)
  caption = (
    f'{pictures.say_choice(seed)} {pictures.say_training(found)} Volumes are seen from'
    f' {pictures.SIDE}° beside the input view, results also from further angles.'
  )
  pictures.write(plan, name, image, caption, shown, methods, found, figure_seed=seed)


def draw(plan: Plan, shown: Sequence[Pick], *, tile: int) -> np.ndarray:
  """The figure: a row for each pick, and the legend; trains and evaluates what is missing."""
  dataset, categories = open_dataset(plan.data), picks.categories_of(shown)
  baseline, ours = (pictures.find_predictors(plan, categories, m) for m in (BASELINE, METHOD))
  rows = []
  for pick in tqdm(shown, desc='draw', unit='model', disable=None):
    known = pictures.read(dataset, pick)
    results = [predict[pick.model.category](known.view[None])[0] for predict in (baseline, ours)]
    rows.append(draw_row(pick, known, *results, tile=tile))
  return figures.stack([pictures.arrange(rows, TITLES, shown), draw_legend(tile // 2)])


def draw_row(
  pick: Pick,
  shown: pictures.Shown,
  baseline: Reconstruction,
  ours: Reconstruction,
  *,
  tile: int,
) -> list[np.ndarray]:
  """The pictures of a pick in the order of `TITLES`."""
  voxels = infer.to_voxels(ours)
  volumes = (
    figures.flow_color_code(ours.flow),
    ours.sampled,
    ours.regressed,
    figures.weight_color_code(ours.weight),
  )
  return [
    figures.enlarge(shown.view, tile),
    pictures.draw(infer.to_voxels(baseline), pick, tile=tile),
    *(pictures.draw(voxels._replace(color=v), pick, tile=tile) for v in volumes),
    *(pictures.draw(voxels, pick, tile=tile, turn=turn) for turn in RESULT_TURNS),
    pictures.draw(shown.true, pick, tile=tile),
  ]


def draw_legend(size: int) -> np.ndarray:
  """The colour codes of flow and weight."""
  weights = np.broadcast_to(np.linspace(0, 1, size), (size // 8, size))
  bar = figures.to_uint8(figures.weight_color_code(weights))
  return figures.grid_of_images(
    [[pictures.draw_flow_code(size), bar]],
    gap=16,
    column_titles=[
      'flow: the place in the\ninput that has the colour',
      'weight: the regressed colour\ncounts (blue), the sampled (yellow)',
    ],
  )


if __name__ == '__main__':
  main()
