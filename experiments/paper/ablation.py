r"""What goes beyond the paper, one thing after the other, and what each brings.

python -m experiments.paper.ablation --data=DIR --workdir=DIR [--models=all] [--epochs=...]
  [--quick]

The first line is the recipe `paper` with the threshold 0.8 and alpha = 0.2, the last one the recipe
`best` as it is meant to be used; each line adds one thing to those above it. Thresholds and alphas
are chosen on the split val, and so is what stays in the recipe; the split test is only told.
Numbers go to WORKDIR/tables/ablation.json.
"""

import numpy as np
from absl import flags

from cvn import environment, errors
from experiments.lib import markdown, protocol, tables
from experiments.lib.protocol import Plan
from experiments.lib.tables import Row

STEPS = (
  *('blended_0.2', 'plus_threshold', 'plus_alpha', 'plus_color', 'plus_shape', 'plus_flip'),
  'best',
)
ENDS = {'blended_0.2': 'paper', 'best': '+ carved by the silhouette'}  # what they are called here
METRICS = {'iou': ('IoU', '.3f'), 'psnr_rgb': ('PSNR RGB', '.2f')}
SPLITS = ('val', 'test')


def define_flags(f: flags.FlagValues) -> None:
  """The program's flags. Not at import: there the names of several programs would collide."""
  protocol.define_flags(f)


def main(_) -> None:
  run(flags.FLAGS)


def run(f: flags.FlagValues) -> None:
  """Makes the table as the flags say."""
  make_table(protocol.read_flags(f))


def make_table(plan: Plan) -> None:
  """Evaluates all steps on val and test, prints and writes."""
  results = {(s, m): tables.evaluate(plan, m, split=s) for s in SPLITS for m in STEPS}
  rows = {
    (split, metric): [
      Row(ENDS.get(m, protocol.METHODS[m].title), tables.select(results[split, m], metric), {})
      for m in STEPS
    ]
    for split in SPLITS
    for metric in METRICS
  }
  print(f'\n{to_markdown(rows)}\n')
  table = {split: {m: tables.to_part(rows[split, m], []) for m in METRICS} for split in SPLITS}
  for metric, (title, form) in METRICS.items():
    first, *_, last = rows['test', metric]
    comparison = tables.compare(last._replace(title='best'), first)
    print(f'{title}: {tables.to_line(comparison, form)}')
    table['test'][metric]['comparisons'].append(comparison._asdict())
  tables.finish(plan.workdir, 'ablation', table, [r for found in results.values() for r in found])


def to_markdown(rows: dict[tuple[str, str], list[Row]]) -> str:
  """A line a step: the mean over models, and the gain over the first line."""
  heads = [f'{METRICS[m][0]}, {split}' for split, m in rows]
  lines = []
  for step, _ in enumerate(STEPS):
    cells = []
    for (_, metric), steps in rows.items():
      value, first = (mean_over_models(steps[n]) for n in (step, 0))
      form = METRICS[metric][1]
      gain = f'{value / first - 1:+.0%}' if metric == 'iou' else f'{value - first:+.2f} dB'
      cells.append(f'{value:{form}}' + (f' ({gain})' if step else ''))
    title = next(iter(rows.values()))[step].title
    lines.append([title, *cells])
  return markdown.table(['', *heads], lines)


def mean_over_models(row: Row) -> float:
  """The mean over all models of all categories, and over seeds."""
  return float(np.nanmean(np.concatenate([s.values.ravel() for s in row.scores.values()])))


if __name__ == '__main__':
  environment.prepare()
  define_flags(flags.FLAGS)
  errors.run(main)
