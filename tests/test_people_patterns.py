"""Cloth's pictures: colours, repetition, seamlessness around, and prints."""

import numpy as np
import pytest

from datagen.sources.people import patterns

COLORS = np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1]])
RGB = {tuple(c) for c in (255 * COLORS).astype(int).tolist()}


def _pattern(kind, **fields):
  return patterns.Pattern(kind, COLORS, 0.125, 3, 0.0, 5)._replace(**fields)


def _draw(kind, part='trunk', **fields):
  image = patterns.draw(_pattern(kind, **fields), part=part)
  assert image.shape == (patterns.SIZE, patterns.SIZE, 4) and image.dtype == np.uint8
  assert (image[..., 3] == 255).all()
  return image[..., :3]


def _at(image, u, v):
  return tuple(int(x) for x in image[int((1 - v) * len(image)), int(u * len(image))])


@pytest.mark.parametrize('kind', [k for k in patterns.KINDS if k != 'gradient'])
@pytest.mark.parametrize('part', ['trunk', 'arm', 'leg'])
def test_kinds_use_their_colours_only(kind, part):
  image = _draw(kind, part)
  found = {tuple(c) for c in np.unique(image.reshape(-1, 3), axis=0).tolist()}
  assert found <= RGB
  if part == 'trunk':
    assert len(found) > (0 if kind == 'plain' else 1)


@pytest.mark.parametrize('kind', [k for k in patterns.KINDS if k != 'halves'])
def test_pictures_close_around_the_body(kind):
  """Columns at the back's two sides differ no more than any two columns side by side do."""
  image = _draw(kind).astype(int)
  steps = np.abs(np.diff(image, axis=1)).sum((0, 2))
  assert np.abs(image[:, 0] - image[:, -1]).sum() <= steps.max()


def test_hoops_alternate_every_half_period_upwards():
  image = _draw('hoops')
  colors = [_at(image, 0.3, (k + 0.5) * 0.0625) for k in range(6)]
  assert colors == [(255, 0, 0), (0, 255, 0)] * 3
  assert (image == image[:, :1]).all()


def test_pinstripes_run_up_and_one_is_in_the_middle_of_the_chest():
  image = _draw('pinstripes')
  assert (image == image[:1]).all()
  assert _at(image, 0.49, 0.5) == _at(image, 0.51, 0.5)
  changes = (np.diff(image[0].astype(int), axis=0) != 0).any(1).sum()
  changes += (image[0, 0] != image[0, -1]).any()
  assert changes == 2 * 3


def test_halves_meet_in_the_middle():
  image = _draw('halves')
  assert _at(image, 0.49, 0.5) == (255, 0, 0) and _at(image, 0.51, 0.5) == (0, 255, 0)


def test_gradients_and_bands_lie_between_the_garments_ends():
  image = _draw('gradient', low=0.4, high=0.8)
  assert _at(image, 0.5, 0.2) == (255, 0, 0) and _at(image, 0.5, 0.9) == (0, 255, 0)
  np.testing.assert_allclose(_at(image, 0.5, 0.6), [127, 127, 0], atol=3)
  image = _draw('band', low=0.4, high=0.8)
  assert _at(image, 0.5, 0.63) == (0, 255, 0)
  assert _at(image, 0.5, 0.5) == _at(image, 0.5, 0.75) == (255, 0, 0)


def test_prints_change_their_place_alone_and_all_kinds_differ():
  seen = set()
  for seed in range(500):
    image = np.zeros((patterns.SIZE, patterns.SIZE, 4), np.uint8)
    patterns.add_print(
      np.random.default_rng(seed), image, np.array([1.0, 0.5, 0]), at=0.7, size=0.1, wide=2.0
    )
    rows, columns = np.nonzero(image.any(-1))
    u, v = (columns + 0.5) / patterns.SIZE, 1 - (rows + 0.5) / patterns.SIZE
    assert np.abs(v - 0.7).max() < 0.07 and np.abs(u - 0.5).max() < 0.14
    np.testing.assert_array_equal(image[rows[0], columns[0]], [255, 128, 0, 255])
    seen.add(image.tobytes())
  assert len(seen) == len(patterns.PRINTS) - 1 + 10  # ten digits


def test_colours_keep_apart():
  rng = np.random.default_rng(0)
  skin = np.array([0.9, 0.7, 0.6])
  for _ in range(50):
    first = patterns.unlike(rng, skin)
    second = patterns.unlike(rng, skin, first, distance=0.3)
    assert np.linalg.norm(first - skin) > 0.3
    assert min(np.linalg.norm(second - c) for c in (skin, first)) > 0.2
    pattern = patterns.sample(rng, first)
    assert pattern.kind in patterns.KINDS
    np.testing.assert_array_equal(pattern.colors[0], first)
