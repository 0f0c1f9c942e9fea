r"""Speed of data generation: one textured mesh with all its views, voxels and flows.

python -m datagen.benchmark [--faces=20000] [--texture=1024] [--models=5]

Prints the machine, the versions, the seconds for a model in one worker process, its peak memory,
and the share of each part of the work. Workers share nothing, so two on two cores make twice as
many models, as far as memory bandwidth allows.
"""

import cProfile
import functools
import importlib.metadata
import os
import platform
import pstats
import resource
import statistics
import tempfile
import time
from typing import NamedTuple

import numpy as np
from absl import flags

from cvn import dataset as dataset_lib
from cvn import errors
from cvn.camera import AZIMUTHS, IMAGE_SIZE
from cvn.dataset import SURFACE_CAPACITY, Manifest, Model
from cvn.grid import GRID_SIZE
from cvn.ops import compile as compiling
from datagen.executors import process_executor
from datagen.geometry.mesh import TexturedMesh
from datagen.pipeline import make_record

MEMORY = 16 << 30  # bytes a worker may have; the largest meshes need a few of them
# Parts of the work by the functions that do them; Mitsuba's is a part of the views'.
PARTS = {
  'coincident faces': ('coincident.py', 'without_coincident'),
  'views': ('render.py', 'render'),
  'voxels': ('voxelize.py', 'voxelize'),
  'flows': ('flow.py', 'target_flows'),
  'writing': ('dataset.py', 'write_record'),
}
MITSUBA = 'of the views, Mitsuba'
CALLERS = ('to_mitsuba', '_scene', '_sensor')  # of functions that the profile does not see


class Measured(NamedTuple):
  """Timings of the same record, made several times."""

  seconds: tuple[float, ...]  # of each time, by the clock
  processor_seconds: tuple[float, ...]
  parts: dict[str, float]  # processor seconds of each, of one more time
  faces: int
  voxels: int
  peak: int  # bytes, of the whole process


def define_flags(f: flags.FlagValues) -> None:
  """Defines the program's flags. Not at import: the flags of several programs share names."""
  own = {'flag_values': f}
  flags.DEFINE_integer(
    'faces', 20000, 'Approximate number of faces of the mesh.', lower_bound=8, **own
  )
  flags.DEFINE_integer('texture', 1024, 'Side of the texture, pixels.', lower_bound=1, **own)
  flags.DEFINE_integer('models', 5, 'Number of timed models.', lower_bound=1, **own)


def main(_) -> None:
  run(flags.FLAGS)


def run(f: flags.FlagValues) -> None:
  """Measures in a worker process like those of datagen.generate, and prints the result."""
  print(describe_machine())
  with process_executor(1, MEMORY) as executor:
    m = executor.submit(measure, f.faces, f.texture, f.models).result()
  print(
    f'{m.faces} faces, texture {f.texture}, {m.voxels} voxels:'
    f' {statistics.median(m.seconds):.2f} s a model in one worker'
    f' ({min(m.seconds):.2f} to {max(m.seconds):.2f} over {f.models}),'
    f' {statistics.median(m.processor_seconds):.2f} s of its processor;'
    f' peak memory {m.peak / 2**20:.0f} MiB'
  )
  for part, seconds in m.parts.items():
    print(f'{seconds:9.3f} s  {part}')


def describe_machine() -> str:
  """The processor, its number of cores, and the versions of the libraries."""
  versions = ', '.join(
    f'{p} {importlib.metadata.version(p)}' for p in ('mitsuba', 'numpy', 'scipy')
  )
  cores, python = os.cpu_count(), platform.python_version()
  return f'{compiling.processor_name()}, {cores} cores; Python {python}, {versions}'


def measure(faces: int, texture: int, models: int) -> Measured:
  """Makes and writes one record several times.

  Args:
    faces: approximate number of faces of the mesh.
    texture: side of the texture, pixels.
    models: number of timed runs, after one that is not timed.
  """
  mesh = lumpy_ball(faces, texture)
  with tempfile.TemporaryDirectory() as folder:
    manifest = Manifest(
      (Model('ball', 'ball', 'train', 'benchmark'),),
      AZIMUTHS,
      IMAGE_SIZE,
      GRID_SIZE,
      SURFACE_CAPACITY,
      {},
    )
    arrays = dataset_lib.create(folder, manifest).arrays
    make = functools.partial(_make, mesh, arrays)
    make()
    clock, processor_clock = [], []
    for _ in range(models):
      start, processor_start = time.perf_counter(), time.process_time()
      make()
      clock.append(time.perf_counter() - start)
      processor_clock.append(time.process_time() - processor_start)
    profile = cProfile.Profile(time.process_time)
    profile.runcall(make)
    voxels = int(arrays['surface_count'][0].read().result())
  peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
  parts = _parts(profile)
  return Measured(tuple(clock), tuple(processor_clock), parts, len(mesh.faces), voxels, peak)


def _make(mesh, arrays):
  record, _ = make_record(mesh)
  dataset_lib.write_record(arrays, 0, record)


def _parts(profile):
  """Seconds of each of `PARTS`, of Mitsuba's functions, and of everything else."""
  total, of_function, mitsuba = 0.0, {}, 0.0
  for (path, _, name), (_, _, own, cumulative, _) in pstats.Stats(profile).stats.items():
    total += own
    of_function[os.path.basename(path), name] = cumulative
    if f'{os.sep}mitsuba{os.sep}' in path or (path.endswith('render.py') and name in CALLERS):
      mitsuba += own
  parts = {part: of_function[function] for part, function in PARTS.items()}
  rest = total - sum(parts.values())
  return parts | {MITSUBA: mitsuba, 'all the rest': rest}


def lumpy_ball(faces: int, texture: int) -> TexturedMesh:
  """A lumpy ball with a grainy checkerboard of six colours.

  Args:
    faces: approximate number of faces.
    texture: side of the texture, pixels.
  """
  n = max(2, round(np.sqrt(faces / 2)))
  u, v = np.meshgrid(np.linspace(0, 1, n + 1), np.linspace(0, 1, n + 1), indexing='ij')
  around, down = 2 * np.pi * u, np.pi * v
  radius = 1 + 0.3 * np.sin(5 * around) * np.sin(down) ** 2 + 0.2 * np.cos(7 * down)
  direction = [np.sin(down) * np.cos(around), np.cos(down), np.sin(down) * np.sin(around)]
  vertices = (radius * direction).reshape(3, -1).T
  corner = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
  a, b, c, d = (
    x.ravel() for x in (corner[:-1, :-1], corner[:-1, 1:], corner[1:, :-1], corner[1:, 1:])
  )
  triangles = np.concatenate([np.stack([a, b, c], -1), np.stack([b, d, c], -1)])
  uv = np.stack([u, 1 - v], -1).reshape(-1, 2).astype(np.float32)
  rng = np.random.default_rng(0)
  checks = rng.integers(0, 256, (6, 3))[rng.integers(0, 6, (16, 16))]
  at = np.arange(texture) * 16 // texture
  image = np.full((texture, texture, 4), 255, np.uint8)
  image[..., :3] = np.clip(
    checks[at[:, None], at] + rng.normal(0, 8, (texture, texture, 1)), 0, 255
  )
  return TexturedMesh(
    vertices,
    triangles,
    np.ones((len(triangles), 3, 4), np.float32),
    uv[triangles],
    np.zeros(len(triangles), np.int32),
    (image,),
  )


if __name__ == '__main__':
  define_flags(flags.FLAGS)
  errors.run(main)
