"""The viewer of GLB files: what it puts into a page, and what a real browser makes of that."""

import base64
import gzip
import re
import shutil

import numpy as np
import pages
import pytest

from cvn import export, grid
from experiments.lib import page, viewer

webdriver = pytest.importorskip('selenium.webdriver', reason='needs selenium')
support = pytest.importorskip('selenium.webdriver.support.ui')
BROWSER = next(filter(None, map(shutil.which, ('chromium', 'google-chrome', 'chrome'))), None)
DRIVER = shutil.which('chromedriver')
needs_browser = pytest.mark.skipif(
  not (BROWSER and DRIVER), reason='needs a browser: chromium and chromedriver are not installed'
)
CANVASES = 18  # more than a browser has WebGL contexts for


def test_embeds_the_file_beside_its_canvas():
  text = viewer.embed('a"b', b'glTF', size=10, group='g', azimuth=45)
  assert '<canvas class="viewer" data-glb="a&quot;b" data-group="g" data-azimuth="45"' in text
  (data,) = re.findall('<script type="text/plain" id="a&quot;b">(.*)</script>', text)
  assert base64.b64decode(data) == b'glTF'
  assert 'data-group' not in viewer.embed('a', b'', size=10)


def test_the_script_can_stand_in_a_page_that_loads_nothing():
  pages.check_alone(page.to_html([f'# Page\n\n{viewer.embed("a", b"glTF", size=10)}']))


def make_page(path, colors):
  """A page of boxes, the files of every second one compressed; the first two turn together."""
  parts = []
  for n, color in enumerate(colors):
    box = grid.ColoredVoxels(np.zeros((8,) * 3, bool), np.broadcast_to(color, (8, 8, 8, 3)))
    box.occupancy[2:6, 1:7, 2:6] = True
    export.write_glb(str(path.with_suffix('.glb')), box)
    glb = path.with_suffix('.glb').read_bytes()
    group = 'first two' if n < 2 else ''
    parts.append(viewer.embed(f'm{n}', gzip.compress(glb) if n % 2 else glb, size=64, group=group))
  path.write_text(f'<body>{"".join(parts)}<script>{viewer.SCRIPT}</script>')


@pytest.fixture
def browser():
  """A headless browser with WebGL."""
  options = webdriver.ChromeOptions()
  options.binary_location = BROWSER
  for argument in ('--headless=new', '--no-sandbox', '--enable-unsafe-swiftshader'):
    options.add_argument(argument)
  options.add_argument('--window-size=1400,900')
  driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(DRIVER))
  try:
    yield driver
  finally:
    driver.quit()


@needs_browser
def test_a_browser_shows_many_models_and_turns_groups_together(browser, tmp_path):
  colors = np.random.default_rng(0).uniform(0.3, 1, (CANVASES, 3))
  make_page(tmp_path / 'page.html', colors)
  browser.get((tmp_path / 'page.html').as_uri())
  canvases = browser.find_elements('css selector', 'canvas.viewer')

  def ask(script, *arguments):
    return browser.execute_script(script, *arguments)

  def pixel(canvas, share):
    at = "arguments[0].getContext('2d').getImageData"
    place = 'arguments[1] * arguments[0].width'
    return ask(f'return [...{at}({place}, {place}, 1, 1).data]', canvas, share)

  def pictures():
    """Of the first three, once all that was asked for is drawn."""
    browser.execute_async_script('requestAnimationFrame(() => requestAnimationFrame(arguments[0]))')
    return [ask('return arguments[0].toDataURL()', c) for c in canvases[:3]]

  def press(number, key):
    event = "new KeyboardEvent('keydown', {key: arguments[1]})"
    ask(f'arguments[0].dispatchEvent({event})', canvases[number], key)

  wait = support.WebDriverWait(browser, 60)
  wait.until(lambda _: all(pixel(c, 0.5)[3] for c in canvases))
  hues = np.array([pixel(c, 0.5)[:3] for c in canvases], float)
  hues /= hues.max(1, keepdims=True)
  np.testing.assert_allclose(hues, colors / colors.max(1, keepdims=True), atol=0.03)
  assert pixel(canvases[0], 0.02) == [0, 0, 0, 0]  # the page's own ground
  for number in (0, 2):
    press(number, 'ArrowUp')  # what was taken hold of no longer turns by itself
  before = pictures()
  assert pictures() == before
  press(1, 'ArrowRight')
  after = pictures()
  assert [a != b for a, b in zip(after, before, strict=True)] == [True, True, False]
