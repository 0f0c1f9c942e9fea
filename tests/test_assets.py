"""Pages, style sheets and scripts are files that come with the packages."""

import io
import re

import numpy as np
import pytest
from PIL import Image

from experiments.lib import assets

PAGES = (
  ('experiments.lib', 'page.html'),
  ('experiments.study', 'study.html'),
)


@pytest.mark.parametrize(('package', 'name'), PAGES)
def test_parts_are_put_in_their_places_as_they_are(package, name):
  places = {*re.findall(r'\$\{([a-z]+)\}', assets.read(package, name))}
  assert {'style', 'script'} <= places
  # A part may look like a place itself.
  page = assets.fill(package, name, **{place: f'<{place}>${{style}}' for place in places})
  assert all(f'<{place}>${{style}}' in page for place in places)


def test_pictures_come_back():
  image = np.random.default_rng(0).integers(0, 256, (3, 5, 3), np.uint8)
  np.testing.assert_array_equal(np.asarray(Image.open(io.BytesIO(assets.to_png(image)))), image)
