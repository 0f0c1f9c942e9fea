r"""The paper's Figure "res_vis": what the networks make of a view on the way to the result.

python -m experiments.figure_intermediate --data=DIR --workdir=DIR [--figure_seed=0]
  [--per_category=1] [--models=all] [--epochs=...] [--quick]

A row a test model, drawn at random: the input, the adapted R2N2's result, flow, sampled colours,
regressed colours, blending weights, the result from three sides, and the truth. All but the input
are shown on the voxels that the shape network found. Trains what is missing, reuses what is there;
the figure goes to WORKDIR/figures/intermediate.png.
"""

import functools

import jax
import numpy as np
from absl import flags
from tqdm import tqdm

from cvn import blending, environment, errors, figures, reconstruct
from cvn.dataset import open_dataset
from experiments import pictures, protocol

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
  dataset = open_dataset(f.data)
  examples = pictures.choose(f, dataset)
  categories = pictures.categories_of(examples)
  predictors, networks = (
    pictures.by_category(f, categories, functools.partial(make, f, method, seed=f.seeds[0]))
    for make, method in ((protocol.make_predictor, BASELINE), (protocol.load, METHOD))
  )
  rows = []
  for e in tqdm(examples, desc='draw', unit='model', disable=None):
    shown = pictures.read(dataset, e)
    baseline = predictors[e.model.category](shown.batch)[0]
    rows.append(draw_row(f, e, shown, baseline, networks[e.model.category]))
  image = pictures.arrange(rows, TITLES, examples)
  caption = (
    f'{pictures.say_choice(f)} {pictures.say_training(f)} Volumes are seen from'
    f' {pictures.SIDE}° beside the input view, results also from further round.'
  )
  facts = pictures.describe_choice(f) | pictures.describe(f, examples, (BASELINE, METHOD))
  pictures.write(f, figures.stack([image, draw_legend(f.tile // 2)]), caption, facts)


def draw_row(f, example, shown, baseline, networks: protocol.Networks) -> list[np.ndarray]:
  """The pictures of one example, as `TITLES` names them."""
  batch = reconstruct.reconstruct(
    networks.shape.variables,
    networks.color.variables,
    shown.batch,
    alpha=networks.alpha,
    grid_size=len(shown.true.occupancy),
  )
  one = jax.tree.map(lambda x: np.asarray(x)[0], batch)
  voxels = reconstruct.to_voxels(one, networks.threshold)
  weight = np.asarray(blending.recalculate_weight(one.weight, networks.alpha))
  volumes = (
    figures.flow_color_code(one.flow),
    one.sampled,
    one.regressed,
    figures.weight_color_code(weight),
  )
  return [
    figures.enlarge(shown.view, f.tile),
    pictures.draw(f, baseline, example),
    *(pictures.draw(f, voxels._replace(color=v), example) for v in volumes),
    *(pictures.draw(f, voxels, example, turn) for turn in RESULT_TURNS),
    pictures.draw(f, shown.true, example),
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
