"""One model -> one record; many models -> a data set, with an Executor.

The Executor is the only place where work becomes parallel: anything with the interface of
`concurrent.futures.Executor` works. Jobs and outcomes can be pickled. A worker writes its own
record into the data set, and the record depends on the job alone, not on the other workers.
"""

import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import (
  FIRST_COMPLETED,
  CancelledError,
  Executor,
  Future,
  wait,
)
from concurrent.futures import process as process_pool
from typing import NamedTuple

import numpy as np

from cvn import dataset as dataset_lib
from cvn.camera import AZIMUTHS, IMAGE_SIZE, camera_at
from cvn.dataset import Facts, Record
from cvn.errors import UserError
from cvn.grid import GRID_SIZE
from datagen import sources
from datagen.geometry import mesh as mesh_lib
from datagen.geometry.coincident import without_coincident
from datagen.geometry.flow import SIMILARITY, TOLERANCE, FlowStats, target_flows
from datagen.geometry.render import render
from datagen.geometry.voxelize import voxelize
from datagen.limits import call_within
from datagen.placement import stand_up
from datagen.quality.examine import flow_stats
from datagen.quality.facts import facts_of
from datagen.sources import SourceModel


class Settings(NamedTuple):
  """How records are made: these and the model decide every byte."""

  azimuths: tuple[float, ...] = AZIMUTHS  # degrees
  image_size: int = IMAGE_SIZE  # pixels
  grid_size: int = GRID_SIZE  # voxels
  shading: str = 'flat'  # one of datagen.geometry.render.SHADINGS
  tolerance: float = TOLERANCE  # of datagen.geometry.flow, voxels
  similarity: float = SIMILARITY  # of datagen.geometry.flow, RGB distance


SETTINGS = Settings()
NO_MEMORY = 'it needs more memory than a worker may have'


class Job(NamedTuple):
  """A model to make."""

  root: str  # of the data set
  row: int
  model: SourceModel
  source: str  # a key of datagen.sources.SOURCES
  settings: Settings
  timeout: float  # seconds after which it is given up


class Outcome(NamedTuple):
  """The result of a job."""

  row: int
  seconds: float
  stats: FlowStats | None  # None when it failed
  reason: str  # '' when it did not
  facts: Facts | None = None  # of its mesh


def make_record(
  mesh: mesh_lib.TexturedMesh, settings: Settings = SETTINGS
) -> tuple[Record, FlowStats]:
  """Turns a coloured mesh of any size into voxels, views and target flows.

  Raises:
    UserError: the mesh is unusable: no faces, not finite, no extent, or invisible in a view.
  """
  s = settings
  mesh_lib.check(mesh)
  mesh = without_coincident(mesh_lib.normalize(mesh))
  cameras = [camera_at(a, image_size=s.image_size) for a in s.azimuths]
  flat, depths, seen = render(mesh, cameras, image_size=s.image_size)
  for azimuth, depth in zip(s.azimuths, depths, strict=True):
    if not np.isfinite(depth).any():
      raise UserError(f'the mesh is too thin to be seen from azimuth {azimuth}')
  voxels = voxelize(mesh, s.grid_size, seen)
  flow, visible, stats = target_flows(
    voxels.point,
    voxels.color,
    flat,
    depths,
    cameras,
    grid_size=s.grid_size,
    tolerance=s.tolerance,
    similarity=s.similarity,
  )
  # Flows are matched by albedo under any light: light has no part in which point is which.
  lit = s.shading != 'flat'
  views = render(mesh, cameras, image_size=s.image_size, shading=s.shading).rgba if lit else flat
  return Record(views, voxels.index, voxels.color, visible, flow, facts_of(mesh)), stats


