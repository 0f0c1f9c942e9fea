r"""The paper's model structure analysis: one unified network against two separate ones.

python -m experiments.paper.structure --data=DIR --workdir=DIR [--figure_seed=0] [--per_category=2]
  [--models=all] [--epochs=...] [--quick]

Prints mean IoU and surface PSNR of both, the paper's IoU (of cars), and the differences model by
model. The picture shows results on random test models and views from two sides. The program trains
what is missing and reuses what is there; the numbers go to WORKDIR/tables/structure.json, the
picture to WORKDIR/figures/structure.png.
"""

from absl import flags

from experiments.lib import cli, pictures, protocol, results, tables
from experiments.lib.protocol import Plan
from experiments.lib.results import Row

SEPARATE, UNIFIED = 'blended_0.2', 'unified'
PUBLISHED = {SEPARATE: {'car': 0.395}, UNIFIED: {'car': 0.386}}  # IoU, section 4.3
TITLES = {SEPARATE: 'Separate networks (proposed)', UNIFIED: 'Unified network'}
CAPTIONS = {'iou': 'Mean IoU', 'psnr_rgb': 'Mean surface PSNR (RGB), dB'}


def define_flags(f: flags.FlagValues) -> None:
  pictures.define_flags(f, 'structure')
  pictures.define_choice_flags(f, per_category=2)


@cli.program(define_flags)
def main(f: flags.FlagValues) -> None:
  plan = protocol.read_flags(f)
  make_table(plan)
  chosen = {'seed': f.figure_seed, 'per_category': f.per_category}
  pictures.make_random(plan, [*TITLES], name=f.name, tile=f.tile, **chosen)


def make_table(plan: Plan) -> None:
  """Evaluates both ways, prints and writes the tables."""
  found = {m: results.evaluate(plan, m) for m in TITLES}
  parts = {}
  for metric, caption in CAPTIONS.items():
    published = PUBLISHED if metric == 'iou' else {}
    rows = {
      m: Row(TITLES[m], results.select(r, metric), published.get(m, {})) for m, r in found.items()
    }
    parts[metric] = results.tabulate(rows, SEPARATE)
    print(f'\n{tables.methods_table(parts[metric], tables.FORMS[metric], caption)}')
  used = [r for some in found.values() for r in some]
  results.write(plan.workdir, 'structure', used, {'parts': parts})


if __name__ == '__main__':
  main()
