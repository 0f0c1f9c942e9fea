r"""Articulated objects: IoU of people by azimuth and by colour complexity, and pictures of some.

python -m experiments.people --data=DIR --workdir=DIR [--category=human] [--seeds=0,1,2]
  [--epochs=...] [--t1=50 --clusters=128 --t2=5] [--people=4 --figure_seed=0] [--quick]

The paper's sections "Evaluation on Articulated Objects" and "Further Analysis". Trains what is
missing, reuses what is there; prints Markdown tables, and writes WORKDIR/tables/people.json and
WORKDIR/figures/people_{azimuth,complexity,results}.png.

Intervals hold 95 % of the means of models drawn again (bootstrap); with several seeds a model's
IoU is its mean over them. Colour complexity is as the paper defines it, of the foreground of all
finished models of the category, whatever their split: colours with at least --t1 pixels, clustered
by K-means, each colour counting once; a view's complexity is the number of clusters with more than
--t2 of its pixels.
"""

import os
from typing import Any

import jax
import numpy as np
from absl import flags
from PIL import Image
from tqdm import tqdm

from cvn import checkpoint, complexity, data, environment, errors, figures, reconstruct
from cvn.dataset import SPLITS, Dataset, open_dataset, read_record
from cvn.errors import UserError
from cvn.files import atomic_write
from experiments import people_analysis, people_figures, people_report, protocol, scoring, tables
from experiments.people_analysis import Colors
from experiments.people_report import Study

DEFAULT_CATEGORY = 'human'
METHOD = 'blended_0.2'
TILE = 128  # pixels of each small picture
FIGURES = ('azimuth', 'complexity', 'results')


def define_flags(f: flags.FlagValues) -> None:
  """The program's flags. Not at import: there the names of several programs would collide."""
  own = {'flag_values': f}
  protocol.define_flags(f)
  flags.DEFINE_integer(
    't1', complexity.T1, 'Pixels of the set that a colour needs to be clustered.', 1, **own
  )
  flags.DEFINE_integer('clusters', complexity.CLUSTERS, 'Of colours: K.', 1, **own)
  flags.DEFINE_integer('t2', complexity.T2, 'Pixels of a view that do not count yet.', 0, **own)
  flags.DEFINE_integer('people', 4, 'Test models in the picture of results.', 1, **own)
  flags.DEFINE_integer('figure_seed', 0, 'Of the choice of these and of their views.', 0, **own)
  flags.register_validator('seeds', bool, 'must name one at least', f)
  flags.register_validator('category', lambda c: len(c) < 2, 'must be one', f)


def main(_) -> None:
  run(flags.FLAGS)


def run(f: flags.FlagValues) -> None:
  """Trains and evaluates as the flags say; prints, writes and draws the analysis."""
  dataset = open_dataset(f.data)
  people_analysis.check_azimuths(dataset.manifest.azimuths)
  category = f.category[0] if f.category else DEFAULT_CATEGORY
  trained_on = protocol.ALL if f.models == protocol.ALL else category
  ids, colors = read_colors(f, dataset, category)  # a wrong --t1 is found before the training
  study = examine(f, dataset, category, trained_on, ids, colors)
  print('\n' + people_report.to_markdown(study))
  stem = os.path.join(f.workdir, 'figures', 'people')
  title = f'{len(study.models)} test models ({category})\n' + study.networks[0]
  people_figures.plot_azimuths(f'{stem}_azimuth.png', title, study.analysis.by_azimuth)
  people_figures.plot_complexity(
    f'{stem}_complexity.png', title, study.analysis.by_complexity, study.tested, colors.complexity
  )
  shown = draw_results(f'{stem}_results.png', f, dataset, category, trained_on)
  print('\n' + '\n'.join(f'{stem}_{k}.png' for k in FIGURES))
  tables.finish(f, 'people', {**people_report.to_json(study), 'results': shown})


def read_colors(f: flags.FlagValues, dataset: Dataset, category: str) -> tuple[list[str], Colors]:
  """The ids of all finished models of the category, and their views' colours.

  Raises:
    UserError: there is none, or no colour has --t1 pixels.
  """
  rows = np.concatenate([data.select_rows(dataset, s, [category]) for s in SPLITS])
  if len(rows) == 0:
    raise UserError(f'{f.data} has no finished {category} (make some: datagen.generate)')
  palettes = [
    [complexity.find_palette(view) for view in read_record(dataset, row).views]
    for row in tqdm(rows, desc='colours', unit='model', disable=None)
  ]
  colors = people_analysis.measure_colors(palettes, t1=f.t1, clusters=f.clusters, t2=f.t2)
  return [dataset.manifest.models[row].id for row in rows], colors


