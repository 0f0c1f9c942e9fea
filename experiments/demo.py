r"""The whole system once: data, training of both networks, evaluation, models of held-out pictures.

python -m experiments.demo --output=DIR

Every stage is one of the project's programs, and its command is printed. Each stage continues where
it stopped, so the same command resumes an interrupted demonstration. OUTPUT/index.html shows the
results. The exit status is 1 if they are not better than the trivial baselines.
"""

import os
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
from absl import flags
from PIL import Image

from cvn import data, figures
from cvn.dataset import Dataset, open_dataset, read_record
from cvn.errors import UserError
from cvn.files import atomic_write
from experiments.lib import cli, markdown, page, picks, runs, stages, viewer
from experiments.lib.assets import to_png
from experiments.lib.markdown import escape
from experiments.lib.page import Block, Picture
from experiments.lib.picks import Pick
from experiments.lib.runs import Run
from experiments.lib.scoring import to_voxels
from experiments.lib.stages import read_bytes, read_json
from experiments.lib.training import DTYPE_CHOICES
from experiments.report import plots
from experiments.report.read import read_training

PICTURE_VIEWS = (1, 11, 2, 10)  # of the data set, in turn: the front from different angles
VALIDATIONS = 6  # in the course of a training, each on so many views
VALIDATION_VIEWS = 36
FRESH_STATISTICS = 20  # batches: running statistics do not keep up with so short a training
MEASURES = {  # title, form and baseline of each measure
  'iou': ('IoU', '{:.3f}', 'mean training shape'),
  'psnr_rgb': ('surface PSNR, RGB', '{:.2f} dB', 'mean training colour'),
  'psnr_ycbcr': ('surface PSNR, YCbCr', '{:.2f} dB', 'mean training colour'),
}


class Settings(NamedTuple):
  """A demonstration; see the flags of the same names."""

  output: str
  category: str
  limit: int
  shape_epochs: int
  color_epochs: int
  batch_size: int
  learning_rate: float
  dtype: str
  pictures: int
  workers: int
  seed: int


def define_flags(f: flags.FlagValues) -> None:
  own = {'flag_values': f}
  flags.DEFINE_string('output', 'demo', 'Folder for all files.', **own)
  flags.DEFINE_string('category', 'chair', 'Category of the objects.', **own)
  flags.DEFINE_integer('limit', 200, 'Number of objects.', lower_bound=10, **own)
  flags.DEFINE_integer('shape_epochs', 32, 'Epochs of the shape network.', lower_bound=1, **own)
  flags.DEFINE_integer('color_epochs', 32, 'Epochs of the colour network.', lower_bound=1, **own)
  flags.DEFINE_integer('batch_size', 12, 'Views in a training step.', lower_bound=1, **own)
  flags.DEFINE_float(
    'learning_rate', 1e-3, 'Learning rate, higher than in the paper for a short training.', 0, **own
  )
  flags.DEFINE_enum('dtype', 'auto', DTYPE_CHOICES, 'See experiments.train.', **own)
  flags.DEFINE_integer('pictures', 6, 'Held-out pictures to reconstruct.', 1, 8, **own)
  flags.DEFINE_integer('workers', 2, 'Processes that make objects.', lower_bound=1, **own)
  flags.DEFINE_integer('seed', 0, 'Seed of objects and trainings.', 0, 2**32 - 1, **own)


@cli.program(define_flags, computes=False)
def main(f: flags.FlagValues) -> int:
  return run(Settings(*(f[name].value for name in Settings._fields)))


