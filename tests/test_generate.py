import glob
import json
import os
import shutil
import subprocess
import sys
import time
import types
from concurrent.futures import CancelledError, Executor, Future, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool

import numpy as np
import pytest
import trimesh
from absl import flags
from PIL import Image

from cvn import dataset as dataset_lib
from cvn.errors import UserError
from cvn.files import atomic_write
from datagen import generate, pipeline, plan
from datagen.pipeline import Job, Outcome, Settings, make_record, run_jobs
from datagen.quality.contact_sheet import rows_to_show
from datagen.reading import notes
from datagen.sources import SourceModel
from datagen.sources.mesh_folder import load
from datagen.splits import split_of


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


def in_threads(workers, memory):
  assert memory > 2**30
  return ThreadPoolExecutor(workers)


@pytest.fixture
def threads(monkeypatch):
  """Work in this process: any executor does, and none has to be started."""
  monkeypatch.setattr(generate, 'process_executor', in_threads)


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
  assert [m.path for m in dataset.manifest.models] == ['a.ply', 'broken.ply', 'c.ply']
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
  lost = [n for n in whole if n.startswith(('surface_count/c/2', 'flow/c/2/'))]
  assert len(lost) == 2
  for name in lost:
    os.unlink(tmp_path / 'cut' / name)
  generate.run(parsed(*arguments(meshes, tmp_path / 'cut')))
  assert 'made 1, already there 1, failed 1' in capsys.readouterr().out
  assert contents(tmp_path / 'cut') == whole


@pytest.mark.parametrize(
  'more, message',
  [
    (['--shading=lit'], 'shading flat, not lit'),
    (['--tolerance=2'], 'tolerance 1.0, not 2.0'),
    (['--similarity=0.2'], 'similarity 0.1, not 0.2'),
    (['--category=chair'], "model a with category 'box', not 'chair'"),
    (['--category=chair', '--append'], "model a with category 'box', not 'chair'"),
  ],
)
def test_a_data_set_made_otherwise_is_not_touched(generated, meshes, threads, more, message):
  before = contents(generated[1])
  with pytest.raises(UserError, match=message):
    generate.run(parsed(*arguments(meshes, generated[1], *more)))
  assert contents(generated[1]) == before


def test_what_was_guessed_or_missing_is_summed_up(tmp_path, threads, capsys):
  (tmp_path / 'in').mkdir()
  solid = 'v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nusemtl {}\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n'
  (tmp_path / 'in' / 'x.mtl').write_text('newmtl Wood\nKd 1 0 0\n')
  for name, material in (('a', 'Wood'), ('b', 'wood'), ('c', 'oak')):
    (tmp_path / 'in' / f'{name}.obj').write_text('mtllib x.mtl\n' + solid.format(material))
  generate.run(parsed(*arguments(tmp_path / 'in', tmp_path / 'out')))
  out = capsys.readouterr().out
  assert '1 models name files or materials that do not exist\n' in out
  assert f'1 models: {notes.MATERIAL_GUESSED}\n' in out
  dataset = dataset_lib.open_dataset(str(tmp_path / 'out'))
  facts = [dataset_lib.read_record(dataset, row).facts for row in range(3)]
  assert [f.missing for f in facts] == [0, 0, 1]
  assert [notes.from_bits(f.notes) for f in facts] == [(), (notes.MATERIAL_GUESSED,), ()]


def test_all_failed(tmp_path, threads):
  (tmp_path / 'meshes').mkdir()
  (tmp_path / 'meshes' / 'empty.obj').write_text('v 0 0 0\n')
  with pytest.raises(UserError, match='none of 1 models could be made; empty: '):
    generate.run(parsed(*arguments(tmp_path / 'meshes', tmp_path / 'output')))


