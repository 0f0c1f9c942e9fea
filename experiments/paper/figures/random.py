r"""Randomly selected results: test models and views drawn by --figure_seed, as the picture tells.

python -m experiments.paper.figures.random --data=DIR --workdir=DIR [--figure_seed=0]
  [--per_category=2] [--methods=r2n2,regression,flow,blended_0.2] [--models=all]
  [--epochs=...] [--quick]

A row a model: the input, each method's result and the truth, from beside the input's camera and
from the opposite side. Trains what is missing, reuses what is there; the figure goes to
WORKDIR/figures/random.png.
"""

import os

from absl import flags

from cvn import environment, errors
from cvn.dataset import open_dataset
from experiments.lib import pictures, protocol


def define_flags(f: flags.FlagValues) -> None:
  """The program's flags. Not at import: there the names of several programs would collide."""
  pictures.define_flags(f, 'random')
  pictures.define_choice_flags(f, per_category=2)
  flags.DEFINE_list(
    'methods',
    ['r2n2', 'regression', 'flow', 'blended_0.2'],
    f'Whose results: of {", ".join(pictures.COLORED)}.',
    flag_values=f,
  )
  flags.register_validator(
    'methods',
    lambda v: v and set(v) <= {*pictures.COLORED},
    f'of {", ".join(pictures.COLORED)}',
    f,
  )


def main(_) -> None:
  run(flags.FLAGS)


def run(f: flags.FlagValues) -> None:
  """Makes the figure as the flags say."""
  plan = protocol.read_flags(f)
  dataset = open_dataset(plan.data)
  shown = pictures.choose(plan, dataset, seed=f.figure_seed, per_category=f.per_category)
  image = pictures.draw_results(plan, dataset, shown, f.methods, tile=f.tile)
  found = pictures.find_runs(plan, shown, f.methods)
  pictures.write(
    os.path.join(plan.workdir, 'figures', f.name),
    image,
    f'{pictures.say_choice(f.figure_seed)} {pictures.say_training(found)}',
    {'figure_seed': f.figure_seed, **pictures.describe(plan, shown, f.methods, found)},
  )


if __name__ == '__main__':
  environment.prepare()
  define_flags(flags.FLAGS)
  errors.run(main)