def run(s: Settings) -> int:
  """Runs all stages; returns the exit status."""
  folder = {k: os.path.join(s.output, k) for k in ('data', 'shape', 'color', 'pictures', 'models')}
  evaluation = os.path.join(s.output, 'evaluation.json')
  networks = {k: folder[k] for k in ('shape', 'color')}
  lines = []

  def stage(program, **named):
    lines.append(stages.run_program(s.output, program, **named))

  stage(
    'datagen.generate',
    source='procedural',
    category=s.category,
    limit=s.limit,
    output=folder['data'],
    workers=s.workers,
    seed=s.seed,
  )
  for network, epochs in (('shape', s.shape_epochs), ('color', s.color_epochs)):
    stage(
      'experiments.train',
      network=network,
      recipe='best',
      dtype=s.dtype,
      fresh_statistics=FRESH_STATISTICS,
      data=folder['data'],
      workdir=folder[network],
      epochs=epochs,
      validate_every=max(1, epochs // VALIDATIONS),
      validation_views=VALIDATION_VIEWS,
      batch_size=s.batch_size,
      learning_rate=s.learning_rate,
      seed=s.seed,
    )
  dataset = open_dataset(folder['data'])
  best = {**networks, 'flip': 'true', 'carve': 'true'}
  # A handful of objects may leave none to choose on.
  on_val = {k: 'val' for k in ('threshold', 'alpha') if len(data.select_rows(dataset, 'val'))}
  stage(
    'experiments.evaluate',
    **{'data': folder['data'], 'baselines': 'true', 'json': evaluation, **best, **on_val},
  )
  report = read_json(evaluation)
  best |= {k: report[k] for k in ('threshold', 'alpha')}
  shown = choose(dataset, s.pictures)
  files = [write_picture(dataset, p, folder['pictures']) for p in shown]
  stage('experiments.reconstruct', image=','.join(files), output=folder['models'], **best)

  better = find_better(report)
  seconds = stages.read_seconds(s.output)
  blocks = [
    '# One picture in, a coloured 3D model out',
    escape(about(dataset, [runs.read(w) for w in networks.values()])),
    f'> {say_verdict(report, better)}',
    '## Held-out pictures and the models made from them',
    'Drag to turn, scroll to zoom. The weight is yellow where the sampled colour counts and blue'
    ' where the regressed colour does. The truth is drawn from the same directions.',
    *(x for p in shown for x in make_example(dataset, p, folder['models'], s.output)),
    '## Evaluation on the held-out split',
    make_table(report, better),
    '## Training',
    plots.training_curves(
      [t for w in networks.values() if (t := read_training(w))],
      'training',
      'In training (lines) and on held-out objects of the split val (dots).',
      metrics=('loss', 'iou'),
    ),
    '## The first objects of the data set',
    Picture('objects', read_bytes(os.path.join(folder['data'], 'contact_sheet.png')), ''),
    f'## Commands, {markdown.minutes(sum(seconds[x] for x in lines))} in all',
    markdown.commands((x, seconds[x]) for x in lines),
  ]
  index = os.path.join(s.output, 'index.html')
  with atomic_write(index) as temporary, open(temporary, 'w', encoding='utf-8') as out:
    out.write(page.to_html(blocks))
  print(f'\n{say_verdict(report, better)}\nopen {index}')
  return int(not all(better.values()))


def choose(dataset: Dataset, count: int) -> list[Pick]:
  """Views of the first held-out objects.

  Raises:
    UserError: no object is held out.
  """
  rows = data.select_rows(dataset, 'test')[:count]
  if len(rows) == 0:
    raise UserError('no object fell into the held-out split test: make more (--limit)')
  return [
    picks.of(dataset, row, PICTURE_VIEWS[k % len(PICTURE_VIEWS)]) for k, row in enumerate(rows)
  ]


def name_of(pick: Pick) -> str:
  """The name of a pick's files, without suffix."""
  return f'{pick.model.id}_{pick.azimuth:g}'


def write_picture(dataset: Dataset, pick: Pick, folder: str) -> str:
  """Writes a view as a PNG file with alpha; returns its path."""
  path = os.path.join(folder, f'{name_of(pick)}.png')
  view = read_record(dataset, pick.row).views[pick.view]
  with atomic_write(path) as temporary:
    Image.fromarray(view).save(temporary)
  return path


def make_example(dataset: Dataset, pick: Pick, models: str, output: str) -> list[Block]:
  """A picture, the model made from it, and the truth, with links to the files."""
  stem = os.path.join(models, name_of(pick))
  record = read_record(dataset, pick.row)
  truth = to_voxels(record, dataset.manifest.grid_size)
  azimuths = (figures.PANEL_AZIMUTH, *figures.RESULT_AZIMUTHS)
  blank = np.full((192, 192, 3), 255, np.uint8)  # so that the truth stands below the result
  drawn = figures.grid_of_images(
    [[blank, *(figures.draw_voxels(truth, a, size=192) for a in azimuths)]],
    column_titles=['', *(f'truth from {a}°' for a in azimuths)],
  )
  panel = Picture(name_of(pick), read_bytes(f'{stem}.png'), 'reconstruction')
  canvas = viewer.embed(name_of(pick), read_bytes(f'{stem}.glb'), size=800)
  shown = page.image(panel) + page.image(Picture('', to_png(drawn), 'truth'))
  row = f'<div class="row"><div class="model">{canvas}</div><div class="wide">{shown}</div></div>'
  links = [os.path.relpath(f'{stem}.{suffix}', output) for suffix in ('glb', 'ply', 'png')]
  return [
    f'### {escape(pick.model.id)}, seen from {pick.azimuth:g}°',
    panel._replace(caption='', html=row),
    ' '.join(f'[{escape(os.path.basename(link))}](<{link}>)' for link in links),
  ]


def find_better(report: Mapping[str, Any]) -> dict[str, bool]:
  """For each measure, whether the networks are above the baselines."""
  ours, trivial = (report[who]['total'] for who in ('networks', 'baselines'))
  return {
    m: ours[m] is not None and trivial[m] is not None and ours[m] > trivial[m] for m in MEASURES
  }


def make_table(report: Mapping[str, Any], better: Mapping[str, bool]) -> str:
  """The networks beside the baselines, the better of each measure in bold."""
  names = {'networks': 'networks'}
  names['baselines'] = ' and '.join(dict.fromkeys(b for *_, b in MEASURES.values()))
  rows = []
  for who, label in names.items():
    texts = {m: _format(m, report[who]['total'][m]) for m in MEASURES}
    bold = [f'**{t}**' if better[m] == (who == 'networks') else t for m, t in texts.items()]
    rows.append([label, *bold])
  return markdown.numbers(['', *(title for title, *_ in MEASURES.values())], rows)


def say_verdict(report: Mapping[str, Any], better: Mapping[str, bool]) -> str:
  """Whether the networks are better than the baselines, in words."""
  ours, trivial = (report[who]['total'] for who in ('networks', 'baselines'))
  said = ', '.join(
    f'{title} {_format(m, ours[m])} ({"above" if better[m] else "NOT above"}'
    f' {_format(m, trivial[m])} of the {baseline})'
    for m, (title, _, baseline) in MEASURES.items()
  )
  start = 'Better than the baselines' if all(better.values()) else 'NOT better than the baselines'
  views = f'{report["models"]} held-out objects, {report["views"]} views each'
  return f'{start} on {views}: {said}.'


def about(dataset: Dataset, trained: Iterable[Run]) -> str:
  """The origin and the limits of the numbers."""
  train, test = (len(data.select_rows(dataset, split)) for split in ('train', 'test'))
  names = sorted({m.category for m in dataset.manifest.models})
  epochs = ' and '.join(f'{runs.epochs_of(run):.4g}' for run in trained)
  return (
    f'{train} procedural {" and ".join(f"{name}s" for name in names)} for training, {test} held'
    f' out; {epochs} epochs of training from random weights on this computer, with one view of'
    ' each object in an epoch. This shows that the whole chain works and that the networks learn,'
    ' not how good they can get: the paper trains 500 epochs on up to 2372 models of a category.'
    ' No held-out object was seen in training, and the examples are the first of them, not the'
    ' best.'
  )


def _format(measure: str, value: float | None) -> str:
  return 'none' if value is None else MEASURES[measure][1].format(value)


if __name__ == '__main__':
  main()
