"""One model -> one record; many models, over an Executor, -> a data set.

The Executor is the only seam for parallel work: anything with the interface of
`concurrent.futures.Executor` does. Jobs and outcomes pickle; a worker writes its own record into
the data set, and what it writes depends on the job alone, not on the other workers.
"""

import os
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures import process as process_pool
from multiprocessing import get_context, parent_process
from multiprocessing.connection import wait as wait_for_process
from typing import NamedTuple

import drjit
import numpy as np

from cvn import dataset as dataset_lib
from cvn.camera import AZIMUTHS, IMAGE_SIZE, camera_at
from cvn.dataset import Record
from cvn.errors import UserError
from cvn.grid import GRID_SIZE
from datagen import mesh as mesh_lib
from datagen import sources
from datagen.flow import FlowStats, target_flows
from datagen.render import render
from datagen.sources import SourceModel
from datagen.voxelize import voxelize


class Job(NamedTuple):
  """One model to make."""

  root: str  # of the data set
  row: int
  model: SourceModel
  source: str  # a key of datagen.sources.SOURCES
  shading: str


class Outcome(NamedTuple):
  """What became of a job."""

  row: int
  seconds: float
  stats: FlowStats | None  # None when it failed
  reason: str  # '' when it did not


def make_record(
  mesh: mesh_lib.TexturedMesh,
  *,
  azimuths: Sequence[float] = AZIMUTHS,
  image_size: int = IMAGE_SIZE,
  grid_size: int = GRID_SIZE,
  shading: str = 'flat',
) -> tuple[Record, FlowStats]:
  """Turns a coloured mesh of any size into voxels, views and target flows.

  Raises:
    UserError: the mesh is unfit: no faces, not finite, no extent, or nothing to see in a view.
  """
  mesh_lib.check(mesh)
  mesh = mesh_lib.normalize(mesh)
  cameras = [camera_at(a, image_size=image_size) for a in azimuths]
  flat, depths = render(mesh, cameras, image_size=image_size)
  for azimuth, depth in zip(azimuths, depths, strict=True):
    if not np.isfinite(depth).any():
      raise UserError(f'nothing is to be seen of the mesh at azimuth {azimuth}: too thin')
  index, color = voxelize(mesh, grid_size)
  flow, visible, stats = target_flows(index, color, flat, depths, cameras, grid_size=grid_size)
  # Flows are matched by albedo under any light: light has no part in which point is which.
  lit = shading != 'flat'
  views = render(mesh, cameras, image_size=image_size, shading=shading).rgba if lit else flat
  return Record(views, index, color, visible, flow), stats


def run_job(job: Job) -> Outcome:
  """Makes one model and writes its record; whatever goes wrong becomes the outcome's reason."""
  start = time.perf_counter()
  try:
    dataset = dataset_lib.open_dataset(job.root)
    m = dataset.manifest
    record, stats = make_record(
      sources.source(job.source).load(job.model),
      azimuths=m.azimuths,
      image_size=m.image_size,
      grid_size=m.grid_size,
      shading=job.shading,
    )
    dataset_lib.write_record(dataset, job.row, record)
    reason = ''
  except UserError as e:
    stats, reason = None, str(e)
  except Exception as e:  # one file that some library chokes on must not stop the run
    stats, reason = None, f'{type(e).__name__}: {e}'
  return Outcome(job.row, time.perf_counter() - start, stats, ' '.join(reason.split()))


def run_jobs(
  jobs: Sequence[Job], make_executor: Callable[[int], Executor], workers: int
) -> Iterator[Outcome]:
  """Runs jobs and yields each outcome as it comes.

  When a worker dies (a crash in native code, no memory), its pool is lost with all that it had in
  hand. Those jobs are run again one by one, each in a pool of its own, and the one whose pool
  breaks again is the one that failed.

  Args:
    jobs: what to do.
    make_executor: makes an executor with that many workers.
    workers: how many.
  """
  waiting, suspects = deque(jobs), deque()
  while waiting:
    executor = make_executor(workers)
    running: dict[Future, Job] = {}
    try:
      while waiting or running:
        while waiting and len(running) < 2 * workers and not suspects:
          job = waiting.popleft()
          try:
            running[executor.submit(run_job, job)] = job
          except process_pool.BrokenProcessPool:
            suspects.append(job)
        if not running:
          break
        for future in wait(running, return_when=FIRST_COMPLETED).done:
          job = running.pop(future)
          try:
            yield future.result()
          except process_pool.BrokenProcessPool:
            suspects.append(job)
    finally:
      executor.shutdown(cancel_futures=True)
    while suspects:
      yield _run_alone(suspects.popleft(), make_executor)


def _run_alone(job: Job, make_executor: Callable[[int], Executor]) -> Outcome:
  start = time.perf_counter()
  with make_executor(1) as executor:
    try:
      return executor.submit(run_job, job).result()
    except process_pool.BrokenProcessPool:
      return Outcome(job.row, time.perf_counter() - start, None, 'it crashed its worker process')


def process_executor(workers: int) -> Executor:
  """Local processes, each on one core.

  They are started afresh (spawn), not forked: the parent has threads that a fork would leave dead.
  """
  for name in ('OPENBLAS_NUM_THREADS', 'OMP_NUM_THREADS', 'MKL_NUM_THREADS'):
    os.environ.setdefault(name, '1')  # read by the children as they load their libraries
  return ProcessPoolExecutor(workers, mp_context=get_context('spawn'), initializer=_start_worker)


def _start_worker() -> None:
  drjit.set_thread_count(1)
  # A terminal sends its interrupt to the whole group of processes. Mitsuba would end its rendering
  # in the middle, and half a view would count as one: the parent alone decides when to stop.
  os.setpgrp()
  threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
  """A parent that is killed takes no leave of its workers, who would wait for jobs forever."""
  wait_for_process([parent_process().sentinel])
  os._exit(1)
