import json
import os
import shutil
import subprocess
import sys
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool

import numpy as np
import pytest
import trimesh
from absl import flags
from PIL import Image

from cvn import dataset as dataset_lib
from cvn.errors import UserError
from cvn.files import atomic_write
from datagen import generate, pipeline
from datagen.pipeline import Job, Outcome, make_record, run_jobs
from datagen.sources import SourceModel
from datagen.sources.mesh_folder import load


def write_box(path, extents, color):
  mesh = trimesh.creation.box(extents)
  mesh.visual.face_colors = color
  with atomic_write(str(path)) as temporary:
    mesh.export(temporary)


@pytest.fixture(scope='module')
def meshes(tmp_path_factory):
  """Two boxes, and a file that is no mesh."""
  folder = tmp_path_factory.mktemp('meshes')
  write_box(folder / 'a.ply', (1, 2, 1), (255, 0, 0, 255))
  (folder / 'broken.ply').write_text('ply\nno mesh at all\n')
  write_box(folder / 'c.ply', (3, 2, 1), (0, 128, 255, 255))
  return folder


def parsed(*arguments):
  f = flags.FlagValues()
  generate.define_flags(f)
  f(['generate', *arguments])
  return f


def arguments(meshes, output, *more):
  return [
    '--source=meshes', '--category=box', f'--input={meshes}', f'--output={output}', *more
  ]  # fmt: skip


def program(*arguments):
  command = [sys.executable, '-m', 'datagen.generate', *arguments]
  return subprocess.run(command, capture_output=True, text=True, timeout=300)


@pytest.fixture(scope='module')
def generated(meshes, tmp_path_factory):
  """The finished program and its output."""
  output = tmp_path_factory.mktemp('generated') / 'boxes'
  return program(*arguments(meshes, output, '--workers=2')), output


@pytest.fixture
def threads(monkeypatch):
  """Work in this process: any executor does, and none has to be started."""
  monkeypatch.setattr(generate, 'process_executor', ThreadPoolExecutor)


def contents(folder):
  return {
    os.path.relpath(os.path.join(parent, name), folder): open_bytes(os.path.join(parent, name))
    for parent, _, names in os.walk(folder)
    for name in names
  }


def open_bytes(path):
  with open(path, 'rb') as f:
    return f.read()


def test_the_program_makes_what_can_be_made(generated):
  finished, output = generated
  assert finished.returncode == 0, finished.stderr
  assert 'made 2, already there 0, failed 1' in finished.stdout
  assert 'Traceback' not in finished.stderr
  failures = json.loads((output / 'failures.json').read_text())
  assert list(failures) == ['broken']
  assert f'failed: broken: {failures["broken"]}' in finished.stdout
  with Image.open(output / 'contact_sheet.png') as sheet:
    assert sheet.width > 500

  dataset = dataset_lib.open_dataset(str(output))
  assert [m.id for m in dataset.manifest.models] == ['a', 'broken', 'c']
  assert [m.source for m in dataset.manifest.models] == ['a.ply', 'broken.ply', 'c.ply']
  counts = dataset_lib.surface_counts(dataset)
  assert counts[1] == 0
  record = dataset_lib.read_record(dataset, 2)
  foreground = record.views[..., 3] > 0
  assert (record.views[foreground] == [0, 128, 255, 255]).all()
  assert (record.surface_color == [0, 128, 255]).all()
  assert np.ptp(record.surface_index.astype(int), axis=0).tolist() == [61, 41, 21]
  column, row = np.moveaxis((record.flow * 128).astype(int), -1, 0)
  assert foreground[np.arange(12)[:, None], row, column].all()


def test_the_same_bytes_from_one_worker_and_from_two(generated, meshes, tmp_path, threads):
  generate.run(parsed(*arguments(meshes, tmp_path / 'again', '--workers=1')))
  assert contents(tmp_path / 'again') == contents(generated[1])


def test_a_run_that_was_cut_short_ends_with_the_same_bytes(
  generated, meshes, tmp_path, threads, capsys
):
  shutil.copytree(generated[1], tmp_path / 'cut')
  whole = contents(tmp_path / 'cut')
  # As if killed while row 2 was written: no count, and not all of its arrays.
  lost = [n for n in whole if n.startswith(('surface_count/c/2', 'flow/c/2/1'))]
  assert len(lost) == 4
  for name in lost:
    os.unlink(tmp_path / 'cut' / name)
  generate.run(parsed(*arguments(meshes, tmp_path / 'cut')))
  assert 'made 1, already there 1, failed 1' in capsys.readouterr().out
  assert contents(tmp_path / 'cut') == whole


@pytest.mark.parametrize(
  'more, message',
  [
    (['--shading=lit'], 'shading flat, not lit'),
    (['--seed=1'], 'seed 0, not 1'),
    (['--limit=1'], 'of 3 models'),
    (['--category=chair'], 'category'),
  ],
)
def test_a_data_set_made_otherwise_is_not_touched(generated, meshes, threads, more, message):
  before = contents(generated[1])
  with pytest.raises(UserError, match=message):
    generate.run(parsed(*arguments(meshes, generated[1], *more)))
  assert contents(generated[1]) == before


def test_all_failed(tmp_path, threads):
  (tmp_path / 'meshes').mkdir()
  (tmp_path / 'meshes' / 'empty.obj').write_text('v 0 0 0\n')
  with pytest.raises(UserError, match='not one of 1 models could be made; empty: '):
    generate.run(parsed(*arguments(tmp_path / 'meshes', tmp_path / 'output')))


