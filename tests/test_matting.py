"""GrabCut and rembg, where they are installed."""

import sys
import types

import numpy as np
import pytest
from scipy import ndimage

from cvn.photo import matting


def scene():
  """A red disc on blurred noise of green and blue."""
  rng = np.random.default_rng(0)
  rgb = ndimage.gaussian_filter(rng.uniform(0, 255, (120, 160, 3)), (3, 3, 0))
  rgb = 110 + 50 * (rgb - rgb.mean()) / rgb.std()
  rgb[..., 0] = 40
  v, u = np.mgrid[0:120, 0:160]
  disc = np.hypot(v - 60, u - 80) < 35
  rgb[disc] = (220, 60, 50)
  return np.clip(rgb, 0, 255).astype(np.uint8), disc


def test_grabcut_finds_what_differs_in_the_middle():
  pytest.importorskip('cv2')
  rgb, disc = scene()
  mask = matting.by_grabcut(rgb)
  assert (mask & disc).sum() / (mask | disc).sum() > 0.95
  np.testing.assert_array_equal(mask, matting.by_grabcut(rgb))  # the same each time


def test_grabcut_does_not_guess_where_nothing_differs():
  pytest.importorskip('cv2')
  noise = np.random.default_rng(0).integers(0, 256, (120, 160, 3), np.uint8)
  assert matting.by_grabcut(noise) is None


def test_missing_packages_are_named(monkeypatch):
  matting._session.cache_clear()
  monkeypatch.setitem(sys.modules, 'rembg', None)
  monkeypatch.setitem(sys.modules, 'cv2', None)
  with pytest.raises(matting.UnavailableError, match='rembg is not installed'):
    matting.by_rembg(scene()[0])
  with pytest.raises(matting.UnavailableError, match='OpenCV is not installed'):
    matting.by_grabcut(scene()[0])


def test_rembg_is_called_for_a_mask_alone(monkeypatch):
  rgb, disc = scene()

  def remove(image, *, session, only_mask):
    assert session == 'session' and only_mask
    return np.uint8(255) * disc

  stand_in = types.SimpleNamespace(remove=remove, new_session=lambda: 'session')
  matting._session.cache_clear()
  monkeypatch.setitem(sys.modules, 'rembg', stand_in)
  np.testing.assert_array_equal(matting.by_rembg(rgb), disc)
  matting._session.cache_clear()


def test_weights_that_cannot_be_loaded_are_told(monkeypatch):
  def new_session():
    raise OSError('no route to host')

  matting._session.cache_clear()
  monkeypatch.setitem(sys.modules, 'rembg', types.SimpleNamespace(new_session=new_session))
  with pytest.raises(matting.UnavailableError, match='no route to host'):
    matting.by_rembg(scene()[0])