def examine(
  f: flags.FlagValues,
  dataset: Dataset,
  category: str,
  trained_on: str,
  ids: list[str],
  colors: Colors,
) -> Study:
  """How well the category's test models are reconstructed, in the mean of the seeds, and why.

  Args:
    f: the flags.
    dataset: the open data set.
    category: of the models.
    trained_on: the category, or `protocol.ALL`.
    ids: of all models of the category.
    colors: likewise.

  Raises:
    UserError: none of them is for testing.
  """
  reports = [protocol.evaluate(f, METHOD, trained_on, seed) for seed in f.seeds]
  models = reports[0]['networks']['by_model']
  names = [name for name, model in models.items() if model['category'] == category]
  if not names:
    raise UserError(f'{f.data} has no finished {category} in the split test')

  def mean_of_seeds(who, metric):
    found = [[r[who]['by_model'][name][metric] for name in names] for r in reports]
    return np.mean(np.array(found, float), axis=0)

  scores = {metric: mean_of_seeds('networks', metric) for metric in scoring.METRICS}
  tested = colors.complexity[[ids.index(name) for name in names]]
  own = protocol.METHODS[METHOD]
  return Study(
    category,
    [describe_network(f, t, trained_on, seed) for seed in f.seeds for t in (own.shape, own.color)],
    [r['threshold'] for r in reports],
    names,
    scores,
    mean_of_seeds('baselines', 'iou'),
    colors,
    tested,
    people_analysis.analyze(dataset.manifest.azimuths, scores['iou'], tested),
  )


def describe_network(f: flags.FlagValues, training: str, trained_on: str, seed: str) -> str:
  """A network and the length of its training, for people."""
  workdir = protocol.train(f, training, trained_on, seed)
  config = checkpoint.read_config(workdir)
  steps = checkpoint.latest_step(workdir)
  epochs = steps / (config['models'] // config['batch_size'])
  return (
    f'{os.path.basename(workdir)}: {epochs:.3g} epochs of {config["models"]} models,'
    f' {steps} steps of {config["batch_size"]}'
  )


def draw_results(
  path: str, f: flags.FlagValues, dataset: Dataset, category: str, trained_on: str
) -> dict[str, Any]:
  """Draws reconstructions of random test models; returns what they are, as JSON values."""
  azimuths, size = dataset.manifest.azimuths, dataset.manifest.grid_size
  networks = protocol.load(f, METHOD, trained_on, f.seeds[0])
  rng = np.random.default_rng(f.figure_seed)
  rows = rng.permutation(data.select_rows(dataset, 'test', [category], f.source))[: f.people]
  views = rng.integers(len(azimuths), size=len(rows))
  pictures, shown = [], []
  for row, view in zip(tqdm(rows, desc='draw', unit='model', disable=None), views, strict=True):
    record = read_record(dataset, row)
    batch = reconstruct.reconstruct(
      networks.shape.variables,
      networks.color.variables,
      record.views[[view]].astype(np.float32) / 255,
      alpha=networks.alpha,
      grid_size=size,
    )
    one = jax.tree.map(lambda x: np.asarray(x)[0], batch)
    voxels = reconstruct.to_voxels(one, networks.threshold)
    true = scoring.to_voxels(record, size)
    azimuth = azimuths[view]
    pictures.append(
      people_figures.draw_result(record.views[view], azimuth, one, voxels, true, size=TILE)
    )
    shown.append({'model': dataset.manifest.models[row].id, 'azimuth': azimuth})
  image = figures.grid_of_images(
    pictures,
    column_titles=people_figures.TITLES,
    row_titles=[f'{s["model"]}\nfrom {s["azimuth"]:g}°' for s in shown],
  )
  caption = (
    f'Test models and views drawn at random, not chosen: seed {f.figure_seed}. Degrees are'
    ' counted from the camera of the input. Flow: the colour code of the place in the input.'
    ' Weight: of the sampled colour (yellow) and the regressed one (blue), as estimated.'
  )
  image = figures.stack([image, figures.draw_text(caption, image.shape[1])])
  with atomic_write(path) as temporary:
    Image.fromarray(image).save(temporary)
  return {'figure_seed': f.figure_seed, 'seed': f.seeds[0], 'shown': shown}


if __name__ == '__main__':
  environment.prepare()
  define_flags(flags.FLAGS)
  errors.run(main)
