r"""Results for random test models and views.

python -m experiments.paper.figures.random --data=DIR --workdir=DIR [--figure_seed=0]
  [--per_category=2] [--methods=r2n2,regression,flow,blended_0.2] [--models=all]
  [--epochs=...] [--quick]

Each row shows a model: the input, each method's result and the truth, from beside the input's
camera and from the opposite side. The program trains what is missing and reuses what is there; the
figure goes to WORKDIR/figures/random.png.
"""

from absl import flags

from experiments.lib import cli, pictures, protocol


def define_flags(f: flags.FlagValues) -> None:
  pictures.define_flags(f, 'random')
  pictures.define_choice_flags(f, per_category=2)
  known = ', '.join(pictures.COLORED)
  default = ['r2n2', 'regression', 'flow', 'blended_0.2']
  flags.DEFINE_list('methods', default, f'Methods to show, of {known}.', flag_values=f)
  flags.register_validator(
    'methods', lambda v: v and set(v) <= {*pictures.COLORED}, f'must be of {known}', f
  )


@cli.program(define_flags)
def main(f: flags.FlagValues) -> None:
  chosen = {'seed': f.figure_seed, 'per_category': f.per_category}
  pictures.make_random(protocol.read_flags(f), f.methods, name=f.name, tile=f.tile, **chosen)


if __name__ == '__main__':
  main()
