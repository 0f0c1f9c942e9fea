"""Folders and archives of strangers: what is in them can be read, and nothing else."""

import os
import pathlib
import socket
import struct
import tracemalloc
import zipfile

import pytest

from cvn.errors import UserError
from datagen.reading import files as files_lib
from datagen.reading.files import archive_files, find, folder_files


@pytest.fixture
def folder(tmp_path):
  (tmp_path / 'in' / 'Models').mkdir(parents=True)
  (tmp_path / 'in' / 'a.obj').write_bytes(b'a')
  (tmp_path / 'in' / 'Models' / 'Größe 1.PNG').write_bytes(b'b')
  (tmp_path / 'secret').write_bytes(b'secret')
  return tmp_path / 'in'


def archive(path, members, method=zipfile.ZIP_DEFLATED):
  with zipfile.ZipFile(path, 'w', method) as z:
    for name, content in members:
      z.writestr(name, content)
  return str(path)


def test_a_folder_and_its_archive_have_the_same_files(folder, tmp_path):
  members = [('Models/', b''), ('Models/Größe 1.PNG', b'b'), ('a.obj', b'a')]
  of_folder = folder_files(str(folder))
  with archive_files(archive(tmp_path / 'a.zip', members)) as of_archive:
    for files in (of_folder, of_archive):
      assert files.names() == ['Models/Größe 1.PNG', 'a.obj']
      assert files.names('Models') == ['Models/Größe 1.PNG']
      assert files.names('gone') == []
      assert files.read('a.obj') == files.read('Models/.././a.obj') == b'a'
      with pytest.raises(FileNotFoundError, match=r'gone\.obj'):
        files.read('gone.obj')
      with pytest.raises(FileNotFoundError):
        files.read('Models')


def test_hidden_files_are_left_out(folder):
  (folder / '.x').mkdir()
  (folder / '.x' / 'b.obj').write_bytes(b'')
  (folder / '.c.obj').write_bytes(b'')
  assert folder_files(str(folder)).names() == ['Models/Größe 1.PNG', 'a.obj']


@pytest.mark.parametrize(
  'name',
  ['Größe 1.PNG', 'größe 1.png', '../models/GRöße 1.PNG', '..\\Models\\größe 1.png'],
)
def test_find_forgives_windows_habits(folder, tmp_path, name):
  assert find(folder_files(str(folder)), 'Models', name) == ('Models/Größe 1.PNG', b'b')
  path = archive(tmp_path / 'a.zip', [('Models/Größe 1.PNG', b'b')])
  with archive_files(path) as files:
    assert find(files, 'Models', name) == ('Models/Größe 1.PNG', b'b')


def test_find_prefers_the_exact_name(folder):
  (folder / 'A.obj').write_bytes(b'A')
  files = folder_files(str(folder))
  assert find(files, '', 'A.obj')[1] == b'A' and find(files, '', 'a.obj')[1] == b'a'


def test_find_lists_no_other_folders(folder, monkeypatch):
  """A texture that is missing must not cost a walk over all models."""
  listed = []
  real = os.listdir
  monkeypatch.setattr(os, 'listdir', lambda path: listed.append(path) or real(path))
  monkeypatch.setattr(os, 'walk', None)
  with pytest.raises(FileNotFoundError):
    find(folder_files(str(folder)), 'Models', 'gone.png')
  assert [os.path.relpath(path, folder) for path in listed] == ['.', 'Models']


@pytest.mark.parametrize(
  'name',
  [
    '../secret',
    'Models/../../secret',
    '..',
    '..\\secret',
    '/etc/passwd',
    'C:\\secret',
    'c:secret',
    'file:///etc/passwd',
    'http://example.org/a.png',
    'a\0.obj',
  ],
)
def test_names_that_lead_out_are_refused(folder, tmp_path, name):
  with archive_files(archive(tmp_path / 'a.zip', [('a.obj', b'a')])) as of_archive:
    for files in (folder_files(str(folder)), of_archive):
      with pytest.raises(UserError, match='leads out of') as e:
        find(files, '', name)
      assert '\n' not in str(e.value)


def test_names_with_colons_are_names(folder):
  (folder / 'Mark 2: red.obj').write_bytes(b'c')
  assert folder_files(str(folder)).read('Mark 2: red.obj') == b'c'


def test_links_must_stay_inside(folder, tmp_path):
  (folder / 'out').symlink_to('../secret')
  (folder / 'out folder').symlink_to('..')
  (folder / 'in').symlink_to('a.obj')
  (folder / 'broken').symlink_to('nowhere')
  (folder / 'loop').symlink_to('loop')
  (tmp_path / 'link').symlink_to('in')
  files = folder_files(str(tmp_path / 'link'))  # the folder itself may be one
  assert files.read('in') == b'a'
  for name in ('out', 'out folder/secret'):
    with pytest.raises(UserError, match='leads out of'):
      files.read(name)
  for name in ('broken', 'loop'):
    with pytest.raises(FileNotFoundError):
      files.read(name)


def test_only_files_are_read(folder):
  """A pipe could be waited for, and a device read, forever."""
  os.mkfifo(folder / 'pipe.obj')
  (folder / 'folder.obj').mkdir()
  here = os.getcwd()
  os.chdir(folder)  # the name of a socket is short
  with socket.socket(socket.AF_UNIX) as s:
    s.bind('socket.obj')
    os.chdir(here)
    for name in ('pipe.obj', 'folder.obj', 'socket.obj'):
      with pytest.raises(FileNotFoundError):
        folder_files(str(folder)).read(name)