def test_splits_from_files(meshes, tmp_path):
  f = parsed(*arguments(meshes, tmp_path / 'output', f'--splits={tmp_path}'))
  with pytest.raises(UserError, match='list_box'):
    generate.run(f)
  (tmp_path / 'train_list_box.txt').write_text('d\n')
  with pytest.raises(UserError, match='name none of the models, such as a'):
    generate.run(f)
  (tmp_path / 'test_list_box.txt').write_text('c\n')
  (tmp_path / 'val_list_box.txt').write_text('broken\n')
  models = plan.list_models('meshes', ['box'], str(meshes), None, 0)
  listed, note = plan.keep_listed(models, str(tmp_path), None)
  assert [(m.id, m.split) for m in listed] == [('broken', 'val'), ('c', 'test')]
  assert note.endswith(
    ': 2 models listed and found, 1 listed but not found, 1 found but not listed (left out)'
  )
  assert plan.keep_listed(models, str(tmp_path), 1)[0] == listed[:1]
  assert [m.split for m in plan.plan(listed, 'meshes')] == ['val', 'test']
  # Without lists, what the source says; without that, the hash of the id.
  planned = plan.plan([models[0]._replace(split='val'), *models[1:]], 'meshes')
  assert [m.split for m in planned] == ['val', *(split_of(m.id) for m in models[1:])]


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
    (['--category=box,box'], 'repeats a category'),
    (['--category=box,chair'], 'has no subfolder box'),
    (['--output=/proc/cvn'], '/proc/cvn'),
  ],
)
def test_what_cannot_be_planned(meshes, tmp_path, threads, change, message):
  with pytest.raises(UserError, match=message):
    generate.run(parsed(*arguments(meshes, tmp_path / 'output', *change)))


def test_several_categories_in_one_data_set():
  models = plan.list_models('procedural', ['chair', ' car'], None, 2, 0)
  assert [m.category for m in models] == ['chair', 'chair', 'car', 'car']


def test_a_record_of_any_size(meshes):
  mesh = load(SourceModel('a', 'box', str(meshes / 'a.ply')))
  record, stats = make_record(mesh, Settings((0, 90), image_size=32, grid_size=16))
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
    make_record(mesh, Settings((0, 30), image_size=32, grid_size=16, shading=s))[0]
    for s in ('flat', 'lit')
  )
  np.testing.assert_array_equal(lit.flow, flat.flow)
  np.testing.assert_array_equal(lit.visible, flat.visible)
  assert (lit.views != flat.views).any()


def test_what_no_pixel_shows_is_refused(meshes):
  mesh = load(SourceModel('a', 'box', str(meshes / 'a.ply')))
  needle = mesh._replace(vertices=mesh.vertices * [1e-4, 1, 1e-4])
  with pytest.raises(UserError, match='too thin'):
    make_record(needle, Settings(image_size=32, grid_size=16))


def test_an_unforeseen_error_is_a_reason(monkeypatch, generated):
  def fail(*_, **__):
    raise ZeroDivisionError('three\nlines\nlong')

  monkeypatch.setattr(pipeline, 'make_record', fail)
  model = SourceModel('box-0', 'box', str(generated[1] / '..'))
  monkeypatch.setattr(
    pipeline.sources, 'source', lambda _: type('Source', (), {'load': lambda model: None})
  )
  outcome = pipeline.run_job(Job(str(generated[1]), 1, model, 'meshes', Settings(), 60.0))
  assert outcome.reason == 'ZeroDivisionError: three lines long'
  assert outcome.stats is None


def test_more_voxels_than_a_record_holds_are_the_models_fault(monkeypatch, generated):
  def fill(*_, **__):
    full = pipeline.dataset_lib.SURFACE_CAPACITY + 1
    return types.SimpleNamespace(surface_index=np.zeros((full, 3), np.uint8)), None

  monkeypatch.setattr(pipeline, '_make', fill)
  model = SourceModel('box-0', 'box', str(generated[1] / '..'))
  outcome = pipeline.run_job(Job(str(generated[1]), 1, model, 'meshes', Settings(), 60.0))
  assert 'a record holds 1 to' in outcome.reason and outcome.stats is None


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
  jobs = [Job('', row, None, '', None, None) for row in range(10)]
  outcomes = list(run_jobs(jobs, lambda workers: FragileExecutor(fatal, made), 2))
  assert sorted(o.row for o in outcomes) == list(range(10))
  assert {o.row for o in outcomes if o.reason} == fatal
  assert sorted(made) == sorted(set(range(10)) - fatal)


