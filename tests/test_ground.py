"""Objects on plain and shaded grounds: what is ground, and what is doubtful."""

import io

import numpy as np
import pytest
from PIL import Image
from scipy import ndimage

from cvn.photo import ground

HEIGHT, WIDTH = 180, 240
V, U = np.mgrid[0:HEIGHT, 0:WIDTH]


def chair(*, stretcher=False):
  """A mask: a back, a seat, two legs; with a stretcher, the gap between them is enclosed."""
  mask = np.zeros((HEIGHT, WIDTH), bool)
  mask[40:100, 80:95] = mask[90:104, 80:160] = True
  mask[104:150, 80:92] = mask[104:150, 148:160] = True
  if stretcher:
    mask[138:146, 80:160] = True
  return mask


def paint(background, mask, color=(200, 60, 40)):
  image = np.broadcast_to(np.asarray(background, float), (HEIGHT, WIDTH, 3)).copy()
  image[mask] = color
  return np.clip(image, 0, 255).round().astype(np.uint8)


def iou(a, b):
  return (a & b).sum() / (a | b).sum()


def shadow(strength, blur):
  """A shadow on the floor, as a factor."""
  ellipse = ((U - 120) / 70) ** 2 + ((V - 150) / 14) ** 2 < 1
  return 1 - strength * ndimage.gaussian_filter(ellipse.astype(float), blur)[..., None]


GROUNDS = {
  'white': 255,
  'black': 0,
  'coloured': (90, 130, 200),
  'gradient': 255 - 60 * (V / HEIGHT)[..., None],
  'diagonal': np.array([250, 240, 220]) - 40 * ((U + V) / (HEIGHT + WIDTH))[..., None],
  'vignette': 235 * (1 - 0.35 * np.hypot((U - 120) / 120, (V - 90) / 90) ** 2)[..., None],
  'soft shadow': 250 * shadow(0.35, 6),
}


@pytest.mark.parametrize('name', GROUNDS)
@pytest.mark.parametrize('codec', ['png', 'jpeg', 'noise'])
def test_masks_on_plain_and_shaded_grounds(name, codec):
  image = paint(GROUNDS[name], chair())
  if codec == 'noise':
    noise = np.random.default_rng(0).normal(0, 5, image.shape)
    image = np.clip(image + noise, 0, 255).astype(np.uint8)
  if codec == 'jpeg':
    stream = io.BytesIO()
    Image.fromarray(image).save(stream, 'JPEG', quality=85)
    image = np.asarray(Image.open(stream))
  found = ground.find_object(image)
  assert found.sure and found.warnings == ()
  least = {'png': 0.999, 'jpeg': 0.94, 'noise': 0.93}[codec]
  assert iou(found.mask, chair()) >= least


@pytest.mark.parametrize('difference', [4, 8, 16])
def test_pale_objects_on_pale_grounds_are_found_and_doubted(difference):
  found = ground.find_object(paint(255, chair(), (255 - difference,) * 3))
  np.testing.assert_array_equal(found.mask, chair())
  assert ('hardly differs' in ' '.join(found.warnings)) == (difference < 12)


def test_enclosed_gaps_are_ground():
  found = ground.find_object(paint(240, chair(stretcher=True)))
  np.testing.assert_array_equal(found.mask, chair(stretcher=True))
  assert found.warnings == ('has 1 enclosed areas in the colour of its background: taken as gaps',)


def test_a_highlight_is_no_gap():
  disc = np.hypot(U - 120, V - 90) < 60
  image = paint(255, disc).astype(float)
  spot = np.exp(-((U - 120) ** 2 + (V - 97) ** 2) / 200)[..., None]
  image = np.where(disc[..., None], image + 260 * spot, image)
  assert (image[97, 120] >= 255).all()
  found = ground.find_object(np.clip(image, 0, 255).astype(np.uint8))
  np.testing.assert_array_equal(found.mask, disc)
  assert found.warnings == ()


def test_wall_and_floor():
  strips = np.where((V < 130)[..., None], (225, 225, 222), (170, 165, 160))
  found = ground.find_object(paint(strips, chair()))
  assert iou(found.mask, chair()) > 0.97
  assert found.warnings == ('has a background in two parts (wall and floor?): both are left out',)


def test_a_hard_shadow_is_a_doubt():
  found = ground.find_object(paint(250 * shadow(0.3, 0.5), chair()))
  assert 'it may be a shadow' in ' '.join(found.warnings)


@pytest.mark.parametrize('kind', ['bars', 'letter box', 'frame'])
def test_frames_and_letter_boxes_are_cut_off(kind):
  image = paint(255, chair())
  if kind == 'bars':
    image[:, :30] = image[:, -30:] = 0
  elif kind == 'letter box':
    image[:20] = image[-20:] = 10
  else:
    image[:8] = image[-8:] = image[:, :8] = image[:, -8:] = (90, 60, 20)
  found = ground.find_object(image)
  np.testing.assert_array_equal(found.mask, chair())
  assert found.warnings == ('has a frame or letter box, which was cut off',)


def test_a_box_is_no_frame():
  image = np.full((HEIGHT, WIDTH, 3), 240, np.uint8)
  image[20:160, 30:210] = (120, 80, 40)
  found = ground.find_object(image)
  assert found.mask.sum() == 140 * 180
  (warning,) = found.warnings
  assert 'fills a rectangle' in warning


def test_two_objects_are_a_doubt():
  two = chair() | np.roll(chair(), 90, 1)
  found = ground.find_object(paint(240, two))
  assert iou(found.mask, two) > 0.97
  assert 'shows 2 separate parts of similar size' in found.warnings[0]


def test_cut_off_objects_are_a_doubt():
  cropped = paint(240, chair())[:120]
  found = ground.find_object(cropped)
  np.testing.assert_array_equal(found.mask, chair()[:120])
  assert 'touches the edge' in ' '.join(found.warnings)


def test_nothing_but_ground_is_an_empty_mask():
  assert not ground.find_object(paint(GROUNDS['vignette'], np.zeros_like(chair()))).mask.any()


@pytest.mark.parametrize('kind', ['noise', 'stripes', 'blobs', 'bricks'])
def test_busy_backgrounds_are_no_ground(kind):
  rng = np.random.default_rng(0)
  noise = rng.uniform(0, 255, (HEIGHT, WIDTH, 3))
  if kind == 'stripes':
    noise = np.broadcast_to(255 * ((U // 6) % 2)[..., None], noise.shape)
  if kind == 'bricks':
    lines = (V % 24 < 3) | ((U + 20 * (V // 24 % 2)) % 40 < 3)
    noise = np.where(lines[..., None], 150, np.full_like(noise, 90))
  if kind == 'blobs':
    noise = ndimage.gaussian_filter(noise, (3, 3, 0))
    noise = 128 + 60 * (noise - noise.mean()) / noise.std()
  found = ground.find_object(paint(noise, chair()))
  assert found is None or not found.sure


def test_tiny_pictures_do_not_crash():
  for shape in [(1, 1, 3), (2, 5, 3), (9, 4, 3)]:
    found = ground.find_object(np.full(shape, 7, np.uint8))
    assert found is None or not found.mask.any()
