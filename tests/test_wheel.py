"""Wheels carry compiled kernels; sdists, editable installs and builds without a compiler do not."""

import base64
import csv
import hashlib
import importlib.util
import os
import pathlib
import platform
import shutil
import subprocess
import sys
import tarfile
import zipfile

import numpy as np
import pytest

from cvn.ops import compile as compiling

ROOT = pathlib.Path(__file__).parent.parent
PACKAGES = ('cvn', 'datagen', 'experiments')
DOCUMENTS = ('CHANGELOG.md', 'CITATION.cff', 'LICENSE', 'README.md')
FILES = ('pyproject.toml', 'build_backend.py', 'MANIFEST.in', *DOCUMENTS)
SHIPPED = 'cvn/ops/shipped/'


def read_backend(folder):
  """The build backend's module, with a folder's sources."""
  spec = importlib.util.spec_from_file_location('build_backend', folder / 'build_backend.py')
  module = importlib.util.module_from_spec(spec)
  spec.loader.exec_module(module)
  return module


def copy_sources(folder):
  """A copy of what an sdist is made of, so that a build leaves nothing in the project's folder."""
  for name in FILES:
    shutil.copy(ROOT / name, folder)
  for name in PACKAGES:
    shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns('__pycache__'))
  return folder


def run_hook(sources, hook, output, **environment):
  """Runs a hook of the backend as a build program does; returns its result and standard error."""
  code = f'import build_backend; print(build_backend.{hook}({str(output)!r}))'
  done = subprocess.run(
    [sys.executable, '-c', code],
    cwd=sources,
    env=os.environ | environment,
    capture_output=True,
    text=True,
    timeout=600,
  )
  assert done.returncode == 0, done.stderr
  return output / done.stdout.splitlines()[-1], done.stderr


def check_record(wheel):
  """Every file of a wheel is in its RECORD, with its hash and size."""
  with zipfile.ZipFile(wheel) as f:
    (record,) = (name for name in f.namelist() if name.endswith('.dist-info/RECORD'))
    rows = {row[0]: row[1:] for row in csv.reader(f.read(record).decode().splitlines())}
    assert rows.pop(record) == ['', '']
    assert sorted([*rows, record]) == sorted(f.namelist())
    for name, (digest, size) in rows.items():
      data = f.read(name)
      expected = base64.urlsafe_b64encode(hashlib.sha256(data).digest()).rstrip(b'=').decode()
      assert (digest, int(size)) == (f'sha256={expected}', len(data))


def test_without_a_compiler_the_wheel_is_for_any_machine(tmp_path):
  sources = copy_sources(tmp_path)
  wheel, errors = run_hook(sources, 'build_wheel', tmp_path, CXX='no-such-compiler')
  assert wheel.name == 'cvn-0.1.0-py3-none-any.whl'
  told = [line for line in errors.splitlines() if line.startswith('cvn:')]
  assert len(told) == 1 and 'no C++ compiler: no-such-compiler' in told[0]
  with zipfile.ZipFile(wheel) as f:
    names = f.namelist()
    (entries,) = (name for name in names if name.endswith('.dist-info/entry_points.txt'))
    assert 'cvn-train = experiments.commands:train' in f.read(entries).decode().splitlines()
  packages = (f for name in PACKAGES for f in (sources / name).rglob('*'))
  files = {f.relative_to(sources).as_posix() for f in packages if f.is_file()}
  assert files == {name for name in names if '.dist-info/' not in name}
  assert 'cvn/ops/kernels/kernels.cc' in files
  assert not [name for name in names if name.endswith('.so')]


