"""The viewer of GLB files: what it puts into a page, and what a real browser makes of that."""

import base64
import gzip
import json
import re
import shutil
import subprocess

import numpy as np
import pytest

from cvn import export, grid
from experiments import viewer

BROWSER = next(filter(None, map(shutil.which, ('chromium', 'google-chrome', 'chrome'))), None)
CANVASES = 18  # more than a browser has WebGL contexts for


def test_embeds_the_file_beside_its_canvas():
  text = viewer.embed('a"b', b'glTF', size=10, group='g', azimuth=45)
  assert '<canvas class="viewer" data-glb="a&quot;b" data-group="g" data-azimuth="45"' in text
  (data,) = re.findall('<script type="text/plain" id="a&quot;b">(.*)</script>', text)
  assert base64.b64decode(data) == b'glTF'
  assert 'data-group' not in viewer.embed('a', b'', size=10)


def test_the_script_loads_nothing():
  assert 'http' not in viewer.SCRIPT and 'import' not in viewer.SCRIPT
  assert '</script' not in viewer.SCRIPT


# Tells the colours in the middle of all canvases, and near the edge of the first three before and
# after one of them was turned by key.
PROBE = """
const canvases = [...document.querySelectorAll('canvas.viewer')];
const pixel = (c, x, y) => [...c.getContext('2d').getImageData(x, y, 1, 1).data];
const picture = (c) => c.toDataURL();
const told = (c) => pixel(c, c.width / 2, c.height / 2);
const wait = (done) => new Promise((go) => {
  const look = () => done() ? go() : setTimeout(look, 20);
  look();
});
(async () => {
  await wait(() => canvases.every((c) => told(c)[3]));
  const press = (key) => canvases[0].dispatchEvent(new KeyboardEvent('keydown', {key}));
  press('ArrowUp');
  press('ArrowDown');  // no longer turning by itself
  canvases[2].dispatchEvent(new KeyboardEvent('keydown', {key: 'ArrowUp'}));
  await new Promise((go) => setTimeout(go, 200));
  const before = canvases.slice(0, 3).map(picture);
  press('ArrowRight');
  await wait(() => picture(canvases[0]) !== before[0] && picture(canvases[1]) !== before[1]);
  await new Promise((go) => setTimeout(go, 200));
  const turned = canvases.slice(0, 3).map((c, n) => picture(c) !== before[n]);
  const result = {colors: canvases.map(told), corner: pixel(canvases[0], 1, 1), turned};
  document.body.innerHTML = '<pre>' + JSON.stringify(result) + '</pre>';
})();
"""


@pytest.mark.slow
@pytest.mark.skipif(not BROWSER, reason='needs a browser: chromium is not installed')
def test_a_browser_shows_many_models_and_turns_groups_together(tmp_path):
  colors = np.random.default_rng(0).uniform(0.3, 1, (CANVASES, 3))
  parts = []
  for n, color in enumerate(colors):
    box = grid.ColoredVoxels(np.zeros((8,) * 3, bool), np.broadcast_to(color, (8, 8, 8, 3)))
    box.occupancy[2:6, 1:7, 2:6] = True
    export.write_glb(str(tmp_path / 'box.glb'), box)
    glb = (tmp_path / 'box.glb').read_bytes()
    group = 'first two' if n < 2 else ''
    parts.append(viewer.embed(f'm{n}', gzip.compress(glb) if n % 2 else glb, size=64, group=group))
  page = tmp_path / 'page.html'
  page.write_text(f'<body>{"".join(parts)}<script>{viewer.SCRIPT}</script><script>{PROBE}</script>')
  arguments = ['--headless', '--no-sandbox', '--enable-unsafe-swiftshader', '--dump-dom']
  arguments += ['--window-size=1400,900', f'--user-data-dir={tmp_path / "profile"}']
  arguments += ['--virtual-time-budget=60000', page.as_uri()]
  ran = subprocess.run([BROWSER, *arguments], capture_output=True, text=True, timeout=300)
  found = json.loads(re.search('<pre>(.*)</pre>', ran.stdout).group(1))
  hues = np.array(found['colors'])[:, :3].astype(float)
  hues /= hues.max(1, keepdims=True)
  np.testing.assert_allclose(hues, colors / colors.max(1, keepdims=True), atol=0.03)
  assert found['corner'] == [0, 0, 0, 0]  # the page's own ground
  assert found['turned'] == [True, True, False]
