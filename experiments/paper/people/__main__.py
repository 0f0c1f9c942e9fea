r"""Articulated objects: IoU of people by azimuth and by colour complexity, and pictures of some.

python -m experiments.paper.people --data=DIR --workdir=DIR [--category=human] [--seeds=0,1,2]
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
from collections.abc import Sequence

import numpy as np
from absl import flags
from tqdm import tqdm

from cvn import data, environment, errors, figures
from cvn.dataset import SPLITS, Dataset, open_dataset, read_record
from cvn.errors import UserError
from cvn.evaluation import complexity
from experiments.lib import picks, pictures, protocol, runs, scoring, tables
from experiments.lib.picks import Pick
from experiments.lib.protocol import Plan, Predictor
from experiments.lib.runs import Run
from experiments.lib.tables import Result
from experiments.paper.people import analysis, plots, summary
from experiments.paper.people.analysis import Colors
from experiments.paper.people.summary import Study

DEFAULT_CATEGORY = 'human'
METHOD = 'blended_0.2'
TILE = 128  # pixels of each small picture
CAPTION = (
  'Degrees are counted from the camera of the input. Flow: the colour code of the place in the'
  ' input. Weight: of the sampled colour (yellow) and the regressed one (blue), as estimated.'
)
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
  plan = protocol.read_flags(f)
  dataset = open_dataset(plan.data)
  analysis.check_azimuths(dataset.manifest.azimuths)
  category = plan.categories[0] if plan.categories else DEFAULT_CATEGORY
  # A wrong --t1 is found before the training.
  ids, colors = read_colors(dataset, category, t1=f.t1, clusters=f.clusters, t2=f.t2)
  results = evaluate(plan, category)
  study = examine(dataset, category, results, ids, colors)
  print('\n' + summary.to_markdown(study))
  stem = os.path.join(plan.workdir, 'figures', 'people')
  title = f'{len(study.models)} test models ({category})\n' + study.networks[0]
  plots.plot_azimuths(f'{stem}_azimuth.png', title, study.analysis.by_azimuth)
  plots.plot_complexity(
    f'{stem}_complexity.png', title, study.analysis.by_complexity, study.tested, colors.complexity
  )
  rows = data.select_rows(dataset, 'test', categories=[category], sources=plan.sources)
  rng = np.random.default_rng(f.figure_seed)
  rows = rng.permutation(rows)[: f.people]
  views = rng.integers(len(dataset.manifest.azimuths), size=len(rows))
  shown = [picks.of(dataset, *x) for x in zip(rows, views, strict=True)]
  predict = protocol.make_predictor(plan, METHOD, scope_of(plan, category), plan.seeds[0])
  facts = {'figure_seed': f.figure_seed, 'rows': [picks.to_json(p) for p in shown]}
  caption = f'{pictures.say_choice(f.figure_seed)} {CAPTION}'
  pictures.write(f'{stem}_results', draw_results(dataset, shown, predict), caption, facts)
  print('\n' + '\n'.join(f'{stem}_{k}.png' for k in FIGURES))
  tables.finish(plan.workdir, 'people', summary.to_json(study), results)


def scope_of(plan: Plan, category: str) -> str:
  """What the networks for a category are trained on."""
  return protocol.ALL if plan.models == protocol.ALL else category


def evaluate(plan: Plan, category: str) -> list[Result]:
  """The evaluations of the method, one for each seed."""
  scope = scope_of(plan, category)
  return [Result([category], protocol.evaluate(plan, METHOD, scope, s)) for s in plan.seeds]


def read_colors(
  dataset: Dataset, category: str, *, t1: int, clusters: int, t2: int
) -> tuple[list[str], Colors]:
  """The ids of all finished models of the category, and their views' colours.

  Args:
    dataset: the open data set.
    category: of the models.
    t1, clusters, t2: as of cvn.evaluation.complexity.

  Raises:
    UserError: there is none, or no colour has t1 pixels.
  """
  rows = np.concatenate([data.select_rows(dataset, s, categories=[category]) for s in SPLITS])
  if len(rows) == 0:
    raise UserError(f'{dataset.root} has no finished {category} (make some: datagen.generate)')
  palettes = [
    [complexity.find_palette(view) for view in read_record(dataset, row).views]
    for row in tqdm(rows, desc='colours', unit='model', disable=None)
  ]
  colors = analysis.measure_colors(palettes, t1=t1, clusters=clusters, t2=t2)
  return [dataset.manifest.models[row].id for row in rows], colors


def examine(
  dataset: Dataset,
  category: str,
  results: Sequence[Result],
  ids: Sequence[str],
  colors: Colors,
) -> Study:
  """How well the category's test models are reconstructed, in the mean of the seeds, and why.

  Args:
    dataset: the open data set.
    category: of the models.
    results: evaluations, one for each seed.
    ids: of all models of the category.
    colors: likewise.

  Raises:
    UserError: none of them is for testing.
  """
  reports = [r.report for r in results]
  models = reports[0]['networks']['by_model']
  names = [name for name, model in models.items() if model['category'] == category]
  if not names:
    raise UserError(f'{dataset.root} has no finished {category} in the split test')

  def mean_of_seeds(who, metric):
    found = [[r[who]['by_model'][name][metric] for name in names] for r in reports]
    return np.mean(np.array(found, float), axis=0)

  scores = {metric: mean_of_seeds('networks', metric) for metric in scoring.METRICS}
  tested = colors.complexity[[ids.index(name) for name in names]]
  return Study(
    category,
    [describe_network(run) for report in reports for run in runs.of_report(report)],
    [r['threshold'] for r in reports],
    names,
    scores,
    mean_of_seeds('baselines', 'iou'),
    colors,
    tested,
    analysis.analyze(dataset.manifest.azimuths, scores['iou'], tested),
  )


def describe_network(run: Run) -> str:
  """A network and the length of its training, for people."""
  models, batch = run.config['models'], run.config['batch_size']
  return (
    f'{os.path.basename(run.workdir)}: {runs.epochs_of(run):.3g} epochs of {models} models,'
    f' {run.step} steps of {batch}'
  )


def draw_results(dataset: Dataset, shown: Sequence[Pick], predict: Predictor) -> np.ndarray:
  """Reconstructions of some test models, a row each."""
  size = dataset.manifest.grid_size
  rows = []
  for pick in tqdm(shown, desc='draw', unit='model', disable=None):
    record = read_record(dataset, pick.row)
    view = record.views[pick.view]
    (found,) = predict(view[None])
    true = scoring.to_voxels(record, size)
    rows.append(plots.draw_result(view, pick.azimuth, found, true, size=TILE))
  return figures.grid_of_images(
    rows,
    column_titles=plots.TITLES,
    row_titles=[f'{p.model.id}\nfrom {p.azimuth:g}°' for p in shown],
  )


if __name__ == '__main__':
  environment.prepare()
  define_flags(flags.FLAGS)
  errors.run(main)
