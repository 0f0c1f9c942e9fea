r"""The whole system once: data, training of both networks, evaluation, models of held-out pictures.

python -m experiments.demo --output=DIR

Every stage is one of the project's own programs, shown as it is run. Each of them goes on where it
stopped, so the same command resumes an interrupted demonstration. OUTPUT/index.html shows what came
out. The exit status is 1 when that is not better than the trivial baselines.
"""

import json
import os
from collections.abc import Sequence

import numpy as np
from absl import flags
from PIL import Image

from cvn import data, errors, figures
from cvn.dataset import Dataset, open_dataset, read_record
from cvn.errors import UserError
from cvn.files import atomic_write
from experiments import demo_page
from experiments.lib import assets, picks, runs
from experiments.lib.picks import Pick
from experiments.lib.runs import Run
from experiments.lib.scoring import to_voxels
from experiments.lib.stages import read_bytes, read_json, run_program, seconds_of
from experiments.lib.training import DTYPE_CHOICES

# Pictures show the object's front at different angles: these views of the data set, in turn.
PICTURE_VIEWS = (1, 11, 2, 10)


VALIDATIONS = 6  # in the course of a training, of so many views each
VALIDATION_VIEWS = 36
FRESH_STATISTICS = 20  # batches: running statistics do not keep up with so short a training

# What the networks are measured by, its name and the baseline it is compared with.
MEASURES = (
  ('iou', 'IoU', 'mean training shape'),
  ('psnr_rgb', 'surface PSNR, RGB', 'mean training colour'),
  ('psnr_ycbcr', 'surface PSNR, YCbCr', 'mean training colour'),
)


def define_flags(f: flags.FlagValues) -> None:
  """The program's flags. Not at import: there the names of several programs would collide."""
  own = {'flag_values': f}
  flags.DEFINE_string('output', 'demo', 'The folder for all that is made.', **own)
  flags.DEFINE_string('category', 'chair', 'What the objects are.', **own)
  flags.DEFINE_integer('limit', 200, 'Objects to make.', lower_bound=10, **own)
  flags.DEFINE_integer('shape_epochs', 32, 'Of the shape network.', lower_bound=1, **own)
  flags.DEFINE_integer('color_epochs', 32, 'Of the colour network.', lower_bound=1, **own)
  flags.DEFINE_integer('batch_size', 12, 'Views a training step.', lower_bound=1, **own)
  flags.DEFINE_float('learning_rate', 1e-3, "Higher than the paper's: time is short.", 0, **own)
  flags.DEFINE_enum('dtype', 'auto', DTYPE_CHOICES, 'As of experiments.train.', **own)
  flags.DEFINE_integer('pictures', 6, 'Held-out pictures to reconstruct.', 1, 8, **own)
  flags.DEFINE_integer('workers', 2, 'Processes that make objects.', lower_bound=1, **own)
  flags.DEFINE_integer('seed', 0, 'Of everything random.', 0, 2**32 - 1, **own)


def main(_) -> int:
  return run(flags.FLAGS)


