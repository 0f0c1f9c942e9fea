r"""A report on everything that was run: tables beside the paper's, plots, pictures, 3D models.

python -m experiments.report --workdir=DIR[,DIR...] --output=DIR [--per_category=1 --seed=0]

Collects what the programs of tables and figures left in each --workdir. It trains and measures
nothing; in place of what is missing stands the command that makes it. OUTPUT/report.md is the
report in Markdown with its pictures beside it, OUTPUT/index.html the same as one file that works
offline.

For models that can be turned, random test views (--per_category of each category) are reconstructed
again, if the networks and the data set are still in their places.
"""

import os

from absl import flags

from cvn.files import atomic_write
from experiments.lib import cli, page
from experiments.report import sections
from experiments.report.read import read_workdirs


def define_flags(f: flags.FlagValues) -> None:
  own = {'flag_values': f}
  flags.DEFINE_list('workdir', None, 'Folders of trainings and results, in order.', **own)
  flags.DEFINE_string('output', None, 'Folder for the report.', **own)
  flags.DEFINE_integer(
    'per_category', 1, 'Test models to turn for each category; 0 for none.', 0, **own
  )
  flags.DEFINE_integer('seed', 0, 'Seed of the choice of these models and their views.', 0, **own)
  flags.mark_flags_as_required(['workdir', 'output'], f)


@cli.program(define_flags)
def main(f: flags.FlagValues) -> None:
  blocks = sections.make_report(read_workdirs(f.workdir), per_category=f.per_category, seed=f.seed)
  write(blocks, f.output)
  path = os.path.join(f.output, 'index.html')
  print(f'{path} ({os.path.getsize(path) / 1e6:.1f} MB), {os.path.join(f.output, "report.md")}')


def write(blocks: list[page.Block], folder: str) -> None:
  """Writes a report as Markdown with its pictures, and as HTML."""
  files = {
    **page.pictures(blocks),
    'report.md': page.to_markdown(blocks).encode(),
    'index.html': page.to_html(blocks).encode(),
  }
  for name, content in files.items():
    with atomic_write(os.path.join(folder, name)) as temporary, open(temporary, 'wb') as out:
      out.write(content)


if __name__ == '__main__':
  main()
