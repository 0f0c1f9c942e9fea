r"""Harder measures than the paper's, for networks and for training models that are looked up.

python -m experiments.paper.measures --data=DIR --workdir=DIR [--models=all] [--epochs=...]
  [--quick]

F-scores, Chamfer distance and pictures of the results (experiments.evaluate) say more than the IoU
of a thin shell. A network that only recognises its training models is no better than looking one
up: the training model with the most similar outline, or with the most similar code in the network.
The training model nearest to the truth bounds both. The numbers go to WORKDIR/tables/measures.json.
"""

from collections.abc import Sequence

import numpy as np
from absl import flags

from experiments.lib import cli, protocol, results, tables
from experiments.lib.memory import WAYS
from experiments.lib.protocol import ALL, Plan
from experiments.lib.results import Result, Row, Scores
from experiments.lib.scoring import METRICS

METHODS = ('blended_0.2', 'best')
CAPTION = 'Means over all models and views, ± one standard error over models'


def define_flags(f: flags.FlagValues) -> None:
  protocol.define_flags(f)
  flags.DEFINE_list(
    'methods', [*METHODS], 'Methods to evaluate; the last is compared.', flag_values=f
  )


@cli.program(define_flags)
def main(f: flags.FlagValues) -> None:
  make_table(protocol.read_flags(f), f.methods)


def make_table(plan: Plan, methods: Sequence[str]) -> None:
  """Evaluates the methods, prints and writes the table.

  Args:
    plan: how networks are trained and evaluated.
    methods: keys of `protocol.METHODS`; the last one is compared with the others and with the
      looked-up models.
  """
  found = {m: results.evaluate(plan, m, measures=True) for m in methods}
  ours = methods[-1]
  parts = {}
  for metric in METRICS:
    rows = {m: pool(protocol.METHODS[m].title, r, metric) for m, r in found.items()}
    rows |= {way: pool(title, found[ours], metric, who=way) for way, title in WAYS.items()}
    parts[metric] = results.tabulate(rows, ours)
  print(f'\n{tables.measures_table(parts, CAPTION)}')
  results.write(
    plan.workdir, 'measures', [r for some in found.values() for r in some], {'parts': parts}
  )


def pool(title: str, found: Sequence[Result], metric: str, *, who: str = 'networks') -> Row:
  """A method's numbers with the models of all categories in one."""
  scores = results.select(found, metric, who=who).values()
  models = tuple(name for s in scores for name in s.models)
  return Row(title, {ALL: Scores(models, np.concatenate([s.values for s in scores], axis=1))}, {})


if __name__ == '__main__':
  main()
