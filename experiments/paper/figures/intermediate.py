r"""The paper's Figure "res_vis": what the networks make of a view on the way to the result.

python -m experiments.paper.figures.intermediate --data=DIR --workdir=DIR [--figure_seed=0]
  [--per_category=1] [--models=all] [--epochs=...] [--quick]

A row a test model, drawn at random: the input, the adapted R2N2's result, flow, sampled colours,
regressed colours, blending weights, the result from three sides, and the truth. All but the input
are shown on the voxels that the shape network found. Trains what is missing, reuses what is there;
the figure goes to WORKDIR/figures/intermediate.png.
"""

import os
from collections.abc import Sequence

import numpy as np
from absl import flags
from tqdm import tqdm

from cvn import environment, errors, figures, infer
from cvn.dataset import open_dataset
from cvn.infer import Reconstruction
from experiments.lib import picks, pictures, protocol
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
  """The program's flags. Not at import: there the names of several programs would collide."""
  pictures.define_flags(f, 'intermediate')
  pictures.define_choice_flags(f, per_category=1)


def main(_) -> None:
  run(flags.FLAGS)


def run(f: flags.FlagValues) -> None:
  """Makes the figure as the flags say."""
  plan = protocol.read_flags(f)
  shown = pictures.choose(
    plan, open_dataset(plan.data), seed=f.figure_seed, per_category=f.per_category
  )
  image = draw(plan, shown, tile=f.tile)
  found = pictures.find_runs(plan, shown, (BASELINE, METHOD))
  caption = (
    f'{pictures.say_choice(f.figure_seed)} {pictures.say_training(found)} Volumes are seen from'
    f' {pictures.SIDE}° beside the input view, results also from further round.'
  )
  facts = pictures.describe(plan, shown, (BASELINE, METHOD), found)
  stem = os.path.join(plan.workdir, 'figures', f.name)
  pictures.write(stem, image, caption, {'figure_seed': f.figure_seed, **facts})


def draw(plan: Plan, shown: Sequence[Pick], *, tile: int) -> np.ndarray:
  """The figure: a row for each pick, and the legend; trains and evaluates what is missing."""
  dataset, seed = open_dataset(plan.data), plan.seeds[0]
  categories = picks.categories_of(shown)
  baseline, ours = (
    pictures.by_category(
      plan, categories, lambda c, m=method: protocol.make_predictor(plan, m, c, seed)
    )
    for method in (BASELINE, METHOD)
  )
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
  """The pictures of one pick, as `TITLES` names them."""
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
  environment.prepare()
  define_flags(flags.FLAGS)
  errors.run(main)
