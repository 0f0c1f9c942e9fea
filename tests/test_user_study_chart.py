"""From files of answers to shares; files that must not count."""

import json

import markdown_cells
import pytest

from cvn.errors import UserError
from experiments.study import chart as user_study_chart

KEY = {
  'page': 'abc',
  'ours': 'o',
  'titles': {'o': 'Ours', 'x': 'X', 'y': 'Y'},
  'shapes': [{'category': 'car'}, {'category': 'chair'}],
  'results': {
    'r0': {'shape': 0, 'method': 'o'},
    'r1': {'shape': 0, 'method': 'x'},
    'r2': {'shape': 0, 'method': 'y'},
    'r3': {'shape': 1, 'method': 'x'},
    'r4': {'shape': 1, 'method': 'o'},
    'r5': {'shape': 1, 'method': 'y'},
  },
  'pairs': {'p0': ['r0', 'r1'], 'p1': ['r0', 'r2'], 'p2': ['r3', 'r4'], 'p3': ['r4', 'r5']},
}


def _answers(subject, chosen, **changes):
  """Answers that take `chosen`, which is on the left in every second pair."""
  answers = []
  for n, (pair, choice) in enumerate(zip(KEY['pairs'], chosen, strict=True)):
    (other,) = {*KEY['pairs'][pair]} - {choice}
    left, right = (choice, other) if n % 2 else (other, choice)
    answers.append(
      {'pair': pair, 'left': left, 'right': right, 'choice': choice, 'milliseconds': 1000 * n}
    )
  return {'format': 1, 'page': 'abc', 'subject': subject, 'seed': 5, 'answers': answers} | changes


def _write(tmp_path, **files):
  folder = tmp_path / 'study'
  folder.mkdir(exist_ok=True)
  (folder / 'key.json').write_text(json.dumps(KEY))
  results = tmp_path / 'results'
  results.mkdir(exist_ok=True)
  for name, content in files.items():
    text = content if isinstance(content, str) else json.dumps(content)
    (results / f'{name}.json').write_text(text)
  return results


def _run(tmp_path, results, *more):
  user_study_chart.main([f'--results={results}', f'--study={tmp_path / "study"}', *more])


def test_choices_become_shares_of_ours(tmp_path, capsys):
  results = _write(
    tmp_path,
    answers_1=_answers('S1', ['r0', 'r0', 'r4', 'r5']),
    answers_2=_answers('S2', ['r1', 'r0', 'r4', 'r4']),
    notes='no answers, and not named so',
  )
  _run(tmp_path, results)
  report = json.loads((tmp_path / 'study' / 'preferences.json').read_text())
  found = {
    (other, name): (s['ours'], s['choices'])
    for other, row in report['preferences'].items()
    for name, s in row.items()
  }
  assert found == {
    ('x', 'car'): (1, 2),
    ('x', 'chair'): (2, 2),
    ('x', 'all'): (3, 4),
    ('y', 'car'): (2, 2),
    ('y', 'chair'): (1, 2),
    ('y', 'all'): (3, 4),
  }
  assert report['subjects'] == ['S1', 'S2'] and report['left_taken']['share'] == 0.5
  assert report['median_seconds'] == 1.5
  assert (tmp_path / 'study' / 'preferences.png').stat().st_size > 1000
  (table,) = markdown_cells.read(capsys.readouterr().out)
  assert table[3] == ['X', 'all', '75.0 %', '30 to 95 %', '3 of 4']


def test_files_can_be_named_one_by_one(tmp_path):
  results = _write(tmp_path, one=_answers('S1', ['r0', 'r0', 'r4', 'r4']))
  output = tmp_path / 'chart'
  _run(tmp_path, results / 'one.json', f'--output={output}')
  report = json.loads((output / 'preferences.json').read_text())
  assert report['preferences']['x']['all']['share'] == 1


def _changed(n, **changes):
  """Good answers with one that is not."""
  good = _answers('S1', ['r0', 'r0', 'r4', 'r4'])
  good['answers'][n] |= changes
  return good


GOOD = _answers('S1', ['r0', 'r0', 'r4', 'r4'])


@pytest.mark.parametrize(
  'content, message',
  [
    ('{"format": 1, "page', 'damaged'),
    ('\udcff'.encode('utf-8', 'surrogateescape').decode('latin-1'), 'damaged'),
    ('[]', 'not a file of answers'),
    (GOOD | {'format': 2}, 'not a file of answers'),
    (GOOD | {'page': 'other'}, 'is of page other, --study is page abc'),
    (GOOD | {'subject': 'a b'}, "'a b' is not a subject"),
    (GOOD | {'subject': None}, 'None is not a subject'),
    (GOOD | {'answers': GOOD['answers'][:-1]}, '1 have no answer, and 0'),
    (GOOD | {'answers': GOOD['answers'] + GOOD['answers'][:1]}, '0 have no answer, and 1'),
    (GOOD | {'answers': None}, '4 have no answer'),
    (GOOD | {'answers': [1, 2, 3, 4]}, '4 have no answer, and 4'),
    (_changed(0, choice='r2'), '1 have no answer, and 1'),  # was not shown
    (_changed(0, left='r2'), '1 have no answer, and 1'),  # no such pair
    (_changed(0, left=['r0']), '1 have no answer, and 1'),
    (_changed(0, pair='p9'), '1 have no answer, and 1'),
    (_changed(0, pair={}), '1 have no answer, and 1'),
    (_changed(0, milliseconds=-1), '1 have no answer, and 1'),
    (_changed(0, milliseconds='long'), '1 have no answer, and 1'),
  ],
)
def test_files_that_must_not_count(tmp_path, content, message):
  results = _write(tmp_path, answers_0=_answers('S0', ['r0', 'r0', 'r4', 'r4']), answers_1=content)
  with pytest.raises(UserError, match=message) as caught:
    _run(tmp_path, results)
  assert 'answers_1.json' in str(caught.value)
  assert not (tmp_path / 'study' / 'preferences.json').exists()


def test_a_subject_counts_once(tmp_path):
  results = _write(tmp_path, answers_1=GOOD, answers_2=GOOD)
  with pytest.raises(UserError, match='same subject S1: keep one'):
    _run(tmp_path, results)


def test_no_files(tmp_path):
  results = _write(tmp_path)
  with pytest.raises(UserError, match=r'holds no file answers_\*.json'):
    _run(tmp_path, results)
  with pytest.raises(UserError, match=r'cannot read .*missing\.json'):
    _run(tmp_path, results / 'missing.json')


def test_no_study(tmp_path):
  results = _write(tmp_path, answers_1=GOOD)
  key = tmp_path / 'study' / 'key.json'
  key.write_text('{}')
  with pytest.raises(UserError, match='is not the key of a study'):
    _run(tmp_path, results)
  key.unlink()
  with pytest.raises(UserError, match=r'has no key\.json'):
    _run(tmp_path, results)
