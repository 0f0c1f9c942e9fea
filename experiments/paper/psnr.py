r"""Tables 2 and 3 of the paper: surface PSNR in RGB and YCbCr, beside the paper's numbers.

python -m experiments.paper.psnr --data=DIR --workdir=DIR [--models=all] [--epochs=...] [--quick]

Colours are evaluated on the shapes of the network trained with MSFCEL, those of the adapted R2N2 on
its own shapes. The program trains what is missing and reuses what is there; the numbers go to
WORKDIR/tables/psnr.json.
"""

from collections.abc import Sequence

from absl import flags

from experiments.lib import cli, protocol, results, tables
from experiments.lib.protocol import Plan
from experiments.lib.results import AVERAGE, Row
from experiments.lib.scoring import METRICS

FORM = '.2f'
NAMES = (*protocol.PAPER_CATEGORIES, AVERAGE)
OURS = 'blended_0.2'


def _published(*numbers):
  return dict(zip(NAMES, numbers, strict=True))


PUBLISHED = {
  'psnr_rgb': {  # Table 2
    'r2n2': _published(6.502, 6.901, 7.063, 5.668, 6.533),
    'regression': _published(11.005, 17.621, 16.715, 10.598, 13.984),
    'flow': _published(8.820, 17.651, 17.444, 9.825, 13.435),
    'blended_0.2': _published(10.881, 19.728, 18.252, 10.617, 14.870),
    'blended_0.4': _published(10.924, 18.696, 17.965, 10.572, 14.539),
    'blended_0.6': _published(10.914, 18.724, 17.800, 10.543, 14.495),
    'blended_0.8': _published(10.902, 18.175, 17.659, 10.522, 14.314),
    'blended_1': _published(10.892, 18.278, 17.517, 10.507, 14.298),
  },
  'psnr_ycbcr': {  # Table 3
    'r2n2': _published(11.300, 11.342, 11.494, 10.287, 11.106),
    'regression': _published(15.524, 22.262, 21.189, 15.251, 18.557),
    'flow': _published(13.289, 22.305, 21.951, 14.523, 18.017),
    'blended_0.2': _published(15.399, 24.374, 22.750, 15.270, 19.448),
    'blended_0.4': _published(15.448, 23.341, 22.458, 15.218, 19.116),
    'blended_0.6': _published(15.441, 23.357, 22.290, 15.185, 19.068),
    'blended_0.8': _published(15.430, 22.813, 22.146, 15.162, 18.888),
    'blended_1': _published(15.420, 22.904, 22.002, 15.145, 18.868),
  },
}


def define_flags(f: flags.FlagValues) -> None:
  protocol.define_flags(f)
  flags.DEFINE_list(
    'methods',
    [*PUBLISHED['psnr_rgb']],
    'Methods to evaluate; blended_release, blended_mixed and blended_surface are further ones.',
    flag_values=f,
  )


@cli.program(define_flags)
def main(f: flags.FlagValues) -> None:
  make_tables(protocol.read_flags(f), f.methods)


def make_tables(plan: Plan, methods: Sequence[str]) -> None:
  """Evaluates the methods, prints and writes the tables.

  Args:
    plan: how networks are trained and evaluated.
    methods: keys of `protocol.METHODS`.
  """
  found = {m: results.evaluate(plan, m) for m in methods}
  parts = {}
  for metric, published in PUBLISHED.items():
    rows = {
      m: Row(protocol.METHODS[m].title, results.select(r, metric), published.get(m, {}))
      for m, r in found.items()
    }
    if OURS in rows:
      trivial = results.select(found[OURS], metric, who='baselines')
      rows['mean_color'] = Row('Mean training colour, same shapes', trivial, {})
    parts[metric] = results.tabulate(rows, OURS)
    print(f'\n{tables.methods_table(parts[metric], FORM, f"Mean surface {METRICS[metric]}, dB")}')
  results.write(
    plan.workdir, 'psnr', [r for some in found.values() for r in some], {'parts': parts}
  )


if __name__ == '__main__':
  main()
