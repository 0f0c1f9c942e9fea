r"""An ablation: what each step beyond the paper brings.

python -m experiments.paper.ablation --data=DIR --workdir=DIR [--models=all] [--epochs=...]
  [--quick]

The first line is the recipe `paper` with the threshold 0.8 and alpha = 0.2, the last one the recipe
`best` as it is meant to be used; each line adds one thing to those above it. Thresholds, alphas and
the contents of the recipe were chosen on the split val; results on the split test are only
reported. The numbers go to WORKDIR/tables/ablation.json.
"""

from absl import flags

from experiments.lib import cli, protocol, results, tables
from experiments.lib.protocol import Plan
from experiments.lib.results import Row, Table

STEPS = (
  *('blended_0.2', 'plus_threshold', 'plus_alpha', 'plus_color', 'plus_shape', 'plus_flip'),
  'best',
)
ENDS = {'blended_0.2': 'paper', 'best': '+ carved by the silhouette'}  # their titles in this table
METRICS = ('iou', 'psnr_rgb')
SPLITS = ('val', 'test')
CAPTION = 'Each line adds one thing to those above it; means over all models, and gains'


@cli.program(protocol.define_flags)
def main(f: flags.FlagValues) -> None:
  make_table(protocol.read_flags(f))


def make_table(plan: Plan) -> None:
  """Evaluates all steps on val and test, prints and writes the table."""
  found = {(s, m): results.evaluate(plan, m, split=s) for s in SPLITS for m in STEPS}
  parts = {}
  for split in SPLITS:
    for metric in METRICS:
      rows = [
        Row(ENDS.get(m, protocol.METHODS[m].title), results.select(found[split, m], metric), {})
        for m in STEPS
      ]
      last = rows[-1]._replace(title='best')
      compared = [results.compare(last, rows[0])] if split == 'test' else []
      parts[f'{split} {metric}'] = Table([results.summarize(row) for row in rows], compared)
  print(f'\n{tables.ablation_table(parts, CAPTION)}')
  used = [r for some in found.values() for r in some]
  results.write(plan.workdir, 'ablation', used, {'parts': parts})


if __name__ == '__main__':
  main()
