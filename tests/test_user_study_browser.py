"""The study in a real browser: chosen by keys and clicks, reloaded, saved, and counted.

What was on either side is read off the pictures: each method's results are boxes of its own colour.
"""

import collections
import json
import pathlib
import shutil
import time

import numpy as np
import pytest
import studies

from experiments.study import chart as user_study_chart

webdriver = pytest.importorskip('selenium.webdriver', reason='needs selenium')

BROWSER = next(filter(None, map(shutil.which, ('chromium', 'google-chrome', 'chrome'))), None)
DRIVER = shutil.which('chromedriver')
pytestmark = pytest.mark.skipif(
  not (BROWSER and DRIVER), reason='needs a browser: chromium and chromedriver are not installed'
)
PAIRS = 8
OURS = 'blended_0.2'


@pytest.fixture(scope='module')
def study(tmp_path_factory):
  """The folder of a study of 4 shapes."""
  with pytest.MonkeyPatch.context() as monkeypatch:
    return pathlib.Path(
      studies.make_study(tmp_path_factory.mktemp('made'), monkeypatch, '--shapes=2')
    )


@pytest.fixture
def browser(tmp_path):
  """A headless browser that saves to tmp_path/downloads."""
  options = webdriver.ChromeOptions()
  options.binary_location = BROWSER
  for argument in ('--headless=new', '--no-sandbox', '--disable-dev-shm-usage'):
    options.add_argument(argument)
  options.add_argument('--window-size=1280,800')
  options.add_experimental_option(
    'prefs', {'download.default_directory': str(tmp_path / 'downloads')}
  )
  options.set_capability('goog:loggingPrefs', {'browser': 'ALL'})
  driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(DRIVER))
  try:
    yield driver
    severe = [entry for entry in driver.get_log('browser') if entry['level'] == 'SEVERE']
    assert severe == []  # no error, nothing blocked
  finally:
    driver.quit()


class Subject:
  """Sits before the page."""

  def __init__(self, browser, study):
    self.browser = browser
    self.key = json.loads((study / 'key.json').read_text())
    self.chosen = {}  # (picture, other method) -> whether ours was taken
    self.order = []

  def find(self, selector):
    return self.browser.find_element('css selector', selector)

  def press(self, *keys):
    webdriver.ActionChains(self.browser).send_keys(*keys).perform()

  def wait(self, what, seconds=60):
    """Until the function is true."""
    end = time.monotonic() + seconds
    while not what():
      assert time.monotonic() < end, 'the page does not go on'
      time.sleep(0.02)

  def wait_for_pair(self, number):
    self.wait(lambda: self.find('#progress').text == f'{number} of {PAIRS}')

  def look(self):
    """The picture, and the methods left and right.

    Read off the small views: the large one follows them a frame later.
    """
    colors = [
      self.browser.execute_script(
        "const c = document.querySelector(arguments[0] + ' .sides canvas');"
        "return [...c.getContext('2d').getImageData(c.width / 2, c.height / 2, 1, 1).data]",
        side,
      )[:3]
      for side in ('#left', '#right')
    ]
    hues = {m: np.array(c) / max(c) for m, c in studies.COLORS.items()}
    methods = [
      min(hues, key=lambda m: np.abs(hues[m] - np.array(c) / max(c)).sum()) for c in colors
    ]
    return self.find('#picture').get_attribute('src'), *methods

  def choose(self, number, side, *, by):
    """Chooses in the pair of that number, and remembers it."""
    self.wait_for_pair(number)
    picture, *methods = self.look()
    taken = methods[('left', 'right').index(side)]
    (other,) = {*methods} - {OURS}
    self.chosen[picture, other] = taken == OURS
    self.order.append((picture, *methods))
    if by == 'key':
      self.press({'left': webdriver.Keys.ARROW_LEFT, 'right': webdriver.Keys.ARROW_RIGHT}[side])
    else:
      self.find(f'#{side} button').click()

  def save(self, tmp_path):
    """Saves by key; returns the file."""
    before = {*tmp_path.glob('downloads/*.json')}
    self.press(webdriver.Keys.ENTER)  # the button to save has the focus
    self.wait(lambda: {*tmp_path.glob('downloads/*.json')} - before)
    (path,) = {*tmp_path.glob('downloads/*.json')} - before
    return path


def _count(subjects):
  """Shares as the chart program is to find them: {(other, category): [ours, choices]}."""
  found = collections.defaultdict(lambda: [0, 0])
  for subject in subjects:
    pictures = subject.browser.execute_script('return study.pictures')
    for (picture, other), ours in subject.chosen.items():
      shape = subject.key['shapes'][pictures.index(picture.split(',')[1])]
      for name in (shape['category'], 'all'):
        found[other, name][0] += ours
        found[other, name][1] += 1
  return dict(found)


def _aggregate(study, results, output):
  user_study_chart.main([f'--results={results}', f'--study={study}', f'--output={output}'])
  report = json.loads((output / 'preferences.json').read_text())
  return report, {
    (other, name): [share['ours'], share['choices']]
    for other, row in report['preferences'].items()
    for name, share in row.items()
  }


