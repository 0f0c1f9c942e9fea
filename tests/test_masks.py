"""Which of the ways to an object's mask is taken."""

import numpy as np
import pytest

from cvn.errors import UserError
from cvn.photo import masks, matting

SHAPE = (120, 160)


def disc(radius=40):
  v, u = np.mgrid[0 : SHAPE[0], 0 : SHAPE[1]]
  return np.hypot(v - 60, u - 80) < radius


def picture(alpha=255, ground=(245, 245, 245)):
  rgb = np.empty((*SHAPE, 3), np.uint8)
  rgb[:] = ground
  rgb[disc()] = (200, 30, 40)
  return np.dstack([rgb, np.broadcast_to(np.uint8(alpha), SHAPE)])


def busy():
  rgba = picture()
  noise = np.random.default_rng(0).integers(0, 256, (*SHAPE, 3), np.uint8)
  rgba[~disc(), :3] = noise[~disc()]
  return rgba


def test_a_cut_out_needs_no_search():
  found = masks.find_mask(np.where(disc()[..., None], busy(), 0), 'a.png')
  assert found.source == 'alpha' and found.warnings == ()
  np.testing.assert_array_equal(found.alpha, 255 * disc())


def test_soft_edges_stay_and_shadows_and_noise_go():
  alpha = np.where(disc(), 255, 0)
  alpha[60, 120:122] = 90  # beside the disc
  alpha[105:110, 40:120] = 70  # a soft shadow
  alpha[5, 5] = 140  # a speck
  alpha[90:, :10] = 6
  found = masks.find_mask(picture(alpha), 'a.png')
  rest = found.alpha.copy()
  rest[disc()] = 0
  assert rest[60, 120] == 90 and rest.sum() <= 180
  assert found.warnings == ()


@pytest.mark.parametrize('kind', ['corners', 'few pixels', 'margin'])
def test_alpha_that_leaves_a_rectangle_is_no_cut_out(kind):
  alpha = np.full(SHAPE, 255)
  if kind == 'corners':
    for v in (slice(4), slice(-4, None)):
      alpha[v, :4] = alpha[v, -4:] = 0
  elif kind == 'few pixels':
    alpha[10, 20:30] = 0
  else:
    alpha[:8] = alpha[:, :8] = 0
  found = masks.find_mask(picture(alpha), 'a.png')
  assert found.source == 'ground'
  inside = disc()
  assert ((found.alpha > 0) ^ inside).sum() < 0.02 * inside.sum()


def test_a_rectangle_without_an_object_inside_is_the_object():
  rgba = picture(np.where(disc(70), 255, 0) * 0)
  rgba[30:90, 40:120] = (10, 20, 30, 255)
  found = masks.find_mask(rgba, 'a.png')
  assert found.source == 'alpha' and (found.alpha > 0).sum() == 60 * 80
  assert 'the shape of a rectangle' in found.warnings[0]


def test_glass_is_made_opaque_with_a_doubt():
  found = masks.find_mask(picture(np.where(disc(), 100, 0)), 'a.png')
  np.testing.assert_array_equal(found.alpha, 255 * disc())
  assert 'transparent object' in found.warnings[0]


@pytest.mark.parametrize('alpha', [0, 20])
def test_nothing_but_transparency_is_an_error(alpha):
  with pytest.raises(UserError, match='transparent everywhere'):
    masks.find_mask(picture(alpha), 'a.png')


def test_a_given_mask_overrides_alpha_and_ground():
  given = disc(20)
  found = masks.find_mask(busy(), 'a.png', given=given)
  assert found.source == 'mask'
  np.testing.assert_array_equal(found.alpha, 255 * given)
  half = masks.find_mask(picture(np.where(disc(), 130, 0)), 'a.png', given=given)
  np.testing.assert_array_equal(half.alpha, 130 * given)
  with pytest.raises(UserError, match='transparent wherever its mask is white'):
    masks.find_mask(picture(np.where(disc(), 0, 255)), 'a.png', given=given)


def test_rembg_comes_before_grabcut_and_both_are_doubted(monkeypatch):
  monkeypatch.setattr(matting, 'by_rembg', lambda rgb: disc())
  monkeypatch.setattr(matting, 'by_grabcut', lambda rgb: pytest.fail('not needed'))
  found = masks.find_mask(busy(), 'a.png')
  assert found.source == 'rembg' and 'rembg guessed the object' in found.warnings[0]
  np.testing.assert_array_equal(found.alpha, 255 * disc())
  monkeypatch.setattr(matting, 'by_rembg', lambda rgb: None)
  monkeypatch.setattr(matting, 'by_grabcut', lambda rgb: disc())
  assert masks.find_mask(busy(), 'a.png').source == 'grabcut'


def test_without_an_answer_the_error_says_what_is_missing_and_what_to_give(monkeypatch):
  def missing(rgb):
    raise matting.UnavailableError('rembg is not installed')

  monkeypatch.setattr(matting, 'by_rembg', missing)
  monkeypatch.setattr(matting, 'by_grabcut', lambda rgb: None)
  with pytest.raises(UserError, match='rembg is not installed') as e:
    masks.find_mask(busy(), 'a.png')
  assert '--mask=FILE' in str(e.value) and 'plain background' in str(e.value)


@pytest.mark.parametrize('size', [(12, 16), (1500, 2000)])
def test_tiny_and_large_pictures(size):
  rgba = picture()
  rows = np.arange(size[0]) * SHAPE[0] // size[0]
  columns = np.arange(size[1]) * SHAPE[1] // size[1]
  found = masks.find_mask(rgba[rows][:, columns], 'a.png')
  expected = disc()[rows][:, columns]
  assert ((found.alpha > 0) ^ expected).sum() <= 0.02 * expected.sum()


def test_a_small_object_is_searched_again_at_a_finer_scale():
  rgba = np.full((3000, 2000, 4), 255, np.uint8)
  small = disc()
  rgba[2000:2120, 300:460, :3][small] = (200, 30, 40)
  found = masks.find_mask(rgba, 'a.png')
  mask = found.alpha[2000:2120, 300:460] > 0
  assert (mask ^ small).sum() <= 0.01 * small.sum()
  assert (found.alpha > 0).sum() == mask.sum()
