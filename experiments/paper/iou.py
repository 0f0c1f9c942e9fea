r"""Table 1 of the paper: mean IoU of the three shape methods, beside the paper's numbers.

python -m experiments.paper.iou --data=DIR --workdir=DIR [--models=all] [--epochs=...] [--quick]

Each line is printed for both thresholds of occupancy, the authors' 0.8 and one chosen on the split
val, since losses differ in how sure they make a network. In brackets: the paper's number. Trains
what is missing, reuses what is there; numbers go to WORKDIR/tables/iou.json.
"""

from collections.abc import Sequence

from absl import flags

from cvn import environment, errors
from experiments.lib import protocol, tables
from experiments.lib.protocol import Plan
from experiments.lib.tables import AVERAGE, Row

METRIC, FORM = 'iou', '.3f'
NAMES = (*protocol.PAPER_CATEGORIES, AVERAGE)
PUBLISHED = {  # Table 1
  'r2n2': dict(zip(NAMES, (0.238, 0.216, 0.179, 0.308, 0.235), strict=True)),
  'cross_entropy': dict(zip(NAMES, (0.381, 0.226, 0.172, 0.342, 0.280), strict=True)),
  'msfcel': dict(zip(NAMES, (0.395, 0.241, 0.180, 0.374, 0.298), strict=True)),
}
THRESHOLDS = {'paper': "occupied: p > 0.8, as in the authors' program", 'val': 'chosen on val'}


def define_flags(f: flags.FlagValues) -> None:
  """The program's flags. Not at import: there the names of several programs would collide."""
  protocol.define_flags(f)
  flags.DEFINE_list(
    'methods',
    ['r2n2', 'cross_entropy', 'msfcel'],
    "Which; also msfcel_release, by the authors' recipe.",
    flag_values=f,
  )


def main(_) -> None:
  run(flags.FLAGS)


def run(f: flags.FlagValues) -> None:
  """Makes the table as the flags say."""
  make_table(protocol.read_flags(f), f.methods)


def make_table(plan: Plan, methods: Sequence[str]) -> None:
  """Evaluates the methods for both thresholds, prints and writes.

  Args:
    plan: how.
    methods: keys of `protocol.METHODS`.
  """
  table, used = {'metric': METRIC}, []
  for threshold, title in THRESHOLDS.items():
    results = {m: tables.evaluate(plan, m, threshold=threshold) for m in methods}
    rows = {
      m: Row(protocol.METHODS[m].title, tables.select(r, METRIC), PUBLISHED.get(m, {}))
      for m, r in results.items()
    }
    trivial = tables.select(results[methods[0]], METRIC, who='baselines')
    rows['mean_shape'] = Row('Mean training shape', trivial, {})
    heading = f'Mean IoU, {title} (Adapted R2N2: always chosen on val)'
    table[threshold] = tables.tell(heading, rows, 'msfcel', FORM)
    used += [r for found in results.values() for r in found]
  tables.finish(plan.workdir, 'iou', table, used)


if __name__ == '__main__':
  environment.prepare()
  define_flags(flags.FLAGS)
  errors.run(main)