class CrowdedExecutor(Executor):
  """Its worker runs out of memory at some rows, and keeps so much that all others fail after."""

  def __init__(self, large, made):
    self.large, self.made, self.full = large, made, False

  def submit(self, _, job):
    future, reason = Future(), ''
    if job.row in self.large:
      self.full, reason = True, pipeline.NO_MEMORY
    elif self.full:
      reason = "RuntimeError: can't start new thread"
    else:
      self.made.append(job.row)
    future.set_result(Outcome(job.row, 0.0, None, reason))
    return future


@pytest.mark.parametrize('large', [{0}, {3}, {9}, {2, 3, 7}, set(range(10))])
def test_memory_that_a_worker_keeps_costs_no_other_model(large):
  made = []
  jobs = [Job('', row, None, '', None, None) for row in range(10)]
  outcomes = list(run_jobs(jobs, lambda workers: CrowdedExecutor(large, made), 2))
  assert sorted(o.row for o in outcomes) == list(range(10))
  assert {o.row: o.reason for o in outcomes if o.reason} == dict.fromkeys(large, pipeline.NO_MEMORY)
  assert sorted(made) == sorted(set(range(10)) - large)


def test_memory_that_ends_while_a_record_is_written(generated, monkeypatch):
  def full(*_):
    raise MemoryError

  monkeypatch.setattr(dataset_lib, 'write_record', full)
  monkeypatch.setattr(dataset_lib, 'check_size', lambda *_: None)
  monkeypatch.setattr(pipeline, '_make', lambda job: (None, None))
  job = Job(str(generated[1]), 1, None, '', Settings(), 60.0)
  assert pipeline.run_job(job).reason == pipeline.NO_MEMORY


def test_models_are_appended_to_a_data_set(generated, meshes, tmp_path, threads, capsys):
  whole = contents(generated[1])
  part = tmp_path / 'part'
  part.mkdir()
  shutil.copy(meshes / 'c.ply', part)
  output = tmp_path / 'data'
  generate.run(parsed(*arguments(part, output)))
  with pytest.raises(UserError, match=r'without 2 of these 3 \(first: a\): give --append'):
    generate.run(parsed(*arguments(meshes, output)))
  capsys.readouterr()
  generate.run(parsed(*arguments(meshes, output, '--append')))
  assert 'made 1, already there 1, failed 1' in capsys.readouterr().out
  both = dataset_lib.open_dataset(str(output))
  assert [m.id for m in both.manifest.models] == ['c', 'a', 'broken']
  # Each record has the bytes that it has in a data set made at once.
  rows = {'0': '2', '1': '0'}
  mine = {n: b for n, b in contents(output).items() if '/c/' in n}
  for name, data in mine.items():
    array, c, row, *rest = name.split('/')
    assert data == whole['/'.join([array, c, rows[row], *rest])]
  # Once planned, no more need to append: the same models, or some of them, are all there.
  generate.run(parsed(*arguments(meshes, output)))
  generate.run(parsed(*arguments(part, output)))
  assert 'made 0, already there 2, failed 1' in capsys.readouterr().out