def test_sdists_and_editable_installs_compile_nothing(tmp_path):
  sources = copy_sources(tmp_path)
  sdist, errors = run_hook(sources, 'build_sdist', tmp_path)
  assert 'cvn:' not in errors
  with tarfile.open(sdist) as f:
    names = [name.split('/', 1)[-1] for name in f.getnames()]
  assert {'build_backend.py', 'cvn/ops/kernels/kernels.cc', *DOCUMENTS} <= {*names}
  assert not [name for name in names if name.endswith('.so')]
  editable, errors = run_hook(sources, 'build_editable', tmp_path)
  assert 'cvn:' not in errors
  with zipfile.ZipFile(editable) as f:
    assert not [name for name in f.namelist() if name.endswith('.so')]


def test_only_wheels_need_headers(monkeypatch):
  backend = read_backend(ROOT)
  for kind in ('wheel', 'editable'):
    monkeypatch.setattr(backend.build_meta, f'get_requires_for_build_{kind}', lambda _: ['other'])
  assert backend.get_requires_for_build_wheel() == ['other', backend.HEADERS]
  assert backend.get_requires_for_build_editable() == ['other']


def test_a_target_that_does_not_compile_is_left_out(tmp_path, monkeypatch, capsys):
  backend = read_backend(ROOT)
  compiler = tmp_path / 'c++'
  compiler.write_text(
    """#!/bin/sh
case "$*" in
  *-dumpmachine*) echo x86_64-linux-gnu; exit;;
  *-mamx-tile*) echo 'error: unrecognized option -mamx-tile' >&2; exit 1;;
esac
while [ "$1" != -o ]; do shift; done
echo library > "$2"
"""
  )
  compiler.chmod(0o755)
  monkeypatch.setenv('CXX', str(compiler))
  monkeypatch.chdir(ROOT)
  machine, libraries = backend.compile_kernels(tmp_path / 'shipped')
  targets = ['x86-64-v3', 'x86-64-v4', 'x86-64-v4-bf16']
  assert machine == 'x86_64' and [f.name for f in libraries] == [
    f'kernels-{target}.so' for target in targets
  ]
  (line,) = capsys.readouterr().err.splitlines()
  assert line.startswith('cvn: ') and 'sapphirerapids' in line and '-mamx-tile' in line


def test_libraries_make_a_wheel_for_one_platform(tmp_path):
  backend = read_backend(ROOT)
  old, new = tmp_path / 'old.whl', tmp_path / 'new.whl'
  with zipfile.ZipFile(old, 'w') as f:
    f.writestr('cvn/__init__.py', '')
    f.writestr('cvn-1.dist-info/WHEEL', 'Root-Is-Purelib: true\nTag: py3-none-any\n')
    f.writestr('cvn-1.dist-info/RECORD', '')
  libraries = [tmp_path / f'kernels-{name}.so' for name in ('x86-64-v3', 'x86-64-v4')]
  libraries[0].write_bytes(b'\0GLIBC_2.2.5\0GLIBC_2.14\0')
  libraries[1].write_bytes(b'\0GLIBC_2.34\0GLIBC_2.3\0 GLIBC_2.99')
  assert backend.glibc_minor(libraries) == 34
  assert backend.glibc_minor(libraries[:1]) == 17
  backend.add_libraries(old, new, libraries, tag='manylinux_2_34_x86_64')
  check_record(new)
  with zipfile.ZipFile(new) as f:
    assert f.read('cvn-1.dist-info/WHEEL').decode() == (
      'Root-Is-Purelib: false\nTag: py3-none-manylinux_2_34_x86_64\n'
    )
    assert f.read(SHIPPED + libraries[0].name) == libraries[0].read_bytes()
    assert f.namelist()[-1].endswith('RECORD')


def test_a_compiler_for_another_system_is_refused(tmp_path):
  backend = read_backend(ROOT)
  compiler = tmp_path / 'c++'
  for machine, expected in (
    ('x86_64-linux-gnu', 'x86_64'),
    ('aarch64-unknown-linux-gnu', 'aarch64'),
    ('x86_64-alpine-linux-musl', None),
    ('arm64-apple-darwin23.1.0', None),
    ('x86_64-w64-mingw32', None),
  ):
    compiler.write_text(f'#!/bin/sh\necho {machine}\n')
    compiler.chmod(0o755)
    if expected:
      assert backend.target_machine(str(compiler)) == expected
    else:
      with pytest.raises(OSError, match=machine):
        backend.target_machine(str(compiler))