def test_splits_from_files(meshes, tmp_path):
  f = parsed(*arguments(meshes, tmp_path / 'output', f'--splits={tmp_path}'))
  with pytest.raises(UserError, match='list_box'):
    generate.run(f)
  (tmp_path / 'train_list_box.txt').write_text('a\nbroken\n')
  with pytest.raises(UserError, match='names c'):
    generate.run(f)
  (tmp_path / 'test_list_box.txt').write_text('c\n')
  models = generate.list_models('meshes', ['box'], str(meshes), None, 0)
  manifest = generate.plan(models, settings={}, splits_folder=str(tmp_path))
  assert [m.split for m in manifest.models] == ['train', 'train', 'test']


@pytest.mark.parametrize(
  'more',
  [['--workers=0'], ['--limit=0'], ['--limit=x'], ['--seed=-1'], ['--shading=x'], ['--source=x']],
)
def test_bad_flags(meshes, tmp_path, more):
  with pytest.raises(flags.Error):
    parsed(*arguments(meshes, tmp_path, *more))


def test_flags_that_are_missing():
  with pytest.raises(flags.Error, match='output'):
    parsed('--source=procedural', '--category=chair')


def test_the_program_ends_bad_input_with_one_line(tmp_path):
  finished = program(*arguments(tmp_path / 'nowhere', tmp_path / 'output'))
  assert finished.returncode == 1
  assert finished.stderr.startswith('error: ')
  assert finished.stderr.count('\n') == 1
  assert 'nowhere' in finished.stderr
  assert not (tmp_path / 'output').exists()


@pytest.mark.parametrize(
  'change, message',
  [
    (['--category='], 'no category'),
    (['--category=box,box'], 'twice'),
    (['--category=box,chair'], 'have the id'),
    (['--output=/proc/cvn'], '/proc/cvn'),
  ],
)
def test_what_cannot_be_planned(meshes, tmp_path, threads, change, message):
  with pytest.raises(UserError, match=message):
    generate.run(parsed(*arguments(meshes, tmp_path / 'output', *change)))


def test_several_categories_in_one_data_set():
  models = generate.list_models('procedural', ['chair', ' car'], None, 2, 0)
  assert [m.category for m in models] == ['chair', 'chair', 'car', 'car']


def test_a_record_of_any_size(meshes):
  mesh = load(SourceModel('a', 'box', str(meshes / 'a.ply')))
  record, stats = make_record(mesh, azimuths=(0, 90), image_size=32, grid_size=16)
  count = len(record.surface_index)
  assert record.views.shape == (2, 32, 32, 4)
  assert record.flow.shape == (2, count, 2)
  assert record.visible.shape == (2, count)
  assert stats.visible_error == 0
  with pytest.raises(UserError, match='finite'):
    make_record(mesh._replace(vertices=mesh.vertices * np.nan))


def test_light_does_not_move_flows(meshes):
  mesh = load(SourceModel('a', 'box', str(meshes / 'a.ply')))
  flat, lit = (
    make_record(mesh, azimuths=(0, 30), image_size=32, grid_size=16, shading=s)[0]
    for s in ('flat', 'lit')
  )
  np.testing.assert_array_equal(lit.flow, flat.flow)
  np.testing.assert_array_equal(lit.visible, flat.visible)
  assert (lit.views != flat.views).any()


def test_what_no_pixel_shows_is_refused(meshes):
  mesh = load(SourceModel('a', 'box', str(meshes / 'a.ply')))
  needle = mesh._replace(vertices=mesh.vertices * [1e-4, 1, 1e-4])
  with pytest.raises(UserError, match='too thin'):
    make_record(needle, image_size=32, grid_size=16)


def test_an_unforeseen_error_is_a_reason(monkeypatch, generated):
  def fail(*_, **__):
    raise ZeroDivisionError('three\nlines\nlong')

  monkeypatch.setattr(pipeline, 'make_record', fail)
  model = SourceModel('box-0', 'box', str(generated[1] / '..'))
  monkeypatch.setattr(
    pipeline.sources, 'source', lambda _: type('Source', (), {'load': lambda model: None})
  )
  outcome = pipeline.run_job(Job(str(generated[1]), 1, model, 'meshes', 'flat'))
  assert outcome.reason == 'ZeroDivisionError: three lines long'
  assert outcome.stats is None


class FragileExecutor(Executor):
  """Runs each job at once, and breaks for good at the jobs of some rows, as a process pool does."""

  def __init__(self, fatal, made):
    self.fatal, self.made, self.broken = fatal, made, False

  def submit(self, _, job):
    if self.broken:
      raise BrokenProcessPool('broken before')
    future = Future()
    if job.row in self.fatal:
      self.broken = True
      future.set_exception(BrokenProcessPool('a worker died'))
    else:
      self.made.append(job.row)
      future.set_result(Outcome(job.row, 0.0, None, ''))
    return future


@pytest.mark.parametrize('fatal', [{0}, {3}, {9}, {2, 3, 7}, set(range(10))])
def test_a_dying_worker_costs_its_own_job_only(fatal):
  made = []
  jobs = [Job('', row, None, '', '') for row in range(10)]
  outcomes = list(run_jobs(jobs, lambda workers: FragileExecutor(fatal, made), 2))
  assert sorted(o.row for o in outcomes) == list(range(10))
  assert {o.row for o in outcomes if o.reason} == fatal
  assert sorted(made) == sorted(set(range(10)) - fatal)