@pytest.mark.skipif(os.geteuid() == 0, reason='root may read everything')
def test_files_that_may_not_be_read(folder):
  (folder / 'a.obj').chmod(0)
  with pytest.raises(UserError, match=r'a\.obj.*Permission denied'):
    folder_files(str(folder)).read('a.obj')


def test_large_files_are_refused_unread(folder, tmp_path, monkeypatch):
  monkeypatch.setattr(files_lib, 'MAX_FILE', 1 << 20)
  (folder / 'a.obj').write_bytes(b'')
  os.truncate(folder / 'a.obj', (1 << 20) + 1)
  with pytest.raises(UserError, match=r'a\.obj in .* is larger than 1 MiB'):
    folder_files(str(folder)).read('a.obj')
  path = archive(tmp_path / 'a.zip', [('a.obj', bytes((1 << 20) + 1))])
  assert os.path.getsize(path) < 5000
  with archive_files(path) as files, pytest.raises(UserError, match='larger than 1 MiB'):
    files.read('a.obj')


def test_a_member_does_not_unpack_to_more_than_it_says(tmp_path):
  path = archive(tmp_path / 'a.zip', [('a.obj', bytes(1 << 24))])
  central_directory(path, (24, 28), 10)
  tracemalloc.start()
  with archive_files(path) as files, pytest.raises(UserError, match='damaged'):
    files.read('a.obj')
  assert tracemalloc.get_traced_memory()[1] < 1 << 20
  tracemalloc.stop()


@pytest.mark.parametrize('method', [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_methods_that_make_room_first_are_refused(tmp_path, method):
  """The header of some bytes of LZMA can ask for a dictionary of 4 GiB."""
  path = archive(tmp_path / 'a.zip', [('a.obj', b'')], method)
  with archive_files(path) as files, pytest.raises(UserError, match='not compressed by deflate'):
    files.read('a.obj')


def central_directory(path, at, value):
  """Writes a number into the first entry of an archive's directory."""
  content = bytearray(pathlib.Path(path).read_bytes())
  start = content.index(b'PK\1\2')
  content[start + at[0] : start + at[1]] = value.to_bytes(at[1] - at[0], 'little')
  pathlib.Path(path).write_bytes(content)


@pytest.mark.parametrize(
  ('at', 'value', 'reason'),
  [
    ((24, 28), 10, 'damaged'),  # the size is said to be less than it is
    ((16, 20), 1, 'damaged'),  # the checksum
    ((20, 24), 5, 'damaged'),  # the packed size
    ((42, 46), 7, 'damaged'),  # where it starts
    ((10, 12), 98, 'deflate'),  # how it is packed
    ((8, 10), 1, 'unpacked'),  # encrypted
  ],
)
def test_archives_that_lie(tmp_path, at, value, reason):
  path = archive(tmp_path / 'a.zip', [('a.obj', b'0123456789' * 5000)])
  central_directory(path, at, value)
  with archive_files(path) as files, pytest.raises(UserError, match=reason) as e:
    files.read('a.obj')
  assert 'a.obj' in str(e.value)


def test_members_with_odd_names(tmp_path):
  members = [
    ('../secret.obj', b'1'),
    ('/etc/secret.obj', b'2'),
    ('C:\\secret.obj', b'3'),
    ('x\\y.obj', b'4'),
    ('./z.obj', b'5'),
    ('z//w.obj', b'6'),
  ]
  path = archive(tmp_path / 'a.zip', members)
  with archive_files(path) as files:
    assert files.names() == ['x/y.obj', 'z.obj', 'z/w.obj']
    assert [files.read(name) for name in files.names()] == [b'4', b'5', b'6']


def test_member_without_a_name(tmp_path):
  path = archive(tmp_path / 'a.zip', [('x', b'1'), ('a.obj', b'2')])
  content = pathlib.Path(path).read_bytes()
  (tmp_path / 'b.zip').write_bytes(content.replace(b'x', b'\0'))
  with archive_files(str(tmp_path / 'b.zip')) as files:
    assert files.names() == ['a.obj']


@pytest.mark.filterwarnings('ignore:Duplicate name')
def test_of_members_with_one_name_the_last_counts(tmp_path):
  path = archive(tmp_path / 'a.zip', [('a.obj', b'old'), ('a.obj', b'new')])
  with archive_files(path) as files:
    assert files.names() == ['a.obj'] and files.read('a.obj') == b'new'


def test_links_in_archives_lead_nowhere(tmp_path):
  link = zipfile.ZipInfo('a.obj')
  link.external_attr = 0o120777 << 16
  with zipfile.ZipFile(tmp_path / 'a.zip', 'w') as z:
    z.writestr(link, '/etc/passwd')
  with archive_files(str(tmp_path / 'a.zip')) as files:
    assert files.read('a.obj') == b'/etc/passwd'


def test_what_is_no_archive(tmp_path, monkeypatch):
  plain = archive(tmp_path / 'a.zip', [('a', b''), ('b', b'')])
  (tmp_path / 'b.zip').write_bytes(pathlib.Path(plain).read_bytes()[:-30])
  (tmp_path / 'c.zip').write_bytes(b'')
  (tmp_path / 'd.zip').write_bytes(struct.pack('<4s18x', b'PK\5\6')[:-1])
  for name in ('b.zip', 'c.zip', 'd.zip', 'gone.zip', '.'):
    with pytest.raises(UserError, match='zip archive') as e, archive_files(str(tmp_path / name)):
      pass
    assert '\n' not in str(e.value)
  monkeypatch.setattr(files_lib, 'MAX_MEMBERS', 1)
  with pytest.raises(UserError, match='more than 1 members'), archive_files(plain):
    pass
