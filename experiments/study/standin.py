r"""An automatic stand-in for the user study: no person is asked.

python -m experiments.study.standin --data=DIR --workdir=DIR [--ours=blended_0.2]
  [--against=regression,flow] [--shapes=5] [--study_seed=0] [--output=DIR] [...]

The shapes, views and results are those of experiments.study with the same flags. Each result
is drawn as the data set's views see it, from every azimuth, and compared with drawings of the true
coloured voxels by SSIM and PSNR (scikit-image). Of two methods the one whose mean over the azimuths
is higher "wins" the shape. That says which result is closer to the truth, not which one people
like. A large --shapes judges all test models.

Writes standin.png and standin.json to --output, user_study in --workdir by default.
"""

import os
from collections.abc import Sequence

import numpy as np
from absl import flags
from skimage import metrics
from tqdm import tqdm

from cvn import environment, errors, figures
from cvn.dataset import open_dataset
from cvn.grid import ColoredVoxels
from experiments.lib import picks, protocol
from experiments.lib.picks import Pick
from experiments.lib.protocol import Plan
from experiments.lib.scoring import PSNR_CEILING, to_voxels
from experiments.study import preferences, shapes

LABEL = 'automatic stand-in, no person was asked'
MEASURES = {'ssim': 'SSIM', 'psnr': 'PSNR'}
GREY = (245, 245, 245)  # behind the object, as in the views


def define_flags(f: flags.FlagValues) -> None:
  """The program's flags. Not at import: there the names of several programs would collide."""
  protocol.define_flags(f)
  shapes.define_flags(f)
  flags.DEFINE_string(
    'output', None, 'A folder; user_study in --workdir by default.', flag_values=f
  )


def main(_) -> int:
  return run(flags.FLAGS)


def run(f: flags.FlagValues) -> int:
  """Compares and draws as the flags say; returns the exit status."""
  plan = protocol.read_flags(f)
  shown = shapes.choose(plan, shapes=f.shapes, seed=f.study_seed)
  output = f.output or os.path.join(plan.workdir, 'user_study')
  make_report(plan, shown, f.ours, f.against, seed=f.study_seed, output=output)
  return 0


def make_report(
  plan: Plan, shown: Sequence[Pick], ours: str, against: Sequence[str], *, seed: int, output: str
) -> None:
  """Reconstructs, compares, prints and writes.

  Args:
    plan: how networks are trained.
    shown: the test models and their views.
    ours: the method that is compared.
    against: the methods it is compared with.
    seed: with which the models were chosen.
    output: the folder.
  """
  manifest = open_dataset(plan.data).manifest
  print(f'{shapes.describe(shown)}; seed {seed}')
  options = {'azimuths': manifest.azimuths, 'size': manifest.image_size}
  compared: list[tuple[Pick, dict[str, dict[str, float]]]] = []
  progress = tqdm(shown, desc='compare', unit='shape', disable=None)
  for results in shapes.reconstruct(plan, shown, [ours, *against]):
    truth = to_voxels(results.record, manifest.grid_size)
    compared.append((results.pick, compare(results.voxels, truth, **options)))
    progress.update()
  progress.close()
  titles = {m: protocol.METHODS[m].title for m in (ours, *against)}
  tables = {
    measure: preferences.tabulate(
      [
        preferences.Choice(pick.model.category, other, s[ours][measure] > s[other][measure])
        for pick, s in compared
        for other in against
        if s[ours][measure] != s[other][measure]  # of two alike none is closer
      ],
      against,
      picks.categories_of(shown),
    )
    for measure in MEASURES
  }
  print(f'{LABEL}: closer to the truth, in drawings from {len(manifest.azimuths)} azimuths')
  for measure, title in MEASURES.items():
    heading = f'\n{titles[ours]} closer by {title}'
    print(preferences.format_table(tables[measure], titles, heading))
  means = {m: {k: float(np.mean([s[m][k] for _, s in compared])) for k in MEASURES} for m in titles}
  print()
  for method, mean in means.items():
    print(f'{titles[method]:<28}mean SSIM {mean["ssim"]:.4f}  mean PSNR {mean["psnr"]:.2f} dB')
  report = {
    'what': LABEL,
    'study_seed': seed,
    'ours': ours,
    'titles': titles,
    'closer': {k: preferences.to_json(t) for k, t in tables.items()},
    'means': means,
    'shapes': [{**picks.to_json(p), 'scores': s} for p, s in compared],
  }
  report |= shapes.describe_networks(plan, shown, [ours, *against])
  panels = {
    f'Automatic stand-in: closer to the truth by {title}': tables[k]
    for k, title in MEASURES.items()
  }
  note = f'{LABEL.capitalize()}. {len(shown)} shapes; whiskers: 95 % (Wilson)'
  chart = preferences.draw(panels, titles, ours, note=note, axis='closer, % of shapes')
  preferences.write(output, 'standin', report, chart)


def compare(
  results: dict[str, ColoredVoxels],
  truth: ColoredVoxels,
  *,
  azimuths: Sequence[float],
  size: int,
) -> dict[str, dict[str, float]]:
  """How like the truth each result looks, in the mean over azimuths.

  Args:
    results: by method.
    truth: the true coloured voxels.
    azimuths: degrees.
    size: of the drawings, pixels.

  Returns:
    {method: {'ssim': in [-1, 1], 'psnr': dB, of no azimuth more than 58.9}}.
  """

  def draw(voxels):
    return [
      figures.draw_voxels(voxels, a, elevation=0, size=size, background=GREY) for a in azimuths
    ]

  true = draw(truth)
  return {
    method: {
      'ssim': float(np.mean([_ssim(*p) for p in pairs])),
      'psnr': float(np.mean([_psnr(*p) for p in pairs])),
    }
    for method, pairs in ((m, [*zip(true, draw(v), strict=True)]) for m, v in results.items())
  }


def _ssim(true, image) -> float:
  """As in Wang et al. 2004: Gaussian windows."""
  return metrics.structural_similarity(
    true,
    image,
    data_range=255,
    channel_axis=-1,
    gaussian_weights=True,
    sigma=1.5,
    use_sample_covariance=False,
  )


def _psnr(true, image) -> float:
  with np.errstate(divide='ignore'):  # of equal pictures
    return min(metrics.peak_signal_noise_ratio(true, image, data_range=255), PSNR_CEILING)


if __name__ == '__main__':
  environment.prepare()
  define_flags(flags.FLAGS)
  errors.run(main)
