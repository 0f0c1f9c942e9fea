r"""Turns the answers of a user study into the paper's bar chart with confidence intervals.

python -m experiments.study.chart --results=FILE[,FILE...] --study=DIR [--output=DIR]

--results names the files that the page saved, one for each subject, or a folder of files
answers_*.json. --study is the folder of experiments.study that the page comes from; its key.json
says which result belongs to which method.

The program writes preferences.png and preferences.json to --output, the study's folder by default.
A damaged file, a file of another page, or a second file of the same subject is an error.
"""

import glob
import json
import os
import re
from collections.abc import Sequence
from typing import Any

import numpy as np
from absl import flags

from cvn.errors import UserError
from cvn.files import atomic_write
from experiments.lib import cli
from experiments.lib.stages import read_bytes, read_json, write_results
from experiments.study import preferences
from experiments.study.page import ANSWERS_FORMAT, SUBJECT

KEY_ENTRIES = ('page', 'ours', 'titles', 'shapes', 'results', 'pairs')


def define_flags(f: flags.FlagValues) -> None:
  own = {'flag_values': f}
  flags.DEFINE_list('results', None, 'Files that the page saved, or folders of them.', **own)
  flags.DEFINE_string('study', None, 'Folder of experiments.study.', **own)
  flags.DEFINE_string('output', None, 'A folder; that of --study by default.', **own)
  flags.mark_flags_as_required(['results', 'study'], f)


@cli.program(define_flags, computes=False)
def main(f: flags.FlagValues) -> None:
  make_chart(f.results, f.study, f.output or f.study)


def make_chart(results: Sequence[str], study: str, output: str) -> None:
  """Counts the answers, prints, draws and writes the shares.

  Args:
    results: files of answers, or folders of them.
    study: the folder of experiments.study.
    output: the folder of the chart.

  Raises:
    UserError: a file must not count; see the module's docstring.
  """
  key = read_key(study)
  by_subject, files = {}, {}
  for path in find_files(results):
    subject, answers = read_answers(path, key)
    if subject in files:
      raise UserError(f'{path} and {files[subject]} are of the same subject {subject}: keep one')
    by_subject[subject], files[subject] = answers, path
  answers = [a for some in by_subject.values() for a in some]
  others = [m for m in key['titles'] if m != key['ours']]
  names = list(dict.fromkeys(s['category'] for s in key['shapes']))
  table = preferences.tabulate([to_choice(a, key) for a in answers], others, names)
  left = preferences.share(sum(a['choice'] == a['left'] for a in answers), len(answers))
  seconds = float(np.median([a['milliseconds'] for a in answers])) / 1000
  count = f'{len(by_subject)} subject{"s" * (len(by_subject) > 1)}, {len(answers)} choices'
  print(preferences.to_markdown(table, key['titles'], key['ours']))
  print(
    f'\n{count}, median {seconds:.1f} s each; the left one was chosen in {100 * left.share:.0f} %'
    f' (95 % interval {100 * left.low:.0f} to {100 * left.high:.0f} %)'
  )
  report = {
    'page': key['page'],
    'subjects': sorted(by_subject),
    'ours': key['ours'],
    'titles': key['titles'],
    'preferences': table,
    'left_taken': left,
    'median_seconds': seconds,
  }
  note = f'{count}; whiskers: 95 % (Wilson), choices treated as independent'
  chart = preferences.draw(table, key['titles'], key['ours'], note=note)
  stem = os.path.join(output, 'preferences')
  write_results(f'{stem}.json', report)
  with atomic_write(f'{stem}.png') as temporary:
    chart.savefig(temporary, dpi=150, metadata={'Software': None})
  print(f'{stem}.png, {stem}.json')


def read_key(study: str) -> dict[str, Any]:
  """Which result belongs to which method.

  Raises:
    UserError: the folder holds no study.
  """
  path = os.path.join(study, 'key.json')
  if not os.path.exists(path):
    raise UserError(f'{study} has no key.json: name a folder that experiments.study made')
  key = read_json(path)
  if not (isinstance(key, dict) and all(k in key for k in KEY_ENTRIES)):
    raise UserError(f'{path} is not the key of a study: make the study again')
  return key


def find_files(names: Sequence[str]) -> list[str]:
  """The files, and the files of answers in the folders.

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
  """A subject, and one answer for each pair.

  Raises:
    UserError: the file is damaged, of another page, or not a file of answers.
  """
  try:
    found = json.loads(read_bytes(path))
  except ValueError as e:
    raise UserError(f'{path} is damaged or was not saved by the page: leave it out') from e
  if not isinstance(found, dict) or found.get('format') != ANSWERS_FORMAT:
    raise UserError(f'{path} is not a file of answers of format {ANSWERS_FORMAT}: leave it out')
  if found.get('page') != key['page']:
    raise UserError(
      f'{path} is of page {found.get("page")}, --study is page {key["page"]}: leave it out'
    )
  subject, answers = found.get('subject'), found.get('answers')
  if not isinstance(subject, str) or not re.fullmatch(SUBJECT, subject):
    raise UserError(f'{path} is damaged: {subject!r} is not a subject')
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
  """An answer as a choice between methods."""
  methods = {key['results'][answer[side]]['method']: side for side in ('left', 'right')}
  (other,) = methods.keys() - {key['ours']}
  shape = key['shapes'][key['results'][answer['left']]['shape']]
  return preferences.Choice(
    shape['category'], other, answer['choice'] == answer[methods[key['ours']]]
  )


if __name__ == '__main__':
  main()
