"""The program from pictures to meshes, on networks that were never trained."""

import os
import subprocess
import sys
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from absl import flags
from PIL import Image

from cvn import checkpoint, infer, photo
from cvn.errors import UserError
from cvn.networks import ColorNetwork, ShapeNetwork
from experiments import reconstruct as program


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


def _run(*arguments, **named):
  """The program's exit status, within this process."""
  return program.main([*arguments, *(f'--{k}={v}' for k, v in named.items())])


def _picture(path, color):
  image = np.full((150, 200, 3), 240, np.uint8)
  image[30:130, 60:120] = color
  os.makedirs(os.path.dirname(path), exist_ok=True)
  Image.fromarray(image).save(path)
  return str(path)


def test_pictures_good_and_bad(tmp_path, workdirs, capsys):
  first = _picture(tmp_path / 'a' / 'chair.png', (200, 30, 40))
  second = _picture(tmp_path / 'b' / 'chair.png', (30, 150, 220))
  broken = tmp_path / 'broken.png'
  broken.write_text('no picture')
  missing = tmp_path / 'missing.png'
  output = tmp_path / 'new' / 'out'
  pictures = f'--image={first},{broken}', f'--image={second},{missing},{first}'
  assert _run(*pictures, output=output, threshold=0.3, **workdirs) == 1
  stdout, stderr = capsys.readouterr()
  errors = [line for line in stderr.splitlines() if line.startswith('error: ')]
  assert len(errors) == 3 and str(broken) in errors[0] and str(missing) in errors[1]
  assert errors[2] == 'error: 2 of 4 pictures failed'
  assert f'{first} -> ' in stdout and f'{second} -> ' in stdout
  assert set(os.listdir(output)) == {
    f'chair{n}{end}' for n in ('', '_2') for end in ('.glb', '.ply', '.png', '_mask.png')
  }
  for name in ('chair', 'chair_2'):
    ply = trimesh.load(output / f'{name}.ply')
    glb = trimesh.load_scene(output / f'{name}.glb').geometry['voxels']
    assert len(ply.faces) == len(glb.faces) > 0
    with Image.open(output / f'{name}.png') as panel:
      assert panel.width > panel.height


def test_a_folder_with_doubts_and_masks(tmp_path, workdirs, capsys):
  one = _picture(tmp_path / 'in' / 'one.png', (200, 30, 40))
  with Image.open(one) as image:
    two = np.asarray(image).copy()
  two[40:130, 140:190] = (30, 150, 220)
  Image.fromarray(two).save(tmp_path / 'in' / 'two.png')
  common = {'threshold': 0.3, **workdirs}
  assert _run(image=tmp_path / 'in', output=tmp_path / 'out', up='z', **common) == 0
  stdout, stderr = capsys.readouterr()
  assert 'one.png -> ' in stdout and 'object by ground' in stdout
  assert f'warning: {tmp_path}/in/two.png shows 2 separate parts' in stderr
  with Image.open(tmp_path / 'out' / 'one_mask.png') as mask:
    expected = np.zeros((150, 200), bool)
    expected[30:130, 60:120] = True
    np.testing.assert_array_equal(np.asarray(mask) > 0, expected)
  # The mask that was written is one that can be given.
  given = {'image': one, 'mask': tmp_path / 'out' / 'one_mask.png', **common}
  assert _run(output=tmp_path / 'again', **given) == 0
  assert 'object by mask' in capsys.readouterr().out
  for name in ('one.glb', 'one_mask.png'):
    assert (tmp_path / 'out' / name).read_bytes() == (tmp_path / 'again' / name).read_bytes()
  with pytest.raises(UserError, match='overwrite'):
    _run(output=tmp_path / 'out', **given)
  with pytest.raises(UserError, match='1 files for 2 images'):
    _run(output=tmp_path / 'x', **given | {'image': tmp_path / 'in'})


def test_mirrored_and_carved(tmp_path, workdirs, monkeypatch):
  picture = str(tmp_path / 'a.png')
  image = np.full((160, 160, 3), 245, np.uint8)
  image[30:130, 50:80], image[40:130, 80:110] = (200, 30, 40), (30, 150, 220)
  Image.fromarray(image).save(picture)
  made = []
  monkeypatch.setattr(program.export, 'write_ply', lambda _, voxels, up: made.append(voxels))
  given = {'image': picture, 'output': tmp_path / 'out', 'threshold': 0.5, **workdirs}
  assert _run('--flip', '--carve', **given) == 0
  shape, color = (infer.load(workdirs[kind], kind) for kind in ('shape', 'color'))
  expected = infer.reconstruct(
    photo.load_view(picture), shape=shape, color=color, threshold=0.5, flip=True, carve=True
  )
  np.testing.assert_array_equal(made[0].occupancy, expected.occupancy)
  np.testing.assert_allclose(made[0].color, expected.color, atol=1e-6)
  assert _run(**given) == 0
  assert made[1].occupancy.sum() > made[0].occupancy.sum()
  assert np.abs(made[1].color - made[0].color).max() > 1e-6


def test_nothing_occupied_says_what_the_highest_probability_is(tmp_path, workdirs, capsys):
  picture = _picture(tmp_path / 'a.png', (200, 30, 40))
  output = tmp_path / 'out'
  assert _run(image=picture, output=output, threshold=0.999999, **workdirs) == 1
  assert 'highest probability is 0.' in capsys.readouterr().err
  assert not output.exists()


@pytest.mark.parametrize(
  'name, value',
  [('alpha', 0), ('alpha', 'nan'), ('alpha', 'x'), ('threshold', 1), ('threshold', 'nan')],
)
def test_flags_out_of_range(name, value):
  with pytest.raises(flags.Error, match=name):
    _run(image='a', shape='a', color='a', output='a', **{name: value})


def test_bad_folders_and_names(tmp_path, workdirs):
  picture = _picture(tmp_path / 'in' / 'a.png', (9, 9, 9))
  good = {'image': picture, 'output': tmp_path / 'out', **workdirs}
  with pytest.raises(UserError, match='names no file'):
    _run(**good | {'image': ','})
  with pytest.raises(UserError, match='overwrite'):
    _run(**good | {'output': tmp_path / 'in'})
  with pytest.raises(UserError, match='no training folder'):
    _run(**good | {'shape': tmp_path})
  with pytest.raises(UserError, match='holds a shape network'):
    _run(**good | {'color': workdirs['shape']})


def test_program_ends_in_one_line():
  command = [sys.executable, '-m', 'experiments.reconstruct']
  nothing = [f'--{k}=/nowhere/{k}' for k in ('image', 'shape', 'color', 'output')]
  done = subprocess.run(command + nothing, capture_output=True, text=True)
  assert done.returncode == 1
  assert done.stderr.startswith('error: /nowhere/shape') and done.stderr.count('\n') == 1
