r"""Trains the networks in several ways from the same seed, and compares them.

python -m experiments.compare_training --data=DIR --workdir=DIR [--epochs=12] [--quick]

float32 and mixed are the dtypes of experiments.train; surface is --heads=surface, which only the
colour network has. Each training is a run in WORKDIR/<network>_<variant>_<seed>, with the same
first parameters and the same batches whatever the variant; experiments.evaluate then judges it on
held-out models: shapes by their IoU, colours by their PSNR on the true shapes. Each goes on where
it stopped, so the same command resumes an interrupted comparison. Prints a table, and draws the
loss curves to WORKDIR/loss.png. Several --seeds tell how much of a difference is chance.
"""

import json
import os
from typing import NamedTuple

import matplotlib.figure
from absl import flags

from cvn import errors
from cvn.files import atomic_write
from experiments.lib import differences, markdown, pictures, runs
from experiments.lib.runs import Run
from experiments.lib.stages import read_bytes

VARIANTS = {
  'float32': {'dtype': 'float32'},
  'mixed': {'dtype': 'mixed'},
  'surface': {'dtype': 'float32', 'heads': 'surface'},
}
SHAPE_VARIANTS = ('float32', 'mixed')
STYLES = dict(zip(VARIANTS, ('-', '--', ':'), strict=True))  # float32 and mixed lie on each other
MEASURES = {
  'shape': (('iou', 'IoU', '.3f'),),
  'color': (('psnr_rgb', 'PSNR RGB', '.2f'), ('psnr_ycbcr', 'PSNR YCbCr', '.2f')),
}
VALIDATION_VIEWS = 36


class Training(NamedTuple):
  """What is known of a finished run."""

  network: str
  variant: str
  seed: str
  run: Run
  curve: list[tuple[float, float]]  # (epoch, mean loss of the steps of that epoch)
  validated: list[tuple[float, float]]  # (epoch, loss on the split val)
  measured: dict[str, float | None]  # on the split test


def define_flags(f: flags.FlagValues) -> None:
  """The program's flags. Not at import: there the names of several programs would collide."""
  own = {'flag_values': f}
  flags.DEFINE_string('data', None, 'The data set: a folder or URL of datagen.generate.', **own)
  flags.DEFINE_string('workdir', None, 'The folder for all that is made.', **own)
  flags.DEFINE_multi_enum('network', [*MEASURES], [*MEASURES], 'The networks to train.', **own)
  flags.DEFINE_multi_enum('variant', [*VARIANTS], [*VARIANTS], 'How to train them.', **own)
  flags.DEFINE_integer('epochs', 12, 'Of each training.', lower_bound=1, **own)
  flags.DEFINE_integer('batch_size', 12, 'Views a step.', lower_bound=1, **own)
  flags.DEFINE_float('learning_rate', 1e-3, "Higher than the paper's: time is short.", 0, **own)
  flags.DEFINE_list('seeds', ['0'], 'Of everything random; one training each.', **own)
  flags.DEFINE_bool('quick', False, 'One epoch: whether it works, not how well.', **own)
  flags.mark_flags_as_required(['data', 'workdir'], f)


def main(_) -> None:
  run(flags.FLAGS)


def run(f: flags.FlagValues) -> None:
  """Trains, evaluates, prints and draws as the flags say."""
  options = {
    'epochs': 1 if f.quick else f.epochs,
    'batch_size': f.batch_size,
    'learning_rate': f.learning_rate,
  }
  trainings = [
    train(f.data, f.workdir, network, variant, seed, **options)
    for network in f.network
    for seed in f.seeds
    for variant in f.variant
    if network == 'color' or variant in SHAPE_VARIANTS
  ]
  print('\n' + to_table(trainings))
  stem = os.path.join(f.workdir, 'loss')
  draw(trainings, f'{stem}.png')
  used = [t.run for t in trainings]
  caption = 'Lines: the loss in training; dots: the loss on the split val.'
  caption += f' {differences.say_training(used)}'
  pictures.write_facts(stem, caption, {'data': f.data, 'runs': runs.to_json(used)})
  print(f'\nloss curves: {stem}.png')


def train(
  data: str,
  folder: str,
  network: str,
  variant: str,
  seed: str,
  *,
  epochs: int,
  batch_size: int,
  learning_rate: float,
) -> Training:
  """Trains and evaluates one network, or what is missing of it.

  Args:
    data: the data set.
    folder: of all that is made.
    network: a key of `MEASURES`.
    variant: a key of `VARIANTS`.
    seed: of everything random.
    epochs: of the training.
    batch_size: views a step.
    learning_rate: the first one.
  """
  workdir = os.path.join(folder, f'{network}_{variant}_{seed}')
  run = runs.train(
    folder,
    network=network,
    data=data,
    workdir=workdir,
    epochs=epochs,
    batch_size=batch_size,
    learning_rate=learning_rate,
    seed=seed,
    log_every=10**6,  # then a line is an epoch's
    validate_every=max(1, epochs // 6),
    validation_views=VALIDATION_VIEWS,
    **VARIANTS[variant],
  )
  report = runs.evaluate(folder, data=data, json=f'{workdir}.json', **{network: workdir})
  lines = [json.loads(x) for x in read_bytes(os.path.join(workdir, 'log.jsonl')).splitlines()]
  measured = report['networks']['total']
  return Training(
    network,
    variant,
    seed,
    run,
    [(x['epoch'], x['loss']) for x in lines if 'loss' in x],
    [(x['epoch'], x['validation']['loss']) for x in lines if 'validation' in x],
    {key: measured[key] for key, *_ in MEASURES[network]},
  )


def to_table(trainings: list[Training]) -> str:
  """A Markdown table: a row a training, the measures on held-out models."""
  head = ('network', 'variant', 'seed', 'loss, last epoch', 'on val', 'on test')
  lines = []
  for t in trainings:
    measured = ', '.join(
      f'{title} {"none" if t.measured[key] is None else format(t.measured[key], form)}'
      for key, title, form in MEASURES[t.network]
    )
    validated = f'{t.validated[-1][1]:.4f}' if t.validated else 'none'
    lines.append((t.network, t.variant, t.seed, f'{t.curve[-1][1]:.4f}', validated, measured))
  return markdown.table(head, lines)


def draw(trainings: list[Training], path: str) -> None:
  """Loss over epochs, a panel a network: lines in training, points on the split val."""
  networks = list(dict.fromkeys(t.network for t in trainings))
  variants = list(dict.fromkeys(t.variant for t in trainings))
  figure = matplotlib.figure.Figure(figsize=(4.4 * len(networks), 3), dpi=90, layout='constrained')
  for axes, network in zip(
    figure.subplots(1, len(networks), squeeze=False)[0], networks, strict=True
  ):
    for t in (t for t in trainings if t.network == network):
      color = f'C{variants.index(t.variant)}'
      label = t.variant if t.seed == trainings[0].seed else None
      style = {'color': color, 'linestyle': STYLES[t.variant], 'label': label}
      axes.plot(*zip(*t.curve, strict=True), **style)
      if t.validated:
        axes.plot(*zip(*t.validated, strict=True), 'o', color=color, markersize=3)
    axes.set(title=f'{network} network', xlabel='epoch', ylabel='loss')
    axes.legend(frameon=False)
  with atomic_write(path) as temporary:
    figure.savefig(temporary, format='png')


if __name__ == '__main__':
  define_flags(flags.FLAGS)
  errors.run(main)
