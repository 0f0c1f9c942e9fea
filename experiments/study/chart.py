r"""Turns the answers of a user study into the paper's bar chart, with confidence intervals.

python -m experiments.study.chart --results=FILE[,FILE...] --study=DIR [--output=DIR]

--results names the files that the page saved, one a subject, or a folder: of it, all files named
answers_*.json. --study is the folder of experiments.study that the page comes from: its
key.json says which result is whose.

Writes preferences.png and preferences.json to --output, the study's folder by default. A file of
another page, a damaged one, or a second one of the same subject ends the program.
"""

import glob
import json
import os
import re
from collections.abc import Sequence
from typing import Any

import numpy as np
from absl import flags

from cvn import errors
from cvn.errors import UserError
from experiments.lib.stages import read_bytes, read_json
from experiments.study import preferences
from experiments.study.page import ANSWERS_FORMAT, SUBJECT

KEY_ENTRIES = ('page', 'ours', 'titles', 'shapes', 'results', 'pairs')


def define_flags(f: flags.FlagValues) -> None:
  """The program's flags. Not at import: there the names of several programs would collide."""
  own = {'flag_values': f}
  flags.DEFINE_list('results', None, 'Files that the page saved, or folders of them.', **own)
  flags.DEFINE_string('study', None, 'The folder that experiments.study made.', **own)
  flags.DEFINE_string('output', None, 'A folder; that of --study by default.', **own)
  flags.mark_flags_as_required(['results', 'study'], f)


def main(_) -> int:
  return run(flags.FLAGS)


def run(f: flags.FlagValues) -> int:
  """Counts the answers and draws them; returns the exit status."""
  key = read_key(f.study)
  by_subject, files = {}, {}
  for path in find_files(f.results):
    subject, answers = read_answers(path, key)
    if subject in files:
      raise UserError(f'{path} and {files[subject]} are of the same subject {subject}: keep one')
    by_subject[subject], files[subject] = answers, path
  answers = [a for some in by_subject.values() for a in some]
  choices = [to_choice(a, key) for a in answers]
  others = [m for m in key['titles'] if m != key['ours']]
  names = list(dict.fromkeys(s['category'] for s in key['shapes']))
  table = preferences.tabulate(choices, others, names)
  left = preferences.share(sum(a['choice'] == a['left'] for a in answers), len(answers))
  seconds = float(np.median([a['milliseconds'] for a in answers])) / 1000
  count = f'{len(by_subject)} subject{"s" * (len(by_subject) > 1)}, {len(answers)} choices'
  heading = f'{key["titles"][key["ours"]]} preferred'
  print(preferences.format_table(table, key['titles'], heading))
  print(
    f'{count}, {seconds:.1f} s each in the median; the left one was taken in'
    f' {100 * left.share:.0f} % (95 % interval {100 * left.low:.0f} to {100 * left.high:.0f} %)'
  )
  report = {
    'page': key['page'],
    'subjects': sorted(by_subject),
    'ours': key['ours'],
    'titles': key['titles'],
    'preferences': preferences.to_json(table),
    'left_taken': left._asdict(),
    'median_seconds': seconds,
  }
  note = f'{count}; whiskers: 95 % (Wilson), choices taken as independent'
  chart = preferences.draw({'User study': table}, key['titles'], key['ours'], note=note)
  preferences.write(f.output or f.study, 'preferences', report, chart)
  return 0


def read_key(study: str) -> dict[str, Any]:
  """Which result is whose.

  Raises:
    UserError: the folder holds no study.
  """
  path = os.path.join(study, 'key.json')
  if not os.path.exists(path):
    raise UserError(f'{study} has no key.json: name a folder that experiments.study made')
  key = read_json(path)
  if not (isinstance(key, dict) and all(k in key for k in KEY_ENTRIES)):
    raise UserError(f'{path} is no key of a study: make the study again')
  return key


def find_files(names: Sequence[str]) -> list[str]:
  """Files, and what the page saved in folders.

  Raises:
    UserError: a folder holds none.
  """
  found = []
  for name in names:
    inside = [name]
    if os.path.isdir(name):
      inside = sorted(glob.glob(os.path.join(glob.escape(name), 'answers_*.json')))
    if not inside:
      raise UserError(f'{name} holds no file answers_*.json, as the page saves them')
    found += inside
  return found


def read_answers(path: str, key: dict[str, Any]) -> tuple[str, list[dict[str, Any]]]:
  """A subject, and one answer to each pair.

  Raises:
    UserError: they are no answers, damaged, or those to another page.
  """
  try:
    found = json.loads(read_bytes(path))
  except ValueError as e:
    raise UserError(f'{path} is damaged or no file that the page saved: leave it out') from e
  if not isinstance(found, dict) or found.get('format') != ANSWERS_FORMAT:
    raise UserError(f'{path} is no file of answers of format {ANSWERS_FORMAT}: leave it out')
  if found.get('page') != key['page']:
    raise UserError(
      f'{path} is of page {found.get("page")}, --study is page {key["page"]}: leave it out'
    )
  subject, answers = found.get('subject'), found.get('answers')
  if not isinstance(subject, str) or not re.fullmatch(SUBJECT, subject):
    raise UserError(f'{path} is damaged: {subject!r} is no subject')
  answers = answers if isinstance(answers, list) else []
  by_pair = {a['pair']: a for a in answers if isinstance(a, dict) and is_answer(a, key['pairs'])}
  wrong = len(answers) - len(by_pair)
  if wrong or len(by_pair) < len(key['pairs']):
    missing = len(key['pairs']) - len(by_pair)
    raise UserError(
      f'{path} is damaged: of {len(key["pairs"])} pairs {missing} have no answer, and {wrong}'
      ' answers are wrong or double'
    )
  return subject, list(by_pair.values())


def is_answer(answer: dict[str, Any], pairs: dict[str, Sequence[str]]) -> bool:
  """Whether this is a choice between the two results of a pair."""
  sides = [answer.get('left'), answer.get('right')]
  time = answer.get('milliseconds')
  return (
    isinstance(answer.get('pair'), str)
    and all(isinstance(s, str) for s in sides)
    and sorted(sides) == sorted(pairs.get(answer['pair'], ()))
    and answer.get('choice') in sides
    and isinstance(time, int | float)
    and time >= 0
  )


def to_choice(answer: dict[str, Any], key: dict[str, Any]) -> preferences.Choice:
  """What an answer says of methods."""
  methods = {key['results'][answer[side]]['method']: side for side in ('left', 'right')}
  (other,) = methods.keys() - {key['ours']}
  shape = key['shapes'][key['results'][answer['left']]['shape']]
  return preferences.Choice(
    shape['category'], other, answer['choice'] == answer[methods[key['ours']]]
  )


if __name__ == '__main__':
  define_flags(flags.FLAGS)
  errors.run(main)
