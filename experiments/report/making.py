"""The report's last sections: how its numbers were made, and from what."""

import math
import os
from collections.abc import Sequence

from experiments.report import facts, plots, setting
from experiments.report.blocks import Block, Cell, Commands, Heading, Items, Missing, Table
from experiments.report.facts import Data
from experiments.report.read import read_seconds
from experiments.report.results import Workdir
from experiments.report.setting import heading, missing


def training(workdirs: Sequence[Workdir]) -> list[Block]:
  """All trainings: curves, and how long they were."""
  found = []
  for w in workdirs:
    if w.trainings:
      caption = 'Loss in training (lines) and on held-out models of the split val (dots).'
      curves = plots.training_curves(w.trainings, f'training_{w.key}', caption)
      found += [*heading(workdirs, w), curves, _trainings_table(w)]
  return found or [missing('Trainings', 'experiments.paper.iou')]


def _trainings_table(w: Workdir) -> Table:
  rows = []
  for t in w.trainings:
    last = t.validation[-1][1] if t.validation else {}
    spent = sum(s for line, s in w.seconds.items() if f'/runs/{t.name} ' in f'{line} ')
    numbers = [f'{last[k]:.4f}' if k in last else '–' for k in ('loss', 'iou')]
    texts = [
      str(t.config.get('recipe', '–')),
      t.seed,
      f'{t.epochs:.3g}',
      f'{t.steps:,}',
      f'{t.samples:,}',
    ]
    texts += [*numbers, f'{spent / 60:.0f}' if spent else '–']
    rows.append((f'{t.training} ({t.scope})', [Cell(x) for x in texts]))
  heads = ['recipe', 'seed', 'epochs', 'steps', 'views seen', 'loss, val', 'IoU, val', 'minutes']
  return Table('Trainings; on val after the last epoch', [], heads, rows)


def repeat(workdirs: Sequence[Workdir], data: dict[str, Data]) -> list[Block]:
  """The commands in their order, with the times that were measured."""
  known = setting.folders(workdirs, data)
  ran: dict[str, float] = {}
  for folder in dict.fromkeys(map(setting.parent, data.values())):
    ran |= read_seconds(os.path.join(folder, 'seconds.json'))
  for w in workdirs:
    ran |= w.seconds
  lines = [(facts.shorten(line, known), seconds) for line, seconds in ran.items()]
  hours = sum(ran.values()) / 3600
  blocks: list[Block] = [
    Commands(
      'These programs, in this order; each trains and evaluates what is missing, and goes on where'
      ' it stopped:',
      [(line, math.nan) for line in setting.commands(workdirs, data)],
    )
  ]
  if lines:
    title = f'What they ran: {len(lines)} commands, {hours:.1f} hours in all'
    blocks.append(Commands(title, lines))
  return blocks


def versions(workdirs: Sequence[Workdir], seed: int) -> list[Block]:
  """Everything random, and what it was run with."""
  seeds = [
    f'networks, {w.label}: {", ".join(dict.fromkeys(t.seed for t in w.trainings))}'
    for w in workdirs
    if w.trainings
  ]
  for w in workdirs:
    for f in (*w.figures.values(), *w.study.values()):
      for key in ('figure_seed', 'study_seed'):
        if key in f.facts:
          seeds.append(f'choice of models in “{f.name}”: {f.facts[key]}')
  seeds.append(f'choice of models to turn: {seed}')
  return [Heading('Seeds'), Items(seeds), facts.versions_table()]


def licences(data: dict[str, Data]) -> list[Block]:
  """Who made the models, and on what terms they may be used."""
  if not data:
    return [
      Missing(
        'The data sets are no longer in their places. They are made by',
        'python -m experiments.collection --output=DATA',
      )
    ]
  return [facts.licence_table(d) for d in data.values()]
