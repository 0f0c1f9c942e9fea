r"""Table 1 of the paper: mean IoU of the three shape methods, beside the paper's numbers.

python -m experiments.paper.iou --data=DIR --workdir=DIR [--models=all] [--epochs=...] [--quick]

The table is printed for two occupancy thresholds, the authors' 0.8 and one chosen on the split val,
because losses differ in how confident they make a network. The program trains what is missing and
reuses what is there; the numbers go to WORKDIR/tables/iou.json.
"""

from collections.abc import Sequence

from absl import flags

from experiments.lib import cli, protocol, results, tables
from experiments.lib.protocol import Plan
from experiments.lib.results import AVERAGE, Row

METRIC, FORM = 'iou', '.3f'
NAMES = (*protocol.PAPER_CATEGORIES, AVERAGE)
PUBLISHED = {  # Table 1
  'r2n2': dict(zip(NAMES, (0.238, 0.216, 0.179, 0.308, 0.235), strict=True)),
  'cross_entropy': dict(zip(NAMES, (0.381, 0.226, 0.172, 0.342, 0.280), strict=True)),
  'msfcel': dict(zip(NAMES, (0.395, 0.241, 0.180, 0.374, 0.298), strict=True)),
}
THRESHOLDS = {'paper': "occupied: p > 0.8, as in the authors' program", 'val': 'chosen on val'}


def define_flags(f: flags.FlagValues) -> None:
  protocol.define_flags(f)
  flags.DEFINE_list(
    'methods',
    ['r2n2', 'cross_entropy', 'msfcel'],
    'Methods to evaluate; msfcel_release and msfcel_mixed are further ones.',
    flag_values=f,
  )


@cli.program(define_flags)
def main(f: flags.FlagValues) -> None:
  make_table(protocol.read_flags(f), f.methods)


def make_table(plan: Plan, methods: Sequence[str]) -> None:
  """Evaluates the methods at both thresholds, prints and writes the table.

  Args:
    plan: how networks are trained and evaluated.
    methods: keys of `protocol.METHODS`.
  """
  parts, used = {}, []
  for threshold, title in THRESHOLDS.items():
    found = {m: results.evaluate(plan, m, threshold=threshold) for m in methods}
    rows = {
      m: Row(protocol.METHODS[m].title, results.select(r, METRIC), PUBLISHED.get(m, {}))
      for m, r in found.items()
    }
    trivial = results.select(found[methods[0]], METRIC, who='baselines')
    rows['mean_shape'] = Row('Mean training shape', trivial, {})
    parts[threshold] = results.tabulate(rows, 'msfcel')
    caption = f'Mean IoU, {title} (Adapted R2N2: always chosen on val)'
    print(f'\n{tables.methods_table(parts[threshold], FORM, caption)}')
    used += [r for some in found.values() for r in some]
  results.write(plan.workdir, 'iou', used, {'parts': parts})


if __name__ == '__main__':
  main()
