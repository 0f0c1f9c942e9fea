"""The journal: what is told is on disk, and a resumed run forgets what it will tell again."""

import json

import numpy as np
import pytest
from tensorboardX.proto import event_pb2

from cvn.errors import UserError
from experiments.lib import journal


def lines(workdir):
  return [json.loads(line) for line in (workdir / 'log.jsonl').read_text().splitlines()]


def events(workdir):
  """Events of all of TensorBoard's files: length, 4 bytes, the event, 4 bytes; again."""
  found = []
  for path in sorted((workdir / 'tensorboard').iterdir()):
    raw = path.read_bytes()
    while raw:
      length = int.from_bytes(raw[:8], 'little')
      found.append(event_pb2.Event.FromString(raw[12 : 12 + length]))
      raw = raw[16 + length :]
  return found


def test_lines_are_there_at_once(tmp_path):
  with journal.open_journal(str(tmp_path), 0) as log:
    journal.write_line(log, 1, 0.5, {'loss': 2.0, 'iou': 0.25})
    assert lines(tmp_path) == [{'step': 1, 'epoch': 0.5, 'loss': 2.0, 'iou': 0.25}]
    journal.write_line(log, 2, 1.0, {'validation': {'loss': 3.0}})
    assert lines(tmp_path)[1:] == [{'step': 2, 'epoch': 1.0, 'validation': {'loss': 3.0}}]


def test_tensorboard_has_the_same(tmp_path):
  with journal.open_journal(str(tmp_path), 0) as log:
    journal.write_line(log, 1, 0.5, {'loss': 2.0})
    journal.write_line(log, 2, 1.0, {'validation': {'loss': 3.0}})
    journal.write_scalar(log, 2, 'train/images_per_second', 40.0)
    journal.write_picture(log, 2, 'views', np.zeros((4, 6, 3), np.uint8))
    told = [(e.step, v) for e in events(tmp_path) for v in e.summary.value]
  assert [(step, v.tag, v.simple_value) for step, v in told[:3]] == [
    (1, 'train/loss', 2.0),
    (2, 'validation/loss', 3.0),
    (2, 'train/images_per_second', 40.0),
  ]
  assert (told[3][1].tag, told[3][1].image.height, told[3][1].image.width) == ('views', 4, 6)


def test_reopening_drops_what_came_after_the_step(tmp_path):
  with journal.open_journal(str(tmp_path), 0) as log:
    for step in range(1, 6):
      journal.write_line(log, step, step / 5, {'loss': float(step)})
  with journal.open_journal(str(tmp_path), 3) as log:
    assert [line['step'] for line in lines(tmp_path)] == [1, 2, 3]
    journal.write_line(log, 4, 0.8, {'loss': 4.0})
  assert [line['step'] for line in lines(tmp_path)] == [1, 2, 3, 4]
  restarts = [e.step for e in events(tmp_path) if e.HasField('session_log')]
  assert sorted(restarts) == [1, 4]  # TensorBoard hides what was told of these steps before


def test_a_line_cut_off_by_a_sudden_end_is_dropped(tmp_path):
  whole = '{"step": 1, "epoch": 1, "loss": 1}\n'
  for tail in ('{"step": 1, "ep', '{"step": 1, "epoch": 1}', 'not JSON\n', '[]\n', '\0\0\0\n'):
    (tmp_path / 'log.jsonl').write_text(whole + tail)
    with journal.open_journal(str(tmp_path), 5):
      pass
    assert (tmp_path / 'log.jsonl').read_text() == whole


def test_places_that_cannot_be_written(tmp_path):
  (tmp_path / 'tensorboard').write_text('')
  with pytest.raises(UserError, match=r'cannot write .*tensorboard'):
    with journal.open_journal(str(tmp_path), 0):
      pass
  with pytest.raises(UserError, match=r'cannot read .*log\.jsonl: Not a directory'):
    with journal.open_journal(str(tmp_path / 'tensorboard'), 0):
      pass


def test_full_disk(tmp_path):
  """/dev/full takes no byte."""
  with journal.open_journal(str(tmp_path), 0) as log:
    with pytest.raises(UserError, match='cannot write /dev/full: No space left on device'):
      journal.write_line(log._replace(path='/dev/full'), 1, 1.0, {'loss': 1.0})