def test_a_mesh_that_changes_is_made_anew(meshes, tmp_path, threads, capsys):
  folder, output = tmp_path / 'in', tmp_path / 'out'
  shutil.copytree(meshes, folder)
  generate.run(parsed(*arguments(folder, output)))
  write_box(folder / 'c.ply', (3, 2, 1), (0, 255, 0, 255))
  capsys.readouterr()
  generate.run(parsed(*arguments(folder, output)))
  assert 'made 1, already there 1, failed 1' in capsys.readouterr().out
  dataset = dataset_lib.open_dataset(str(output))
  assert (dataset_lib.read_record(dataset, 2).surface_color == [0, 255, 0]).all()
  generate.run(parsed(*arguments(folder, tmp_path / 'at once')))
  assert contents(output) == contents(tmp_path / 'at once')


def test_models_that_lie_are_turned(meshes, tmp_path, threads, capsys):
  output = tmp_path / 'out'
  generate.run(parsed(*arguments(meshes, output)))
  generate.run(parsed(*arguments(meshes, output, '--up=z', '--turn=90')))
  assert 'made 2, already there 0, failed 1' in capsys.readouterr().out
  dataset = dataset_lib.open_dataset(str(output))
  index = dataset_lib.read_record(dataset, 2).surface_index.astype(int)  # 3 by 2 by 1 before
  assert np.ptp(index, axis=0).tolist() == [41, 21, 61]
  assert (dataset.manifest.models[2].up, dataset.manifest.models[2].turn) == ('z', 90.0)
  f = parsed('--source=im2avatar_release', '--category=x', f'--output={output}', '--up=z')
  with pytest.raises(UserError):
    generate.run(f)


def test_several_categories_are_subfolders(meshes, tmp_path, threads):
  for name in ('car', 'human'):
    (tmp_path / 'in' / name).mkdir(parents=True)
    shutil.copy(meshes / 'a.ply', tmp_path / 'in' / name)
  shutil.copy(meshes / 'c.ply', tmp_path / 'in')
  flags = [f'--input={tmp_path / "in"}', f'--output={tmp_path / "out"}', '--split=test']
  generate.run(
    parsed('--source=meshes', '--category=car,human', *flags, '--licence=CC0', '--creator=Anna')
  )
  models = dataset_lib.open_dataset(str(tmp_path / 'out')).manifest.models
  assert [(m.id, m.category, m.path) for m in models] == [
    ('car_a', 'car', os.path.join('car', 'a.ply')),
    ('human_a', 'human', os.path.join('human', 'a.ply')),
  ]
  assert {(m.split, m.licence, m.creator) for m in models} == {('test', 'CC0', 'Anna')}
  with pytest.raises(UserError, match='has no subfolder table'):
    generate.run(parsed('--source=meshes', '--category=car,table', *flags))
  with pytest.raises(UserError, match='is not a name'):
    generate.run(parsed('--source=meshes', '--category=car|human', *flags))


def test_the_contact_sheet_shows_every_category_and_new_models_first():
  models = [dataset_lib.Model(str(n), 'car' if n < 6 else 'human', 'train', 'x') for n in range(9)]
  manifest = dataset_lib.Manifest(tuple(models), (), 1, 1, 1, {})
  dataset = dataset_lib.Dataset('', manifest, {})
  done = np.ones(9, bool)
  done[1] = False
  assert rows_to_show(dataset, done, [], 4) == [0, 2, 6, 7]
  assert rows_to_show(dataset, done, [8, 5], 4) == [0, 5, 6, 8]
  assert rows_to_show(dataset, done, [], 99) == [0, 2, 3, 4, 5, 6, 7, 8]


def test_another_source_is_appended(generated, tmp_path, threads):
  output = tmp_path / 'data'
  shutil.copytree(generated[1], output)
  more = ['--source=procedural', '--category=chair', '--limit=1', f'--output={output}', '--append']
  generate.run(parsed(*more))
  dataset = dataset_lib.open_dataset(str(output))
  assert [m.source for m in dataset.manifest.models] == ['meshes'] * 3 + ['procedural']
  assert (dataset_lib.surface_counts(dataset) > 0).tolist() == [True, False, True, True]