def run(f: flags.FlagValues) -> int:
  """Runs all stages; returns the exit status."""
  folder = {k: os.path.join(f.output, k) for k in ('data', 'shape', 'color', 'pictures', 'models')}
  evaluation = os.path.join(f.output, 'evaluation.json')
  networks = {k: folder[k] for k in ('shape', 'color')}

  lines = []

  def stage(program, **named):
    lines.append(run_program(f.output, program, **named))

  stage(
    'datagen.generate',
    source='procedural',
    category=f.category,
    limit=f.limit,
    output=folder['data'],
    workers=f.workers,
    seed=f.seed,
  )
  for network, epochs in (('shape', f.shape_epochs), ('color', f.color_epochs)):
    stage(
      'experiments.train',
      network=network,
      recipe='best',
      dtype=f.dtype,
      fresh_statistics=FRESH_STATISTICS,
      data=folder['data'],
      workdir=folder[network],
      epochs=epochs,
      validate_every=max(1, epochs // VALIDATIONS),
      validation_views=VALIDATION_VIEWS,
      batch_size=f.batch_size,
      learning_rate=f.learning_rate,
      seed=f.seed,
    )
  dataset = open_dataset(folder['data'])
  best = {**networks, 'flip': 'true', 'carve': 'true'}
  # A handful of objects may leave none to choose on.
  on_val = {k: 'val' for k in ('threshold', 'alpha') if len(data.select_rows(dataset, 'val'))}
  stage(
    'experiments.evaluate',
    **{'data': folder['data'], 'baselines': 'true', 'json': evaluation, **best, **on_val},
  )
  best |= {k: read_json(evaluation)[k] for k in ('threshold', 'alpha')}
  shown = choose(dataset, f.pictures)
  files = [write_picture(dataset, p, folder['pictures']) for p in shown]
  stage('experiments.reconstruct', image=','.join(files), output=folder['models'], **best)

  table, success, verdict = judge(read_json(evaluation))
  page = demo_page.Page(
    about=about(dataset, [runs.read(w) for w in networks.values()]),
    verdict=verdict,
    success=success,
    examples=[make_example(dataset, p, folder['models'], f.output) for p in shown],
    table=table,
    curves=[
      *read_curves('shape', os.path.join(folder['shape'], 'log.jsonl')),
      *read_curves('colour', os.path.join(folder['color'], 'log.jsonl')),
    ],
    contact_sheet=read_bytes(os.path.join(folder['data'], 'contact_sheet.png')),
    commands=[(line, seconds_of(line, f.output)) for line in lines],
  )
  index = os.path.join(f.output, 'index.html')
  with atomic_write(index) as temporary, open(temporary, 'w', encoding='utf-8') as out:
    out.write(demo_page.render(page))
  print(f'\n{verdict}\nopen {index}')
  return int(not success)


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
  """A view as a PNG file with alpha; returns its name."""
  path = os.path.join(folder, f'{name_of(pick)}.png')
  view = read_record(dataset, pick.row).views[pick.view]
  with atomic_write(path) as temporary:
    Image.fromarray(view).save(temporary)
  return path


def make_example(dataset: Dataset, pick: Pick, models: str, output: str):
  """What the page shows of a picture."""
  stem = os.path.join(models, name_of(pick))
  record = read_record(dataset, pick.row)
  truth = to_voxels(record, dataset.manifest.grid_size)
  azimuths = (figures.PANEL_AZIMUTH, *figures.RESULT_AZIMUTHS)
  blank = np.full((192, 192, 3), 255, np.uint8)  # so that the truth stands below the result
  drawn = figures.grid_of_images(
    [[blank, *(figures.draw_voxels(truth, a, size=192) for a in azimuths)]],
    column_titles=['', *(f'truth from {a}°' for a in azimuths)],
  )
  return demo_page.Example(
    f'{pick.model.id}, seen from {pick.azimuth:g}°',
    read_bytes(f'{stem}.png'),
    assets.to_png(drawn),
    read_bytes(f'{stem}.glb'),
    [os.path.relpath(f'{stem}.{suffix}', output) for suffix in ('glb', 'ply', 'png')],
  )


def read_curves(network: str, path: str) -> list[demo_page.Curve]:
  """The loss in a training's log, and the IoU where it was measured."""
  lines = [json.loads(line) for line in read_bytes(path).splitlines()]
  curves = []
  for metric, title in (('loss', 'loss'), ('iou', 'IoU')):
    trained = [(x['epoch'], x[metric]) for x in lines if metric in x]
    validated = [
      (x['epoch'], x['validation'][metric]) for x in lines if metric in x.get('validation', ())
    ]
    if trained or validated:
      curves.append(demo_page.Curve(f'{network} network: {title}', trained, validated))
  return curves


def judge(evaluation: dict) -> tuple[demo_page.Table, bool, str]:
  """The table of results, whether they beat the baselines, and that in words."""
  ours, trivial = (evaluation[who]['total'] for who in ('networks', 'baselines'))

  def text(metric, value):
    if value is None:
      return 'none'
    return f'{value:.3f}' if metric == 'iou' else f'{value:.2f} dB'

  better = [
    ours[m] is not None and trivial[m] is not None and ours[m] > trivial[m] for m, *_ in MEASURES
  ]
  table = demo_page.Table(
    [title for _, title, _ in MEASURES],
    [
      (label, [text(m, numbers[m]) for m, *_ in MEASURES])
      for label, numbers in (
        ('networks', ours),
        (' and '.join(dict.fromkeys(b for *_, b in MEASURES)), trivial),
      )
    ],
    [0 if b else 1 for b in better],
  )
  said = ', '.join(
    f'{title} {text(m, ours[m])} ({"above" if b else "NOT above"} {text(m, trivial[m])} of the'
    f' {baseline})'
    for (m, title, baseline), b in zip(MEASURES, better, strict=True)
  )
  start = 'Better than the baselines' if all(better) else 'NOT better than the baselines'
  views = f'{evaluation["models"]} held-out objects, {evaluation["views"]} views each'
  return table, all(better), f'{start} on {views}: {said}.'


def about(dataset: Dataset, trained: Sequence[Run]) -> str:
  """What a reader must know to judge the page."""
  train, test = (len(data.select_rows(dataset, split)) for split in ('train', 'test'))
  names = sorted({m.category for m in dataset.manifest.models})
  epochs = ' and '.join(f'{runs.epochs_of(run):.4g}' for run in trained)
  return (
    f'{train} made-up {" and ".join(f"{name}s" for name in names)} to learn from, {test} held out;'
    f' {epochs} epochs of training (one view an object and epoch),'
    ' all from nothing and on this computer. It shows that the whole chain works and that the'
    ' networks learn; it is no measure of what they reach: the paper trains 500 epochs on up to'
    ' 2372 models a category. No held-out object was seen in training, and the examples are the'
    ' first of them, not the best.'
  )


if __name__ == '__main__':
  define_flags(flags.FLAGS)
  errors.run(main)
