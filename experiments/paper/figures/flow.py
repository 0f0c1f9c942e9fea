r"""The paper's Figure "flow_field": the flow of a symmetric object seen from a side.

python -m experiments.paper.figures.flow --data=DIR --workdir=DIR [--category=chair] [--models=all]
  [--epochs=...] [--quick]

The figure shows the colour code and, on the true surface, the target flow and the estimated flow
with the colours that they fetch: from the side that the input shows and, mirrored, from the hidden
side. Both sides look the same where hidden voxels take the colours of their visible counterparts.
The object is the test model whose voxels agree best with their mirror image in x (IoU, to a
percent); among equals, the one with the most hidden voxels that have a visible counterpart. The
program prints the distance between the flows of those pairs. It trains what is missing and reuses
what is there; the figure goes to WORKDIR/figures/flow.png.
"""

from collections.abc import Iterable, Mapping

import numpy as np
from absl import flags
from tqdm import tqdm

from cvn import data, figures, infer, metrics, sampler
from cvn.dataset import Dataset, Record, open_dataset, read_record
from cvn.errors import UserError
from cvn.grid import ColoredVoxels
from cvn.infer import Network
from experiments.lib import cli, picks, pictures, protocol, scoring
from experiments.lib.picks import Pick
from experiments.lib.protocol import Plan

METHOD, TRAINING = 'blended_0.2', 'blended'
VIEW = 90  # degrees: the input is the view nearest to this azimuth


def define_flags(f: flags.FlagValues) -> None:
  pictures.define_flags(f, 'flow')


@cli.program(define_flags)
def main(f: flags.FlagValues) -> None:
  make_figure(protocol.read_flags(f), name=f.name, tile=f.tile)


def make_figure(plan: Plan, *, name: str, tile: int) -> None:
  """Chooses the object, draws, prints and writes.

  Args:
    plan: how networks are trained.
    name: of the files.
    tile: size of each small picture in pixels.

  Raises:
    UserError: there is no finished test model.
  """
  dataset = open_dataset(plan.data)
  size = dataset.manifest.grid_size
  rows = data.select_rows(
    dataset, 'test', categories=protocol.categories(plan), sources=plan.sources
  )
  if len(rows) == 0:
    raise UserError(f'{plan.data} has no finished model in the split test')
  view = int(np.argmin([abs(a - VIEW) for a in dataset.manifest.azimuths]))
  row, symmetry = choose(dataset, rows, view)
  pick = picks.of(dataset, row, view)
  record = read_record(dataset, row)
  found = pictures.find_runs(plan, [pick], (METHOD,), trainings=(TRAINING,))
  network = scoring.load(found[pick.model.category][TRAINING].workdir, ['color'], dataset)
  flows = {'target': record.flow[view], 'estimated': estimate(network, record, view)}
  hidden, counterpart = find_pairs(record, view, size).T
  pixels = dataset.manifest.image_size
  gaps = {k: pixels * distance(x[hidden], x[counterpart]) for k, x in flows.items()}
  off = pixels * distance(flows['estimated'], flows['target'])
  caption = (
    f'{pick.model.category} {pick.model.id}, IoU with its mirror image {symmetry:.3f}.'
    f' Median distances in pixels: between the flows of {len(hidden)} hidden voxels and of their'
    f' visible counterparts {gaps["target"]:.1f} (target) and {gaps["estimated"]:.1f} (estimated),'
    f' from the estimated flow to the target {off:.1f}. {pictures.say_training(found)}'
  )
  print(caption)
  facts = {'mirror_iou': symmetry, 'hidden_voxels': len(hidden)}
  facts |= {'pixels_to_counterpart': gaps, 'pixels_to_target': off}
  image = draw(pick, record, flows, grid_size=size, tile=tile)
  pictures.write(plan, name, image, caption, [pick], (METHOD,), found, **facts)


def choose(dataset: Dataset, rows: Iterable[int], view: int) -> tuple[int, float]:
  """The row of the most symmetric model, and its IoU with its mirror image."""
  size = dataset.manifest.grid_size

  def rank(row):
    record = read_record(dataset, row)
    occupancy = scoring.to_voxels(record, size).occupancy
    symmetry = float(metrics.iou(occupancy, occupancy[::-1]))
    return round(symmetry, 2), len(find_pairs(record, view, size)), row, symmetry

  progress = tqdm(rows, desc='symmetry', unit='model', disable=None)
  *_, row, symmetry = max(map(rank, progress), key=lambda found: found[:2])
  return int(row), symmetry


def find_pairs(record: Record, view: int, grid_size: int) -> np.ndarray:
  """Hidden voxels and their visible mirror images: [N, 2] indices into the record's surface."""
  number = np.full((grid_size,) * 3, -1)
  number[tuple(record.surface_index.T)] = np.arange(len(record.surface_index))
  mirrored = number[::-1][tuple(record.surface_index.T)]
  visible = record.visible[view]
  hidden = np.flatnonzero(~visible & (mirrored >= 0) & visible[mirrored])
  return np.stack([hidden, mirrored[hidden]], axis=-1)


def distance(flow: np.ndarray, other: np.ndarray) -> float:
  """The median distance between flows [N, 2]; 0 if there are none."""
  return float(np.median(np.linalg.norm(flow - other, axis=-1))) if len(flow) else 0.0


def estimate(network: Network, record: Record, view: int) -> np.ndarray:
  """The network's flow at the true surface voxels, [S, 2]."""
  found = infer.reconstruct(record.views[view], color=network)
  return np.asarray(found.flow)[tuple(record.surface_index.T)]


def draw(
  pick: Pick, record: Record, flows: Mapping[str, np.ndarray], *, grid_size: int, tile: int
) -> np.ndarray:
  """The figure: colour code and input, flows [S, 2] and the colours they fetch, from both sides."""
  view = record.views[pick.view]
  image = view[None, ..., :3].astype(np.float32) / 255
  foreground = view[None, ..., 3] >= 128
  shape = scoring.to_voxels(record, grid_size)
  seen = pick.azimuth - pictures.SIDE
  sides = {'seen side': seen, 'hidden side': -seen}  # x mirrored

  def tiles(color):
    volume = np.zeros_like(shape.color)
    volume[tuple(record.surface_index.T)] = color
    voxels = ColoredVoxels(shape.occupancy, volume)
    return [figures.draw_voxels(voxels, a, size=tile) for a in sides.values()]

  code = pictures.draw_flow_code(tile)
  upper, lower = [code], [figures.enlarge(view, tile)]
  titles = ['(a) colour code,\n(b) input']
  for name, flow in flows.items():
    fetched = np.asarray(sampler.nearest_foreground(image, flow[None], foreground))[0]
    upper += tiles(figures.flow_color_code(flow))
    lower += tiles(fetched)
    titles += [f'{name} flow\n{side}' for side in sides]
  return figures.grid_of_images(
    [upper, lower], column_titles=titles, row_titles=['flow', 'colours\nfetched']
  )


if __name__ == '__main__':
  main()
