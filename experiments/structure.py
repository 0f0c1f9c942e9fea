r"""The paper's model structure analysis: one unified network against two separate ones.

python -m experiments.structure --data=DIR --workdir=DIR [--figure_seed=0] [--per_category=2]
  [--models=all] [--epochs=...] [--quick]

Prints mean IoU and surface PSNR of both, in brackets the paper's IoU (of cars), and how much they
differ, model by model. The picture shows results on test models and views drawn at random, from
two sides. Trains what is missing, reuses what is there; the numbers go to
WORKDIR/tables/structure.json, the picture to WORKDIR/figures/structure.png.
"""

from absl import flags

from cvn import environment, errors
from cvn.dataset import open_dataset
from experiments import pictures, tables
from experiments.tables import Row

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
  dataset = open_dataset(f.data)
  examples = pictures.choose(f, dataset)
  table = {}
  for metric, (title, form) in TABLES.items():
    separate, unified = (
      Row(TITLES[m], tables.collect(f, m, metric), PUBLISHED[m] if metric == 'iou' else {})
      for m in TITLES
    )
    comparison = tables.compare(separate, unified, form)
    table[metric] = {'rows': tables.to_json([separate, unified]), 'comparison': comparison}
    print(f'\n{title}\n\n{tables.to_markdown([separate, unified], form)}\n\n{comparison}')
  tables.finish(f, 'structure', table)
  image = pictures.draw_results(f, dataset, examples, (SEPARATE, UNIFIED))
  caption = f'{pictures.say_choice(f)} {pictures.say_training(f)}'
  facts = pictures.describe_choice(f) | pictures.describe(f, examples, (SEPARATE, UNIFIED))
  pictures.write(f, image, caption, facts)


if __name__ == '__main__':
  environment.prepare()
  define_flags(flags.FLAGS)
  errors.run(main)
