"""The page as HTML; what it does is tested in a browser."""

import re

import pages
import pytest

from experiments.study import page as user_study_page
from experiments.study.page import SUBJECT, Pair, Sheet, Study

STUDY = Study(
  'Two & <three>.',
  (b'picture',),
  {'r0': Sheet(b'one', 2, 3), 'r1': Sheet(b'two', 2, 3)},
  4,
  2,
  {'p0': Pair(0, ('r0', 'r1'))},
)


def test_page_is_well_formed_and_needs_nothing_from_elsewhere():
  text = user_study_page.render(STUDY)
  tags = pages.check_alone(text)
  assert not [a for _, a in tags if 'src' in a]
  assert 'Two &amp; &lt;three&gt;.' in text
  assert not re.search(r'(?<!\$)\{(style|about|pairs|subject|content|script)\}', text)


def test_another_content_is_another_page():
  name = user_study_page.identify(STUDY)
  assert name == user_study_page.identify(STUDY) and re.fullmatch('[0-9a-f]{12}', name)
  others = [
    STUDY._replace(pictures=(b'other',)),
    STUDY._replace(sheets={**STUDY.sheets, 'r0': Sheet(b'new', 2, 3)}),
    STUDY._replace(pairs={'p1': Pair(0, ('r0', 'r1'))}),
  ]
  assert len({name, *map(user_study_page.identify, others)}) == 4


@pytest.mark.parametrize(
  'subject, fine', [('S-1_b', True), ('', False), ('a b', False), ('é', False)]
)
def test_subjects_make_file_names(subject, fine):
  assert bool(re.fullmatch(SUBJECT, subject)) == fine
