"""The Markdown documents: their library example runs, their commands and links exist."""

import importlib.util
import pathlib
import re
from typing import Any, NamedTuple

import jax
import numpy as np
import pytest
import trimesh
from PIL import Image

from cvn import checkpoint
from cvn.networks import ColorNetwork, ShapeNetwork

ROOT = pathlib.Path(__file__).parent.parent
DOCUMENTS = sorted([*ROOT.glob('*.md'), *ROOT.glob('docs/*.md')])
SHARED_FLAGS = ('flagfile', 'help')  # absl's own


class _State(NamedTuple):
  params: Any
  batch_stats: Any
  opt_state: Any
  step: Any


def blocks(path, language):
  """The fenced code blocks of a document."""
  return re.findall(rf'^```{language}\n(.*?)^```$', path.read_text(), re.M | re.S)


def commands(path):
  """(program, names of flags) of every `python -m` command in shell blocks and inline code."""
  text = path.read_text()
  inline = re.findall(r'`(python -m [^`]+)`', re.sub(r'^```.*?^```$', '', text, flags=re.M | re.S))
  joined = '\n'.join([*blocks(path, 'sh'), *(' '.join(i.split()) for i in inline)])
  for line in joined.replace('\\\n', ' ').splitlines():
    found = re.search(r'python -m ((?:datagen|experiments)(?:\.\w+)+)(.*)', line.split('  #')[0])
    if found:
      yield found[1], re.findall(r'(?<= --)(\w+)', found[2])


def save_network(folder, kind, network):
  """A run with parameters that were never trained; every voxel is occupied."""
  image = np.zeros((1, 128, 128, 3), np.float32)
  shapes = jax.eval_shape(lambda: network.init(jax.random.key(0), image, train=False))

  def draw(path, x):
    noise = 0.1 * np.random.default_rng(x.size).standard_normal(x.shape, np.float32)
    return noise + 3 * (path[-1].key == 'bias' and x.shape == (1,))

  params = jax.tree_util.tree_map_with_path(draw, shapes['params'])
  stats = jax.tree_util.tree_map_with_path(
    lambda path, x: np.full(x.shape, path[-1].key == 'var', np.float32), shapes['batch_stats']
  )
  checkpoint.start(folder, {'network': kind})
  checkpoint.save(folder, _State(params, stats, {}, np.zeros((), np.int32)), {})


def test_the_library_example_writes_a_mesh(tmp_path, monkeypatch):
  monkeypatch.chdir(tmp_path)
  save_network('SHAPE', 'shape', ShapeNetwork())
  save_network('COLOR', 'color', ColorNetwork())
  image = np.full((150, 200, 3), 240, np.uint8)
  image[30:130, 60:120] = (200, 30, 40)
  Image.fromarray(image).save('PHOTO.jpg')
  (code,) = blocks(ROOT / 'README.md', 'python')
  exec(code, {})
  assert len(trimesh.load('PHOTO.glb', force='mesh').faces) == 6 * 2 * 64**2


@pytest.mark.parametrize('path', DOCUMENTS, ids=lambda p: p.name)
def test_commands_name_programs_and_their_flags(path):
  sources = {
    package: '\n'.join(p.read_text() for p in (ROOT / package).rglob('*.py'))
    for package in ('datagen', 'experiments')
  }
  for program, names in commands(path):
    assert importlib.util.find_spec(program), program
    source = sources[program.split('.')[0]]
    for name in names:
      defined = f"'{name.removeprefix('no')}'" in source or f"'{name}'" in source
      assert defined or name in SHARED_FLAGS, f'{program} --{name}'


@pytest.mark.parametrize('path', DOCUMENTS, ids=lambda p: p.name)
def test_links_lead_to_files(path):
  for target in re.findall(r'\]\(([^)#\s]+)', path.read_text()):
    if '://' not in target:
      assert (path.parent / target).exists(), target
