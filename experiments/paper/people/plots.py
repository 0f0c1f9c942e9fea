"""The figures of experiments.paper.people: plots with confidence bands, pictures of results."""

from collections.abc import Mapping, Sequence

import matplotlib.figure
import numpy as np

from cvn import figures, infer
from cvn.evaluation.intervals import Estimate
from cvn.files import atomic_write
from cvn.infer import Reconstruction
from experiments.lib import pictures
from experiments.lib.picks import Pick
from experiments.lib.pictures import Shown
from experiments.paper.people.analysis import Group

COLOR, DPI = '#1f5fa8', 110
BOTH_SIDES = (pictures.SIDE, pictures.SIDE + 180)  # degrees from the input's camera
RESULT_TURNS = (BOTH_SIDES[0], 120, BOTH_SIDES[1], 300)
TITLES = (
  'input',
  'flow',
  'from behind',
  'weight',
  'from behind',
  *(f'result\n+{a}°' for a in RESULT_TURNS),
  *(f'truth\n+{a}°' for a in BOTH_SIDES),
)


def plot_azimuths(path: str, title: str, by_azimuth: Mapping[float, Estimate]) -> None:
  """Mean IoU by azimuth with its band, as a line and as a polar plot."""
  degrees = np.array([*by_azimuth, 360 + min(by_azimuth)])  # closed
  value, low, high = np.array([*by_azimuth.values(), by_azimuth[min(by_azimuth)]]).T
  figure = matplotlib.figure.Figure(figsize=(10, 4.2), dpi=DPI, layout='constrained')
  figure.suptitle(title, fontsize=10)
  line = figure.add_subplot(1, 2, 1)
  line.set(xlabel='azimuth of the view', ylabel='mean IoU and 95 % band', xticks=range(0, 361, 45))
  line.set_xticklabels([_name(a) for a in range(0, 361, 45)], fontsize=8)
  line.grid(alpha=0.3)
  around = figure.add_subplot(1, 2, 2, projection='polar')
  around.set_theta_zero_location('S')  # the front, towards the reader
  around.set_xticks(np.deg2rad(range(0, 360, 30)))
  around.set_xticklabels([_name(a) for a in range(0, 360, 30)], fontsize=8)
  around.set_rlabel_position(15)
  around.tick_params('y', labelsize=7)
  for axes, angle in ((line, degrees), (around, np.deg2rad(degrees))):
    axes.plot(angle, value, '.-', color=COLOR)
    axes.fill_between(angle, low, high, color=COLOR, alpha=0.2, linewidth=0)
  around.set_ylim(0)
  _save(figure, path)


def plot_complexity(
  path: str, title: str, groups: Sequence[Group], tested: np.ndarray, whole: np.ndarray
) -> None:
  """Mean IoU by colour complexity with its band, above a histogram of complexities.

  Args:
    path: of the file.
    title: of the figure.
    groups: of the test views.
    tested: complexities of the test views, any shape.
    whole: complexities of all views of the data set.
  """
  figure = matplotlib.figure.Figure(figsize=(6.4, 5.2), dpi=DPI, layout='constrained')
  figure.suptitle(title, fontsize=10)
  upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
  middle = np.array([tested[(tested >= g.lowest) & (tested <= g.highest)].mean() for g in groups])
  value, low, high = np.array([g.iou for g in groups]).T
  reach = np.array([(m - g.lowest, g.highest - m) for m, g in zip(middle, groups, strict=True)]).T
  upper.errorbar(middle, value, xerr=reach, fmt='o-', color=COLOR, linewidth=1.2, elinewidth=0.7)
  upper.fill_between(middle, low, high, color=COLOR, alpha=0.2, linewidth=0)
  upper.set(ylabel='mean IoU and 95 % band')
  upper.grid(alpha=0.3)
  edges = np.arange(whole.min(), whole.max() + 2) - 0.5
  for counts, name, style in (
    (whole, 'all views', {'color': '0.8'}),
    (tested, 'test views', {'color': COLOR, 'histtype': 'step'}),
  ):
    weights = np.full(counts.size, 1 / counts.size)
    lower.hist(counts.ravel(), edges, weights=weights, label=f'{name} ({counts.size})', **style)
  lower.set(xlabel='colour complexity of the input view', ylabel='share of views')
  lower.legend(frameon=False)
  _save(figure, path)


def draw_result(shown: Shown, pick: Pick, one: Reconstruction, *, tile: int) -> list[np.ndarray]:
  """The pictures of a view's reconstruction in the order of `TITLES`.

  Args:
    shown: the view and the true model.
    pick: the model and the view.
    one: the reconstruction of this view, numpy.
    tile: size of each picture in pixels.
  """

  def draw(drawn, turns):
    return [pictures.draw(drawn, pick, tile=tile, turn=t - pictures.SIDE) for t in turns]

  voxels = infer.to_voxels(one)
  codes = figures.flow_color_code(one.flow), figures.weight_color_code(one.weight)
  return [
    figures.enlarge(shown.view, tile),
    *(x for c in codes for x in draw(voxels._replace(color=c), BOTH_SIDES)),
    *draw(voxels, RESULT_TURNS),
    *draw(shown.true, BOTH_SIDES),
  ]


def _name(azimuth):
  known = {0: 'front', 90: 'side', 180: 'back', 270: 'side', 360: 'front'}
  return f'{azimuth}°' + (f'\n{known[azimuth]}' if azimuth in known else '')


def _save(figure, path):
  with atomic_write(path) as temporary:
    figure.savefig(temporary, format='png')