def run_job(job: Job) -> Outcome:
  """Makes one model within its time limit and writes its record.

  Any problem of the model becomes the reason in its outcome.

  Raises:
    UserError: the data set cannot be written, which would affect all other models too.
  """
  start = time.perf_counter()
  stats, facts, reason = None, None, ''
  try:
    arrays = dataset_lib.open_arrays(job.root)
    try:
      record, made = call_within(job.timeout, _make, job)
      dataset_lib.check_size(arrays, record)
    except UserError as e:
      reason = str(e)
    else:
      dataset_lib.write_record(arrays, job.row, record)
      stats, facts = made, record.facts
  except UserError:
    raise
  except MemoryError:
    reason = NO_MEMORY
  except Exception as e:  # one file that some library chokes on must not stop the run
    reason = f'{type(e).__name__}: {e}'
  return Outcome(job.row, time.perf_counter() - start, stats, ' '.join(reason.split()), facts)


def _make(job: Job) -> tuple[Record, FlowStats]:
  source = sources.source(job.source)
  if hasattr(source, 'read_record'):  # it holds records, not meshes
    record = source.read_record(
      job.model,
      azimuths=job.settings.azimuths,
      image_size=job.settings.image_size,
      grid_size=job.settings.grid_size,
    )
    return record, flow_stats(record, job.settings.similarity)
  mesh = stand_up(source.load(job.model), job.model.up, job.model.turn)
  return make_record(mesh, job.settings)


def run_jobs(
  jobs: Sequence[Job],
  make_executor: Callable[[int], Executor],
  workers: int,
  *,
  in_hand: int | None = None,
) -> Iterator[Outcome]:
  """Runs jobs and yields each outcome when it is ready.

  When a worker dies (a crash in native code), a pool of local processes loses all its jobs in
  progress. These jobs are run again one by one, each in a pool of its own; the job whose pool
  breaks again is the one that failed. Dask gives the job of a dead worker to another worker, and
  fails it only after several deaths.

  A worker that ran out of memory may keep most of it, because freed memory returns to the system
  only if nothing above it is in use. Models that would fit then fail in it, for any reason. So such
  a pool gets no more jobs, and what fails in it from then on is run again in the same way.

  Args:
    jobs: the jobs.
    make_executor: makes an executor with the given number of workers.
    workers: number of workers.
    in_hand: number of jobs given to the executor at a time; None for twice the workers.

  Raises:
    UserError: the data set cannot be written, or the executor is lost with all its workers.
  """
  waiting, suspects = deque(jobs), deque()
  while waiting:
    executor = make_executor(workers)
    running: dict[Future, Job] = {}
    try:
      while waiting or running:
        while waiting and len(running) < (in_hand or 2 * workers) and not suspects:
          job = waiting.popleft()
          try:
            running[executor.submit(run_job, job)] = job
          except process_pool.BrokenProcessPool:
            suspects.append(job)
        if not running:
          break
        # What ran out of memory goes first: what failed after it may be done at the same time.
        done = wait(running, return_when=FIRST_COMPLETED).done
        for future in sorted(done, key=lambda future: not _ran_out_of_memory(future)):
          job = running.pop(future)
          try:
            outcome = future.result()
          except process_pool.BrokenProcessPool:
            suspects.append(job)
          except UserError:
            raise
          except CancelledError as e:
            raise UserError(
              'the scheduler cancelled the work or is gone; repeat the command to continue'
            ) from e
          except Exception as e:
            yield Outcome(job.row, 0.0, None, f'its worker was lost: {" ".join(str(e).split())}')
          else:
            if outcome.reason == NO_MEMORY or (outcome.reason and suspects):
              suspects.append(job)
            else:
              yield outcome
    finally:
      for future in running:
        future.cancel()
      executor.shutdown()
    while suspects:
      yield _run_alone(suspects.popleft(), make_executor)


def _ran_out_of_memory(future):
  if future.cancelled() or future.exception() is not None:
    return False
  return future.result().reason == NO_MEMORY


def _run_alone(job: Job, make_executor: Callable[[int], Executor]) -> Outcome:
  start = time.perf_counter()
  with make_executor(1) as executor:
    try:
      return executor.submit(run_job, job).result()
    except process_pool.BrokenProcessPool:
      return Outcome(job.row, time.perf_counter() - start, None, 'it crashed its worker process')
