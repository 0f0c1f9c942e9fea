"""Another program's command and figure."""

import sys

import pytest

from cvn.errors import UserError
from experiments.perf import peer

FIELDS = {'network': 'shape', 'batch': 12, 'dtype': 'bf16'}


def python(code):
  return [sys.executable, '-c', code]


def test_fields_are_filled_in_word_by_word():
  command = peer.make_command("run 'a b' --net={network} -b {batch} {dtype}", **FIELDS)
  assert command == ['run', 'a b', '--net=shape', '-b', '12', 'bf16']


@pytest.mark.parametrize('template', ['run {net}', 'run {}', 'run {', "run 'a"])
def test_a_template_that_cannot_be_read(template):
  with pytest.raises(UserError, match='its fields are'):
    peer.make_command(template, **FIELDS)


def test_the_last_figure_counts():
  code = "print('warm-up: 1.25 images/s'); print('shape bf16 batch 12: 8.50 images/s')"
  assert peer.measure(python(code)) == 8.5


@pytest.mark.parametrize(
  'code, message',
  [
    ("print('fast')", r"no figure such as '8.5 images/s' \(fast\)"),
    ('', r'no figure .* \(no output\)'),
    ("print('0 images/s')", 'no figure'),
    ("import sys; sys.exit('no memory')", r'status 1 \(no memory\)'),
  ],
)
def test_a_peer_that_says_nothing_or_fails(code, message):
  with pytest.raises(UserError, match=message):
    peer.measure(python(code))


def test_a_peer_that_is_not_there():
  with pytest.raises(UserError, match='cannot be run'):
    peer.measure(['./no-such-program'])