def test_headers_of_a_later_interface_are_refused(monkeypatch):
  backend = read_backend(ROOT)
  monkeypatch.setattr(backend, 'INTERFACE', (0, 0))
  with pytest.raises(OSError, match='later jaxlib'):
    backend.find_headers()


GRADIENT = """
import os, sys, jax, jax.numpy as jnp
from cvn import layers
from cvn.ops import deconv, native
key = jax.random.key(0)
x, scale, shift, activation = layers.as_pending(jax.random.normal(key, (2, 3, 4, 5, 6)))
kernel = jax.random.normal(key, (3, 3, 3, 6, 8))
gradient = jax.grad(lambda k: (deconv.deconv(x, scale, shift, k, activation)[0] ** 2).sum())(kernel)
jnp.save(sys.argv[1], gradient)
library = native.library()
print(library and (library.origin, str(library.path)))
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != 'linux', reason='wheels carry kernels for Linux')
def test_an_installed_wheel_needs_no_compiler(tmp_path):
  """The best library of the wheel is loaded, and its gradient is that of the plain products."""
  try:
    compiling.find_compiler()
  except FileNotFoundError:
    pytest.skip('no C++ compiler here')
  (tmp_path / 'sources').mkdir()
  sources = copy_sources(tmp_path / 'sources')
  command = [sys.executable, '-m', 'pip', 'wheel', '--no-deps', '--no-build-isolation']
  subprocess.run([*command, '--wheel-dir', tmp_path, sources], check=True, timeout=600)
  (wheel,) = tmp_path.glob('*.whl')
  assert wheel.name.startswith('cvn-0.1.0-py3-none-manylinux_2_')
  assert wheel.name.endswith(f'_{platform.machine()}.whl')
  check_record(wheel)

  environment = tmp_path / 'environment'
  subprocess.run([sys.executable, '-m', 'venv', '--without-pip', environment], check=True)
  python = environment / 'bin' / 'python'
  command = [sys.executable, '-m', 'pip', '--python', python, 'install', '--no-deps', '--no-index']
  subprocess.run([*command, wheel], check=True, timeout=120)
  (site,) = environment.glob('lib/python3*/site-packages')
  others = pathlib.Path(np.__file__).parent.parent  # jax and what it needs
  (site / 'others.pth').write_text(f'{others}\n')

  def run(name, **settings):
    settings |= {'PATH': str(tmp_path), 'XDG_CACHE_HOME': str(tmp_path / 'cache')}
    done = subprocess.run(
      [python, '-c', GRADIENT, tmp_path / name],
      env={k: v for k, v in os.environ.items() if k not in ('PYTHONPATH', 'CXX')} | settings,
      cwd=tmp_path,
      capture_output=True,
      text=True,
      timeout=300,
    )
    assert done.returncode == 0 and not done.stderr, done.stderr
    return done.stdout.strip(), np.load(tmp_path / name)

  loaded, gradient = run('shipped.npy')
  best = compiling.usable_targets()[0]
  assert loaded == str(('shipped', str(site / SHIPPED / f'kernels-{best}.so')))
  plain, expected = run('plain.npy', CVN_KERNELS='off')
  assert plain == 'None'
  np.testing.assert_allclose(gradient, expected, rtol=1e-4, atol=1e-4 * np.abs(expected).max())
  for target in compiling.usable_targets():
    named = site / SHIPPED / f'kernels-{target}.so'
    loaded, gradient = run(f'{target}.npy', CVN_KERNELS=str(named))
    assert loaded == str(('named', str(named)))
    np.testing.assert_allclose(gradient, expected, rtol=1e-4, atol=1e-4 * np.abs(expected).max())
