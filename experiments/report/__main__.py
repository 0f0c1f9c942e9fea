r"""One report of everything that was run: tables beside the paper's, plots, pictures, 3D models.

python -m experiments.report --workdir=DIR[,DIR...] --output=DIR [--per_category=1 --seed=0]

Gathers what the programs of tables and figures left in each --workdir, trains and measures nothing,
and leaves out what is not there, with the command that makes it. OUTPUT/index.html is the report in
one file that needs no network; report.md is the same as Markdown, with its pictures beside it.

Models that can be turned are reconstructed anew from --per_category random test views of each
category, where networks and data set are still in their places.
"""

import os

from absl import flags

from cvn import environment, errors
from cvn.files import atomic_write
from experiments.report import markdown, page, sections
from experiments.report.read import read_workdirs


def define_flags(f: flags.FlagValues) -> None:
  """The program's flags. Not at import: there the names of several programs would collide."""
  own = {'flag_values': f}
  flags.DEFINE_list('workdir', None, 'The folders of trainings and results, in order.', **own)
  flags.DEFINE_string('output', None, 'The folder for the report.', **own)
  flags.DEFINE_integer(
    'per_category', 1, 'Test models to turn, of each category; 0 for none.', 0, **own
  )
  flags.DEFINE_integer('seed', 0, 'Of the choice of these models and of their views.', 0, **own)
  flags.mark_flags_as_required(['workdir', 'output'], f)


def main(_) -> None:
  run(flags.FLAGS)


def run(f: flags.FlagValues) -> None:
  """Writes the report as the flags say."""
  workdirs = read_workdirs(f.workdir)
  report = sections.make_report(workdirs, per_category=f.per_category, seed=f.seed)
  files = {
    **markdown.pictures(report),
    'report.md': markdown.render(report).encode(),
    'index.html': page.render(report).encode(),
  }
  for name, content in files.items():
    with atomic_write(os.path.join(f.output, name)) as temporary, open(temporary, 'wb') as out:
      out.write(content)
  path = os.path.join(f.output, 'index.html')
  print(f'{path} ({os.path.getsize(path) / 1e6:.1f} MB), {os.path.join(f.output, "report.md")}')


if __name__ == '__main__':
  environment.prepare()
  define_flags(flags.FLAGS)
  errors.run(main)