def start_program(*arguments):
  command = [sys.executable, '-m', 'datagen.generate', *arguments]
  return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def test_a_run_killed_at_any_moment_ends_with_the_same_bytes(tmp_path):
  """kill -9 of the program and so of its workers, some time after the first record."""
  chairs = ['--source=procedural', '--category=chair', '--limit=6', '--workers=2']
  assert program(*chairs, f'--output={tmp_path / "whole"}').returncode == 0
  killed = 0
  for attempt in range(8):
    running = start_program(*chairs, f'--output={tmp_path / "killed"}')
    deadline = time.monotonic() + 120
    done = len(glob.glob(str(tmp_path / 'killed/surface_count/c/*')))
    while len(glob.glob(str(tmp_path / 'killed/surface_count/c/*'))) == done:
      assert time.monotonic() < deadline
      if running.poll() is not None:
        break
      time.sleep(0.02)
    time.sleep(0.05 * attempt)
    if running.poll() is not None:
      break
    running.kill()
    running.wait()
    killed += 1
  assert killed >= 2
  finished = program(*chairs, f'--output={tmp_path / "killed"}')
  assert finished.returncode == 0, finished.stderr
  assert contents(tmp_path / 'killed') == contents(tmp_path / 'whole')


def test_a_model_that_takes_too_long_is_given_up(generated, monkeypatch):
  def endless(_):
    while True:
      pass

  before = contents(generated[1])
  fake = type('Source', (), {'load': staticmethod(endless)})
  monkeypatch.setattr(pipeline.sources, 'source', lambda _: fake)
  job = Job(str(generated[1]), 1, None, '', Settings(), 0.2)
  assert pipeline.run_job(job).reason == 'it took more than 0.2 s'
  assert contents(generated[1]) == before


def test_a_model_that_needs_too_much_memory_is_given_up(generated, monkeypatch):
  def huge(_):
    return np.ones(2**44)  # 128 TiB: refused without any limit of ours

  fake = type('Source', (), {'load': staticmethod(huge)})
  monkeypatch.setattr(pipeline.sources, 'source', lambda _: fake)
  job = Job(str(generated[1]), 1, None, '', Settings(), 60.0)
  assert pipeline.run_job(job).reason == 'it needs more memory than a worker may have'


def test_a_disk_that_is_full_ends_the_run(meshes, tmp_path, threads, monkeypatch):
  """No model fails for it: with more space the same command goes on."""

  def full(*_):
    raise UserError('cannot write the record: No space left on device')

  monkeypatch.setattr(dataset_lib, 'write_record', full)
  with pytest.raises(UserError, match='No space left'):
    generate.run(parsed(*arguments(meshes, tmp_path / 'data')))
  dataset = dataset_lib.open_dataset(str(tmp_path / 'data'))
  assert not dataset_lib.surface_counts(dataset).any()
  monkeypatch.undo()
  monkeypatch.setattr(generate, 'process_executor', in_threads)
  generate.run(parsed(*arguments(meshes, tmp_path / 'data')))
  assert (dataset_lib.surface_counts(dataset) > 0).tolist() == [True, False, True]


class LostExecutor(Executor):
  """An executor whose scheduler goes away, or whose workers do."""

  def __init__(self, error):
    self.error = error

  def submit(self, *_):
    future = Future()
    future.set_exception(self.error)
    return future


def test_a_job_whose_worker_is_lost_again_and_again():
  jobs = [Job('', row, None, '', None, None) for row in range(3)]
  outcomes = list(run_jobs(jobs, lambda _: LostExecutor(RuntimeError('KilledWorker')), 2))
  assert [o.reason for o in outcomes] == ['its worker was lost: KilledWorker'] * 3


def test_a_lost_scheduler_ends_the_run():
  jobs = [Job('', 0, None, '', None, None)]
  with pytest.raises(UserError, match='repeat the command'):
    list(run_jobs(jobs, lambda _: LostExecutor(CancelledError()), 2))
