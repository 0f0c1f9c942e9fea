"""Files appear whole or not at all; errors print as one line."""

import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from cvn import files
from cvn.errors import UserError


def test_writes_and_makes_the_folder(tmp_path):
  path = tmp_path / 'new' / 'a.txt'
  with files.atomic_write(str(path)) as temporary:
    assert os.path.dirname(temporary) == str(path.parent)
    assert temporary.endswith('.txt')
    with open(temporary, 'w') as f:
      f.write('whole')
    assert not path.exists()
  assert path.read_text() == 'whole'
  assert os.listdir(path.parent) == ['a.txt']


def test_error_leaves_the_old_file_and_nothing_else(tmp_path):
  path = tmp_path / 'a.txt'
  path.write_text('old')
  with pytest.raises(RuntimeError), files.atomic_write(str(path)) as temporary:
    with open(temporary, 'w') as f:
      f.write('half')
    raise RuntimeError
  assert path.read_text() == 'old'
  assert os.listdir(tmp_path) == ['a.txt']


def test_a_name_without_a_folder_is_in_the_current_one(tmp_path, monkeypatch):
  monkeypatch.chdir(tmp_path)
  with files.atomic_write('a.txt') as temporary, open(temporary, 'w') as f:
    f.write('here')
  assert (tmp_path / 'a.txt').read_text() == 'here'


def test_others_may_read_the_file(tmp_path):
  path = tmp_path / 'a.txt'
  with files.atomic_write(str(path)):
    pass
  assert path.stat().st_mode & 0o777 == 0o644


def test_a_file_where_a_folder_is_due(tmp_path):
  (tmp_path / 'file').write_text('')
  with pytest.raises(UserError, match=r'cannot write .*file/a\.txt'):
    with files.atomic_write(str(tmp_path / 'file' / 'a.txt')):
      pass


def test_a_folder_where_the_file_is_due(tmp_path):
  (tmp_path / 'a.txt').mkdir()
  with pytest.raises(UserError, match=r'cannot write .*a\.txt'):
    with files.atomic_write(str(tmp_path / 'a.txt')):
      pass
  assert os.listdir(tmp_path) == ['a.txt']


def test_no_space_is_a_user_error(tmp_path):
  with pytest.raises(UserError, match='No space left'):
    with files.atomic_write(str(tmp_path / 'a.txt')):
      raise OSError(28, 'No space left on device')
  assert os.listdir(tmp_path) == []


PROGRAM = """
from cvn import errors
def main(argv):
  {body}
errors.run(main)
"""


def run(body, *arguments):
  return subprocess.run(
    [sys.executable, '-c', PROGRAM.format(body=body), *arguments],
    capture_output=True,
    text=True,
    check=False,
  )


def test_user_error_is_one_line_and_status_1():
  done = run("raise errors.UserError('no such\\nfile: x')")
  assert (done.returncode, done.stderr, done.stdout) == (1, 'error: no such file: x\n', '')


def test_interrupt_is_one_line_and_status_1():
  done = run('raise KeyboardInterrupt')
  assert (done.returncode, done.stderr) == (1, 'interrupted\n')


def test_the_status_main_returns():
  assert run('return 3').returncode == 3
  assert run('return None').returncode == 0


def test_stray_argument_is_refused():
  done = run('return 0', 'data')
  assert done.returncode != 0
  assert "unexpected argument: 'data'" in done.stdout + done.stderr
  assert 'Traceback' not in done.stdout + done.stderr


def test_a_lock_lets_one_in_at_a_time(tmp_path):
  inside, most = [], []

  def work(n):
    with files.locked(tmp_path / 'new' / 'lock'):
      inside.append(n)
      most.append(len(inside))
      time.sleep(0.05)
      inside.remove(n)

  with ThreadPoolExecutor(3) as executor:
    list(executor.map(work, range(3)))
  assert most == [1, 1, 1] and os.listdir(tmp_path / 'new') == ['lock']


def test_a_lock_is_not_waited_for_for_ever(tmp_path):
  with files.locked(tmp_path / 'lock'):
    before = time.monotonic()
    with files.locked(tmp_path / 'lock', seconds=0.2):
      assert 0.2 <= time.monotonic() - before < 30


def test_a_lock_that_cannot_be_made_locks_nothing(tmp_path):
  (tmp_path / 'file').write_text('')
  with files.locked(tmp_path / 'file' / 'lock'):
    assert os.listdir(tmp_path) == ['file']
  with pytest.raises(OSError, match='of the body'), files.locked(tmp_path / 'lock'):
    raise OSError('of the body')
