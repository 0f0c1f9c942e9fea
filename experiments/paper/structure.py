r"""The paper's model structure analysis: one unified network against two separate ones.

python -m experiments.paper.structure --data=DIR --workdir=DIR [--figure_seed=0] [--per_category=2]
  [--models=all] [--epochs=...] [--quick]

Prints mean IoU and surface PSNR of both, in brackets the paper's IoU (of cars), and how much they
differ, model by model. The picture shows results on test models and views drawn at random, from
two sides. Trains what is missing, reuses what is there; the numbers go to
WORKDIR/tables/structure.json, the picture to WORKDIR/figures/structure.png.
"""

import os

from absl import flags

from cvn import environment, errors
from cvn.dataset import open_dataset
from experiments.lib import pictures, protocol, tables
from experiments.lib.protocol import Plan
from experiments.lib.tables import Row

SEPARATE, UNIFIED = 'blended_0.2', 'unified'
PUBLISHED = {SEPARATE: {'car': 0.395}, UNIFIED: {'car': 0.386}}  # IoU, section 4.3
TITLES = {SEPARATE: 'Separate networks (proposed)', UNIFIED: 'Unified network'}
TABLES = {'iou': ('Mean IoU', '.3f'), 'psnr_rgb': ('Mean surface PSNR (RGB), dB', '.2f')}


def define_flags(f: flags.FlagValues) -> None:
  """The program's flags. Not at import: there the names of several programs would collide."""
  pictures.define_flags(f, 'structure')
  pictures.define_choice_flags(f, per_category=2)


def main(_) -> None:
  run(flags.FLAGS)


def run(f: flags.FlagValues) -> None:
  """Makes the table and the picture as the flags say."""
  plan = protocol.read_flags(f)
  make_table(plan)
  dataset = open_dataset(plan.data)
  shown = pictures.choose(plan, dataset, seed=f.figure_seed, per_category=f.per_category)
  image = pictures.draw_results(plan, dataset, shown, [*TITLES], tile=f.tile)
  found = pictures.find_runs(plan, shown, [*TITLES])
  pictures.write(
    os.path.join(plan.workdir, 'figures', f.name),
    image,
    f'{pictures.say_choice(f.figure_seed)} {pictures.say_training(found)}',
    {'figure_seed': f.figure_seed, **pictures.describe(plan, shown, [*TITLES], found)},
  )


def make_table(plan: Plan) -> None:
  """Evaluates both ways, prints and writes."""
  results = {m: tables.evaluate(plan, m) for m in TITLES}
  table = {}
  for metric, (title, form) in TABLES.items():
    rows = {
      m: Row(TITLES[m], tables.select(r, metric), PUBLISHED[m] if metric == 'iou' else {})
      for m, r in results.items()
    }
    table[metric] = tables.tell(title, rows, SEPARATE, form)
  tables.finish(plan.workdir, 'structure', table, [r for found in results.values() for r in found])


if __name__ == '__main__':
  environment.prepare()
  define_flags(flags.FLAGS)
  errors.run(main)
