"""Scenes without end, or that pretend to be more than there is, are refused unread."""

import time

import pytest

from cvn.errors import UserError
from datagen.reading.headers import check_dae, count_instances


def dae(nodes, declaration=''):
  return f'<?xml version="1.0"?>{declaration}<c:COLLADA xmlns:c="x">{nodes}</c:COLLADA>'.encode()


def test_counts_each_use():
  children = {'a': ['b', 'b', 'c'], 'b': ['c'] * 10}
  assert count_instances(children, {'c': 1}) == 21
  assert count_instances(children, {'c': 1, 'a': 5, 'alone': 3}) == 26
  assert count_instances({}, {}) == 0


def test_counts_quickly():
  """Ten nodes ten times below one another, thirty times; a chain of many."""
  start = time.process_time()
  assert count_instances({i: [i + 1] * 10 for i in range(30)}, {30: 1}) == 10**30
  assert count_instances({i: [i + 1] for i in range(100_000)}, {100_000: 1}) == 1
  assert time.process_time() - start < 5


@pytest.mark.parametrize(
  'children', [{0: [0]}, {0: [1], 1: [2], 2: [1]}, {5: [], 0: [1, 1], 1: [0]}]
)
def test_scenes_without_end(children):
  with pytest.raises(UserError, match='no end'):
    count_instances(children, {})


def test_dae_that_is_right():
  check_dae(dae('<c:node id="a"><node><instance_geometry url="#g"/></node></c:node>' * 2))


LAUGHS = ''.join(
  f'<node id="k{i}">' + f'<instance_node url="#k{i + 1}"/>' * 10 + '</node>' for i in range(8)
)


@pytest.mark.parametrize(
  ('content', 'reason'),
  [
    (dae('<node id="a"><instance_node url="#a"/></node>'), 'no end'),
    (dae('<c:node id="a"><node><c:instance_node url="#a"/></node></c:node>'), 'no end'),
    (
      dae(LAUGHS + '<node id="k8"><instance_geometry url="#g"/></node>'),
      '111111111 parts',
    ),
    (dae('<node>' * 300 + '</node>' * 300), 'nested'),
    (dae('&a;', '<!DOCTYPE c [<!ENTITY a "b">]>'), 'DOCTYPE'),
    (dae('', '<!DOCTYPE c SYSTEM "file:///etc/passwd">'), 'DOCTYPE'),
    (dae('', '<!DOCTYPE c>').decode().encode('utf-16'), 'DOCTYPE'),
  ],
)
def test_dae_that_is_refused(content, reason):
  with pytest.raises(UserError, match=reason):
    check_dae(content)


def test_dae_in_an_encoding_that_could_hide_a_doctype():
  content = b'<?xml version="1.0" encoding="utf-7"?>+ADw-!DOCTYPE c+AD4-<c/>'
  with pytest.raises(ValueError, match='encodings'):
    check_dae(content)
