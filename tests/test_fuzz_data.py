"""Data sets and checkpoints with bytes, numbers or files gone wrong: read, or refused in a line.

The slow test tries 20,000 of each. A fault in native code ends the process, and so the test.
"""

import json
import os
import pathlib
import random
import re
import shutil

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import synthetic

from cvn import checkpoint, data, dataset, objectives
from cvn.errors import UserError
from cvn.recipe import PAPER
from cvn.train import TrainState
from datagen import limits

FILES = {'dataset': 150, 'checkpoint': 25}  # a checkpoint takes Orbax a hundred times as long
NUMBER = re.compile(rb'-?\d+\.?\d*')
NUMBERS = b'0 -1 1 7 255 1e308 1e999 4294967296 18446744073709551616 0.5 null "x" [] {}'.split()
WORDS = [b'{', b'}', b'[', b']', b'"', b',', b'\0', b'\xff', b'null', b'../', b'file://', b'0']
MEMORY = 8 << 30  # bytes, for this process: what asks for more is refused


def mutated(content, rng):
  """The content with one to three faults."""
  content = bytearray(content)
  for _ in range(rng.randint(1, 3)):
    kind = rng.randrange(6)
    at = rng.randrange(len(content) + 1)
    found = [*NUMBER.finditer(content)] if kind == 0 else []
    if found:
      m = rng.choice(found)
      content[m.start() : m.end()] = rng.choice(NUMBERS)
    elif kind == 1:
      content[at:at] = rng.choice(WORDS)
    elif kind == 2:
      del content[at:]
    elif kind == 3:
      del content[at : at + rng.randint(1, 20)]
    elif content:
      content[at % len(content)] ^= 1 << rng.randrange(8)
  return bytes(content)


def files_below(folder):
  return sorted(os.path.join(here, name) for here, _, names in os.walk(folder) for name in names)


def break_one(folder, rng):
  """Puts faults into a file of a folder, or takes it away; returns what undoes it."""
  path = rng.choice(files_below(folder))
  with open(path, 'rb') as f:
    content = f.read()
  if rng.randrange(20) == 0:
    os.unlink(path)
  else:
    with open(path, 'wb') as f:
      f.write(mutated(content, rng))

  def undo():
    with open(path, 'wb') as f:
      f.write(content)

  return path, undo


def read_dataset(folder):
  """All that programs read of a data set."""
  opened = dataset.open_dataset(folder)
  rows = data.select_rows(opened, 'train')
  most = data.max_voxels(opened)
  dataset.digest(opened, rows)
  for row in rows[:2]:
    for view in range(min(2, len(opened.manifest.azimuths))):
      data.decode(data.read_color(opened, row, view, max_voxels=most))
    dataset.read_record(opened, row)


def make_state():
  params = {'w': jnp.arange(300.0).reshape(3, 100), 'deep': {'b': jnp.ones(5)}}
  return TrainState(params, {'mean': jnp.zeros(3)}, {'mu': params}, jnp.int32(7))


def read_checkpoint(folder):
  """All that programs read of a training folder."""
  checkpoint.load_network(folder, 'shape')
  checkpoint.restore(folder, jax.tree.map(jnp.zeros_like, make_state()))


def make_small_dataset(folder):
  synthetic.make_dataset(
    folder, 3, splits=('train', 'train', 'val'), azimuths=(0, 90), image_size=16, grid_size=8,
    capacity=512,
  )  # fmt: skip


def make_checkpoint(folder):
  checkpoint.start(str(folder), {'network': 'shape', 'seed': 1})
  checkpoint.save(str(folder), make_state(), {'iterator': {'next_index': 3}, 'window': []})


READERS = {
  'dataset': (make_small_dataset, read_dataset),
  'checkpoint': (make_checkpoint, read_checkpoint),
}