def test_two_subjects_choose_to_the_end(browser, study, tmp_path):
  rng = np.random.default_rng(0)
  first = Subject(browser, study)
  browser.get(f'file://{study / "study.html"}')
  webdriver.ActionChains(browser).key_down(webdriver.Keys.CONTROL).send_keys('a').key_up(
    webdriver.Keys.CONTROL
  ).perform()
  first.press('anna-1', webdriver.Keys.ENTER)
  for number in range(1, PAIRS + 1):
    first.choose(number, rng.choice(['left', 'right']), by='key' if number < 5 else 'click')
    if number == 3:  # has second thoughts
      first.wait_for_pair(4)
      first.press(webdriver.Keys.BACKSPACE)
      first.wait_for_pair(3)
      earlier = first.find('.earlier').get_attribute('id')
      first.order.pop()
      first.choose(3, {'left': 'right', 'right': 'left'}[earlier], by='click')
    if number == 6:
      first.wait_for_pair(7)
      seen = first.look()
      browser.refresh()
      first.wait_for_pair(7)
      assert first.look() == seen and 'anna-1' in first.find('footer').text
  first.wait(lambda: first.find('#end').is_displayed())
  path = first.save(tmp_path)
  assert path.name == f'answers_{first.key["page"]}_anna-1.json'
  report, found = _aggregate(study, path, tmp_path / 'one')
  assert report['subjects'] == ['anna-1'] and found == _count([first])
  assert sum(1 for a, b in zip(first.order, first.order[1:], strict=False) if a[0] == b[0]) == 0

  second = Subject(browser, study)  # on the same computer, without a mouse
  second.find('#next').click()
  second.wait(lambda: second.find('#start').is_displayed())
  name = second.find('#subject').get_attribute('value')
  second.press(webdriver.Keys.ENTER)
  for number in range(1, PAIRS + 1):
    second.choose(number, rng.choice(['left', 'right']), by='key')
  second.wait(lambda: second.find('#end').is_displayed())
  second.save(tmp_path)
  report, found = _aggregate(study, tmp_path / 'downloads', tmp_path / 'both')
  assert report['subjects'] == sorted(['anna-1', name]) and found == _count([first, second])
  assert second.order != first.order and sorted(c[0] for c in second.order) == sorted(
    c[0] for c in first.order
  )
  sides = [{(c[0], *sorted(c[1:])): c[1] for c in s.order} for s in (first, second)]
  assert sides[0] != sides[1]


def test_models_turn_together_and_stop_on_demand(browser, study):
  subject = Subject(browser, study)
  browser.get(f'file://{study / "study.html"}')
  subject.press(webdriver.Keys.ENTER)
  subject.wait_for_pair(1)
  turn = lambda: browser.execute_script('return Math.floor(position)')  # noqa: E731
  start = turn()
  subject.wait(lambda: turn() != start)  # by itself
  subject.press(webdriver.Keys.ARROW_UP)
  stopped = turn()
  subject.press(webdriver.Keys.ARROW_DOWN)
  assert turn() == (stopped - 1) % studies.FRAMES
  handle = subject.find('#left .turntable')
  webdriver.ActionChains(browser).drag_and_drop_by_offset(handle, 60, 0).perform()
  dragged = turn()
  assert dragged != (stopped - 1) % studies.FRAMES
  time.sleep(0.5)
  assert turn() == dragged
  subject.find('#right .sides canvas:nth-child(3)').click()
  assert turn() == studies.FRAMES // 2
  subject.press(webdriver.Keys.SPACE)
  subject.wait(lambda: turn() != studies.FRAMES // 2)
  assert subject.find('#progress').text == f'1 of {PAIRS}'  # nothing was chosen by all that


def test_a_subject_needs_a_proper_code_and_may_start_over(browser, study):
  subject = Subject(browser, study)
  browser.get(f'file://{study / "study.html"}')
  field = subject.find('#subject')
  field.clear()
  field.send_keys('a/b', webdriver.Keys.ENTER)
  assert subject.find('#start').is_displayed()
  field.clear()
  field.send_keys('b', webdriver.Keys.ENTER)
  subject.choose(1, 'left', by='key')
  subject.wait_for_pair(2)
  subject.find('#reset').click()
  browser.switch_to.alert.accept()
  subject.wait(lambda: subject.find('#start').is_displayed())


def test_page_is_readable_without_scrolling_and_names_no_method(browser, study):
  subject = Subject(browser, study)
  browser.get(f'file://{study / "study.html"}')
  subject.press(webdriver.Keys.ENTER)
  subject.wait_for_pair(1)
  height = browser.execute_script('return document.documentElement.scrollHeight - innerHeight')
  assert height <= 0
  text = browser.execute_script('return document.body.innerText').lower()
  assert not any(title.lower() in text for title in subject.key['titles'].values())
  assert 'blended' not in text and 'regression' not in text
