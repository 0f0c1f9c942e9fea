r"""The mean IoU by the occupancy threshold: why losses are compared at two thresholds.

python -m experiments.paper.figures.threshold --data=DIR --workdir=DIR [--models=all] [--epochs=...]

A cross-entropy over all voxels makes a network less confident of the few occupied voxels than
MSFCEL does, so a single fixed threshold favours one loss. The curves are measured on the split val,
on which thresholds are chosen; the dashed line is the authors' 0.8. The figure goes to
WORKDIR/figures/threshold.png, the numbers to threshold.json.
"""

import os

import matplotlib.figure
from absl import flags
from tqdm import tqdm

from cvn import data, metrics
from cvn.dataset import open_dataset
from cvn.errors import UserError
from cvn.files import atomic_write
from cvn.readouts import SHAPE_KINDS
from experiments.lib import cli, differences, protocol, runs, scoring, stages
from experiments.lib.protocol import Plan

METHODS = ('cross_entropy', 'msfcel')


@cli.program(protocol.define_flags)
def main(f: flags.FlagValues) -> None:
  make_figure(protocol.read_flags(f))


def make_figure(plan: Plan) -> None:
  """Finds the curves, draws and writes.

  Raises:
    UserError: there is no finished model to validate on.
  """
  dataset = open_dataset(plan.data)
  curves, used = {}, []
  for trained_on, judged in protocol.trained_for(plan, protocol.categories(plan)):
    rows = data.select_rows(dataset, 'val', categories=judged, sources=plan.sources)
    if len(rows) == 0:
      raise UserError(f'{plan.data} has no finished model in the split val of {", ".join(judged)}')
    for method in METHODS:
      run = protocol.train(plan, protocol.METHODS[method].shape, trained_on, plan.seeds[0])
      used.append(run)
      shape = scoring.load(run.workdir, SHAPE_KINDS, dataset)
      progress = tqdm(rows, desc=f'{method}, {trained_on}', unit='model', disable=None)
      thresholds, iou = scoring.threshold_curve(dataset, progress, shape)
      curves.setdefault(trained_on, {})[method] = {
        'thresholds': thresholds.tolist(),
        'iou': iou.tolist(),
      }
  stem = os.path.join(plan.workdir, 'figures', 'threshold')
  draw(curves, f'{stem}.png')
  caption = f'Mean IoU on the split val by the threshold. {differences.say_training(used)}'
  facts = {'data': plan.data, 'split': 'val', 'runs': runs.to_json(used), 'curves': curves}
  stages.write_results(f'{stem}.json', {'caption': caption, **facts})
  print(f'{stem}.png')


def draw(curves: dict[str, dict[str, dict[str, list[float]]]], path: str) -> None:
  """A panel for what each pair of models was trained on."""
  figure = matplotlib.figure.Figure(figsize=(4 * len(curves), 3), dpi=110, layout='constrained')
  panels = figure.subplots(1, len(curves), squeeze=False, sharey=True)[0]
  for axes, (trained_on, found) in zip(panels, curves.items(), strict=True):
    for method, curve in found.items():
      axes.plot(curve['thresholds'], curve['iou'], label=protocol.METHODS[method].title)
    axes.axvline(metrics.OCCUPIED, color='grey', linestyle='--', linewidth=1)
    axes.set(title=trained_on, xlabel='occupied: p above', ylim=(0, None))
    axes.legend(frameon=False)
  panels[0].set_ylabel('mean IoU, split val')
  with atomic_write(path) as temporary:
    figure.savefig(temporary, format='png')


if __name__ == '__main__':
  main()