def fuzz(kind, folder, count, seed):
  """Reads `count` broken ones; returns how many were refused."""
  make, read = READERS[kind]
  make(folder / 'good')
  read(str(folder / 'good'))
  rng, refused = random.Random(seed), 0
  for n in range(count):
    path, undo = break_one(folder / 'good', rng)
    try:
      read(str(folder / 'good'))
    except UserError as e:
      refused += 1
      assert '\n' not in str(e) and len(str(e)) < 1000, str(e)
    except Exception as e:
      kept = shutil.copy(path, folder / 'culprit')
      raise AssertionError(f'seed {seed}, number {n}, {path}: kept as {kept}') from e
    finally:
      undo()
  read(str(folder / 'good'))
  return refused


# Orbax leaves what it was about to read when one of its reads fails.
@pytest.mark.filterwarnings('ignore::pytest.PytestUnraisableExceptionWarning')
@pytest.mark.parametrize('kind', READERS)
def test_faults_are_refused_or_harmless(kind, tmp_path):
  assert fuzz(kind, tmp_path, FILES[kind], seed=0) > FILES[kind] // 10


@pytest.mark.slow
@pytest.mark.filterwarnings('ignore::pytest.PytestUnraisableExceptionWarning')
@pytest.mark.parametrize('kind', READERS)
def test_many_faults(kind, tmp_path):
  limits.limit_memory(MEMORY)
  assert fuzz(kind, tmp_path, 20_000, seed=int(os.environ.get('FUZZ_SEED', '1'))) > 2000


def test_a_data_set_whose_arrays_are_not_what_its_manifest_says(tmp_path):
  make_small_dataset(tmp_path / 'set')
  path = tmp_path / 'set' / 'views' / 'zarr.json'
  raw = json.loads(path.read_text())
  raw['shape'][2] = 10**6
  path.write_text(json.dumps(raw))
  with pytest.raises(UserError, match=r'damaged data set: views is uint8 .*, but the manifest'):
    dataset.open_dataset(str(tmp_path / 'set'))


def test_chunks_that_would_fill_the_memory(tmp_path):
  make_small_dataset(tmp_path / 'set')
  path = tmp_path / 'set' / 'surface_index' / 'zarr.json'
  raw = json.loads(path.read_text())
  raw['chunk_grid']['configuration']['chunk_shape'] = [10**6, 512, 3]
  path.write_text(json.dumps(raw))
  with pytest.raises(UserError, match=r'damaged data set: surface_index has chunks of \d+ bytes'):
    dataset.open_dataset(str(tmp_path / 'set'))


@pytest.mark.parametrize('rows', [2**31, 2**60])
def test_an_array_that_claims_any_length_costs_nothing(tmp_path, rows):
  make_small_dataset(tmp_path / 'set')
  path = tmp_path / 'set' / 'surface_count' / 'zarr.json'
  raw = json.loads(path.read_text())
  raw['shape'] = [rows]
  path.write_text(json.dumps(raw))
  opened = dataset.open_dataset(str(tmp_path / 'set'))
  assert len(dataset.surface_counts(opened)) == 3


def test_records_of_noise_are_safe_to_train_on(tmp_path):
  """Indices past the grid are dropped like padding, whatever the bytes are."""
  rng = np.random.default_rng(0)
  batch = data.Batch(
    rng.integers(256, size=(2, 16, 16, 4), dtype=np.uint8),
    rng.integers(256, size=(2, 50, 3), dtype=np.uint8),
    rng.integers(256, size=(2, 50, 3), dtype=np.uint8),
    rng.integers(65536, size=(2, 50, 2), dtype=np.uint16),
  )
  loss, _ = objectives.shape(jnp.zeros((2, 8, 8, 8, 1)), data.decode(batch), PAPER, True)
  assert jnp.isfinite(loss)


def test_nothing_reads_pickles():
  """A reader of pickles runs what a file says."""
  root = pathlib.Path(__file__).parent.parent
  readers = re.compile(
    r'pickle\.loads?\(|allow_pickle|torch\.load|joblib\.load|marshal\.load|shelve\.open'
  )
  for room in ('cvn', 'datagen', 'experiments'):
    for path in (root / room).rglob('*.py'):
      assert not readers.search(path.read_text()), path
