"""The program from pictures to meshes, run as a user runs it, on untrained networks."""

import os
import subprocess
import sys
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from PIL import Image

from cvn import checkpoint
from cvn.networks import ColorNetwork, ShapeNetwork


class _State(NamedTuple):
  params: Any
  batch_stats: Any
  opt_state: Any
  step: Any


def _noise(x):
  return 0.1 * np.random.default_rng(x.size).standard_normal(x.shape, np.float32)


@pytest.fixture(scope='module')
def workdirs(tmp_path_factory):
  """Folders of a shape and a colour network, at their initial values."""
  folders = {}
  for kind, network in (('shape', ShapeNetwork()), ('color', ColorNetwork())):
    image = jnp.zeros((1, 128, 128, 3))
    shapes = jax.eval_shape(lambda n=network, i=image: n.init(jax.random.key(0), i, train=False))
    params = jax.tree.map(_noise, shapes['params'])
    stats = jax.tree_util.tree_map_with_path(
      lambda p, x: np.full(x.shape, 'var' in str(p[-1]), np.float32), shapes['batch_stats']
    )
    folders[kind] = str(tmp_path_factory.mktemp(kind))
    checkpoint.start(folders[kind], {'network': kind})
    checkpoint.save(folders[kind], _State(params, stats, {}, np.zeros((), np.int32)), {})
  return folders


def _run(*arguments, **flags):
  command = [sys.executable, '-m', 'experiments.reconstruct', *arguments]
  command += [f'--{k}={v}' for k, v in flags.items()]
  return subprocess.run(command, capture_output=True, text=True)


def _picture(path, color):
  image = np.full((150, 200, 3), 240, np.uint8)
  image[30:130, 60:120] = color
  os.makedirs(os.path.dirname(path), exist_ok=True)
  Image.fromarray(image).save(path)
  return str(path)


def test_pictures_good_and_bad(tmp_path, workdirs):
  first = _picture(tmp_path / 'a' / 'chair.png', (200, 30, 40))
  second = _picture(tmp_path / 'b' / 'chair.png', (30, 150, 220))
  broken = tmp_path / 'broken.png'
  broken.write_text('no picture')
  missing = tmp_path / 'missing.png'
  output = tmp_path / 'new' / 'out'
  done = _run(
    f'--image={first},{broken}',
    f'--image={second},{missing},{first}',
    output=output,
    threshold=0.3,
    **workdirs,
  )
  assert done.returncode == 1 and 'Traceback' not in done.stderr
  errors = [line for line in done.stderr.splitlines() if line.startswith('error: ')]
  assert len(errors) == 3 and str(broken) in errors[0] and str(missing) in errors[1]
  assert errors[2] == 'error: 2 of 4 pictures failed'
  assert sorted(os.listdir(output)) == [
    f'chair{n}.{suffix}' for n in ('', '_2') for suffix in ('glb', 'ply', 'png')
  ]
  for name in ('chair', 'chair_2'):
    ply = trimesh.load(output / f'{name}.ply')
    glb = trimesh.load_scene(output / f'{name}.glb').geometry['voxels']
    assert len(ply.faces) == len(glb.faces) > 0
    with Image.open(output / f'{name}.png') as panel:
      assert panel.width > 4 * panel.height
  assert f'{first} -> ' in done.stdout and f'{second} -> ' in done.stdout


def test_nothing_occupied_says_what_the_highest_probability_is(tmp_path, workdirs):
  picture = _picture(tmp_path / 'a.png', (200, 30, 40))
  output = tmp_path / 'out'
  done = _run(image=picture, output=output, threshold=0.999999, **workdirs)
  assert done.returncode == 1 and 'Traceback' not in done.stderr
  assert 'highest probability is 0.' in done.stderr
  assert not output.exists()


@pytest.mark.parametrize(
  'flags, words',
  [
    ({'alpha': 0}, 'alpha'),
    ({'threshold': 1}, 'threshold'),
    ({'shape': '/nowhere'}, '/nowhere'),
    ({'output': 'in'}, 'overwrite'),
  ],
)
def test_bad_flags_end_in_one_clear_line(tmp_path, workdirs, flags, words):
  good = {'image': _picture(tmp_path / 'in' / 'a.png', (9, 9, 9)), 'output': tmp_path / 'out'}
  flags = {**good, **workdirs, **flags}
  if flags['output'] == 'in':
    flags['output'] = tmp_path / 'in'
  done = _run(**flags)
  assert done.returncode != 0 and 'Traceback' not in done.stderr
  assert words in done.stderr
