r"""Articulated objects: IoU of people by azimuth and by colour complexity, and pictures of results.

python -m experiments.paper.people --data=DIR --workdir=DIR [--category=human] [--seeds=0,1,2]
  [--epochs=...] [--t1=50 --clusters=128 --t2=5] [--people=4 --figure_seed=0] [--quick]

The paper's sections "Evaluation on Articulated Objects" and "Further Analysis". The program trains
what is missing and reuses what is there. It prints Markdown tables, and writes
WORKDIR/tables/people.json and WORKDIR/figures/people_{azimuth,complexity,results}.png.

Intervals cover 95 % of the means of resampled models (bootstrap); with several seeds a model's IoU
is its mean over them. Colour complexity is defined as in the paper, on the foreground of all
finished models of the category in all splits: colours with at least --t1 pixels are clustered by
K-means, each colour counting once; the complexity of a view is the number of clusters with more
than --t2 of its pixels.
"""

import os
from collections.abc import Mapping, Sequence

import numpy as np
from absl import flags
from tqdm import tqdm

from cvn import data
from cvn.dataset import SPLITS, Dataset, open_dataset, read_record
from cvn.errors import UserError
from cvn.evaluation import complexity
from experiments.lib import cli, picks, pictures, protocol, results, runs, scoring
from experiments.lib.picks import Pick
from experiments.lib.protocol import Plan, Predictor
from experiments.lib.results import Result
from experiments.lib.runs import Run
from experiments.paper.people import analysis, plots, summary
from experiments.paper.people.analysis import Colors
from experiments.paper.people.summary import Study

DEFAULT_CATEGORY = 'human'
METHOD = 'blended_0.2'
TILE = 128  # size of each small picture in pixels
CAPTION = (
  'Angles are relative to the camera of the input. Flow: colour code of the place in the input.'
  ' Weight: of the sampled colour (yellow) and the regressed colour (blue), as estimated.'
)
FIGURES = ('azimuth', 'complexity', 'results')


def define_flags(f: flags.FlagValues) -> None:
  own = {'flag_values': f}
  protocol.define_flags(f)
  flags.DEFINE_integer(
    't1', complexity.T1, 'Minimum number of pixels of a colour to be clustered.', 1, **own
  )
  flags.DEFINE_integer('clusters', complexity.CLUSTERS, 'Number K of colour clusters.', 1, **own)
  flags.DEFINE_integer(
    't2', complexity.T2, 'A cluster counts in a view if it has more pixels than this.', 0, **own
  )
  flags.DEFINE_integer('people', 4, 'Test models in the picture of results.', 1, **own)
  flags.DEFINE_integer('figure_seed', 0, 'Seed of the choice of these models and views.', 0, **own)
  flags.register_validator('seeds', bool, 'must name at least one', f)
  flags.register_validator('category', lambda c: len(c) < 2, 'must be one', f)


@cli.program(define_flags)
def main(f: flags.FlagValues) -> None:
  plan = protocol.read_flags(f)
  colors = {'t1': f.t1, 'clusters': f.clusters, 't2': f.t2}
  run(plan, colors, people=f.people, figure_seed=f.figure_seed)


def run(plan: Plan, color_options: Mapping[str, int], *, people: int, figure_seed: int) -> None:
  """Trains and evaluates what is missing; prints, writes and draws the analysis.

  Args:
    plan: how networks are trained, on one category at most.
    color_options: t1, clusters and t2 of cvn.evaluation.complexity.
    people: test models in the picture of results.
    figure_seed: of the choice of these models and views.
  """
  dataset = open_dataset(plan.data)
  analysis.check_azimuths(dataset.manifest.azimuths)
  category = plan.categories[0] if plan.categories else DEFAULT_CATEGORY
  # First, so that a wrong t1 is found before the training.
  ids, colors = read_colors(dataset, category, **color_options)
  evaluations = evaluate(plan, category)
  study = examine(dataset, category, evaluations, ids, colors)
  found = summary.to_json(study)
  print('\n' + summary.to_markdown(found))
  stem = os.path.join(plan.workdir, 'figures', 'people')
  title = f'{len(study.models)} test models ({category})\n' + study.networks[0]
  plots.plot_azimuths(f'{stem}_azimuth.png', title, study.analysis.by_azimuth)
  plots.plot_complexity(
    f'{stem}_complexity.png', title, study.analysis.by_complexity, study.tested, colors.complexity
  )
  print(f'\n{stem}_azimuth.png\n{stem}_complexity.png')
  options = {'sources': plan.sources, 'per_category': people, 'seed': figure_seed}
  shown = picks.choose(dataset, [category], **options)
  predictors = pictures.find_predictors(plan, [category], METHOD)
  image = draw_results(dataset, shown, predictors[category])
  runs_shown = pictures.find_runs(plan, shown, (METHOD,))
  caption = f'{pictures.say_choice(figure_seed)} {CAPTION}'
  facts = {'figure_seed': figure_seed}
  pictures.write(plan, 'people_results', image, caption, shown, (METHOD,), runs_shown, **facts)
  results.write(plan.workdir, 'people', evaluations, found)


def evaluate(plan: Plan, category: str) -> list[Result]:
  """The evaluations of the method, one for each seed."""
  ((scope, _),) = protocol.trained_for(plan, [category])
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
    raise UserError(f'{dataset.root} has no finished {category}: make some with datagen.generate')
  palettes = [
    [complexity.find_palette(view) for view in read_record(dataset, row).views]
    for row in tqdm(rows, desc='colours', unit='model', disable=None)
  ]
  colors = analysis.measure_colors(palettes, t1=t1, clusters=clusters, t2=t2)
  return [dataset.manifest.models[row].id for row in rows], colors


def examine(
  dataset: Dataset,
  category: str,
  evaluations: Sequence[Result],
  ids: Sequence[str],
  colors: Colors,
) -> Study:
  """Analyses the reconstructions of the category's test models, averaged over seeds.

  Args:
    dataset: the open data set.
    category: of the models.
    evaluations: one for each seed.
    ids: of all models of the category.
    colors: of the same models.

  Raises:
    UserError: the category has no test models.
  """
  reports = [r.report for r in evaluations]
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
  rows = []
  for pick in tqdm(shown, desc='draw', unit='model', disable=None):
    known = pictures.read(dataset, pick)
    (found,) = predict(known.view[None])
    rows.append(plots.draw_result(known, pick, found, tile=TILE))
  return pictures.arrange(rows, plots.TITLES, shown)


if __name__ == '__main__':
  main()
