"""Pictures of every kind become views in the training framing."""

import numpy as np
import pytest
from PIL import Image

from cvn import camera, grid, photo
from cvn.errors import UserError

RED, GREEN = (200, 30, 40), (20, 160, 60)
EXTENT = 160 * grid.OBJECT_EXTENT / camera.DISTANCE  # pixels, of 128


def _picture(width=300, height=200, ground=(245, 245, 245), box=(40, 20, 100, 140)):
  """An upright two-coloured box, red above green, on a plain ground."""
  left, top, right, bottom = box
  image = np.empty((height, width, 3), np.uint8)
  image[:] = ground
  image[top:bottom, left:right] = RED
  image[(top + bottom) // 2 : bottom, left:right] = GREEN
  return image


def _save(tmp_path, image, name='a.png', mode=None, **options):
  path = str(tmp_path / name)
  picture = image if isinstance(image, Image.Image) else Image.fromarray(image)
  if mode:
    picture = picture.convert(mode, palette=Image.Palette.ADAPTIVE)
  picture.save(path, **options)
  return path


def _check_box(view, tolerance=0):
  """The box of `_picture`, in the training framing: half as wide as tall, red above green."""
  assert view.shape == (128, 128, 4) and view.dtype == np.uint8
  mask = view[..., 3] > 128
  rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
  np.testing.assert_allclose(np.ptp(rows) + 1, EXTENT, atol=1 + tolerance)
  np.testing.assert_allclose(np.ptp(columns) + 1, EXTENT / 2, atol=1 + tolerance)
  np.testing.assert_allclose([rows.mean(), columns.mean()], 63.5, atol=0.6 + tolerance)
  np.testing.assert_allclose(view[40, 64, :3], RED, atol=8)
  np.testing.assert_allclose(view[88, 64, :3], GREEN, atol=8)
  assert view[2, 2, 3] == 0


@pytest.mark.parametrize(
  'name, mode, options',
  [
    ('a.png', 'RGB', {}),
    ('a.png', 'P', {}),
    ('a.png', 'RGBA', {}),
    ('a.jpg', 'RGB', {}),
    ('a.jpg', 'CMYK', {'quality': 95, 'subsampling': 0}),
    ('a.webp', 'RGB', {'quality': 90}),
    ('a.gif', 'P', {}),
    ('a.bmp', 'RGB', {}),
    ('a.tiff', 'RGB', {}),
    ('a.ppm', 'RGB', {}),
    ('a.tga', 'RGB', {}),
    ('no_suffix', 'RGB', {'format': 'PNG'}),
  ],
)
def test_every_format(tmp_path, name, mode, options):
  path = _save(tmp_path, _picture(), name, mode, **options)
  _check_box(photo.load_view(path), tolerance=0 if name == 'a.png' else 1)


@pytest.mark.parametrize('orientation', range(1, 9))
def test_exif_orientation_is_applied(tmp_path, orientation):
  stored = {
    2: Image.Transpose.FLIP_LEFT_RIGHT,
    3: Image.Transpose.ROTATE_180,
    4: Image.Transpose.FLIP_TOP_BOTTOM,
    5: Image.Transpose.TRANSPOSE,
    6: Image.Transpose.ROTATE_90,
    7: Image.Transpose.TRANSVERSE,
    8: Image.Transpose.ROTATE_270,
  }
  picture = Image.fromarray(_picture())
  if orientation in stored:
    picture = picture.transpose(stored[orientation])
  exif = Image.Exif()
  exif[0x0112] = orientation
  path = _save(tmp_path, picture, 'a.jpg', exif=exif, quality=95)
  _check_box(photo.load_view(path), tolerance=1)


def test_grey_of_8_and_16_bits_agree(tmp_path):
  grey = np.asarray(Image.fromarray(_picture()).convert('L'))
  view = photo.load_view(_save(tmp_path, grey, 'a.png'))
  deep = photo.load_view(_save(tmp_path, grey.astype(np.uint16) * 257, 'b.png'))
  real = photo.load_view(_save(tmp_path, grey.astype(np.float32) / 255, 'c.tiff'))
  np.testing.assert_array_equal(view, deep)
  np.testing.assert_array_equal(view, real)
  assert (view[..., 0] == view[..., 1]).all() and view[..., 3].max() == 255


def test_alpha_beats_background(tmp_path):
  rng = np.random.default_rng(0)
  rgba = np.dstack([rng.integers(0, 256, (200, 300, 3), np.uint8), np.zeros((200, 300), np.uint8)])
  rgba[20:140, 40:100, :3] = _picture()[20:140, 40:100]
  rgba[20:140, 40:100, 3] = 255
  _check_box(photo.load_view(_save(tmp_path, rgba)))


def test_transparent_palette_colour_is_background(tmp_path):
  picture = Image.fromarray(_picture()).convert('P', palette=Image.Palette.ADAPTIVE)
  index = picture.getpixel((0, 0))
  _check_box(photo.load_view(_save(tmp_path, picture, transparency=index)))


def test_no_background_bleeds_into_the_edge(tmp_path):
  rgba = np.dstack([_picture(ground=(0, 0, 255)), np.zeros((200, 300), np.uint8)])
  rgba[20:140, 40:100, 3] = 255
  view = photo.load_view(_save(tmp_path, rgba))
  assert view[view[..., 3] > 20][:, 2].max() < 70  # neither red nor green has more blue


def test_noisy_plain_border_and_a_speck(tmp_path):
  rng = np.random.default_rng(0)
  image = _picture(ground=(230, 230, 235)).astype(int) + rng.integers(-5, 6, (200, 300, 3))
  image[180:183, 280:283] = 0
  _check_box(photo.load_view(_save(tmp_path, np.uint8(image))))


def test_pale_object_in_a_framed_view_is_kept(tmp_path):
  image = np.full((128, 128, 3), 245, np.uint8)
  image[40:90, 50:70] = 252
  view = photo.load_view(_save(tmp_path, image))
  assert (view[..., 3] > 0).sum() == 50 * 20


def test_enclosed_ground_colour_is_a_gap_and_a_doubt(tmp_path):
  image = _picture()
  image[50:60, 60:80] = 245
  path = _save(tmp_path, image)
  found = photo.load_photo(path)
  assert (found.mask[50:60, 60:80] == 0).all() and (found.mask > 0).sum() == 60 * 120 - 200
  (warning,) = found.warnings
  assert warning.startswith(path) and 'enclosed areas in the colour of its background' in warning


def test_object_may_touch_the_border(tmp_path):
  view = photo.load_view(_save(tmp_path, _picture(height=140)))
  _check_box(view)


def test_small_pictures_are_enlarged_and_large_ones_shrunk(tmp_path):
  small = _picture(30, 20, box=(4, 2, 10, 14))
  _check_box(photo.load_view(_save(tmp_path, small)))
  large = np.asarray(Image.fromarray(_picture()).resize((2400, 1600), Image.Resampling.NEAREST))
  _check_box(photo.load_view(_save(tmp_path, large)))


def test_a_data_sets_view_keeps_its_framing(tmp_path):
  rgba = np.zeros((128, 128, 4), np.uint8)
  rgba[50:70, 45:75] = (*RED, 255)
  rgba[50, 45:75, 3] = 90
  path = _save(tmp_path, rgba)
  np.testing.assert_array_equal(photo.load_view(path), rgba)
  assert photo.load_photo(path).source == 'framed'
  on_grey = np.where(rgba[..., 3:] > 0, rgba[..., :3], np.uint8(245))
  view = photo.load_view(_save(tmp_path, on_grey))
  np.testing.assert_array_equal(view[..., 3] > 0, rgba[..., 3] > 0)
  np.testing.assert_array_equal(view[..., :3], on_grey)


@pytest.mark.parametrize('kind', ['corner', 'touching', 'noise', 'jpeg', 'size'])
def test_other_pictures_of_its_size_are_reframed_unless_a_flag_says_so(tmp_path, kind):
  size = 127 if kind == 'size' else 128
  image = np.full((size, size, 3), 245, np.uint8)
  boxes = {'corner': np.s_[5:25, 80:110], 'touching': np.s_[40:128, 40:90]}
  box = boxes.get(kind, np.s_[50:70, 45:75])
  image[box] = RED
  if kind == 'noise':
    image = np.uint8(image + np.random.default_rng(0).integers(-4, 5, image.shape))
  path = _save(tmp_path, image, 'a.jpg' if kind == 'jpeg' else 'a.png')
  view = photo.load_view(path)
  longer = max((view[..., 3] > 128).any(axis).sum() for axis in (0, 1))
  assert abs(longer - EXTENT) <= 1
  if kind == 'size':
    with pytest.raises(UserError, match='127 x 127 pixels: a framed view has 128 x 128'):
      photo.load_photo(path, framed=True)
    return
  kept = photo.load_photo(path, framed=True).view[..., 3] > 128
  assert kept[box].mean() > 0.98 and kept.sum() < 1.1 * kept[box].size


def test_noframed_reframes_a_data_sets_view(tmp_path):
  rgba = np.zeros((128, 128, 4), np.uint8)
  rgba[50:70, 45:75] = (*RED, 255)
  view = photo.load_photo(_save(tmp_path, rgba), framed=False).view
  assert abs((view[..., 3] > 128).any(0).sum() - EXTENT) <= 1


def test_a_mask_overrides_everything(tmp_path):
  noise = np.random.default_rng(0).integers(0, 256, (200, 300, 3), np.uint8)
  noise[20:140, 40:100] = _picture()[20:140, 40:100]
  path = _save(tmp_path, noise)
  mask = np.zeros((200, 300), np.uint8)
  mask[20:140, 40:100] = 255
  found = photo.load_photo(path, mask=_save(tmp_path, mask, 'mask.png'))
  assert found.source == 'mask' and found.warnings == ()
  np.testing.assert_array_equal(found.mask, mask)
  _check_box(found.view)


def test_masks_that_do_not_fit(tmp_path):
  path = _save(tmp_path, _picture())
  with pytest.raises(UserError, match=r'mask\.png has 300 x 199 pixels, its image 300 x 200'):
    photo.load_photo(path, mask=_save(tmp_path, np.ones((199, 300), np.uint8), 'mask.png'))
  with pytest.raises(UserError, match=r'empty\.png selects nothing'):
    photo.load_photo(path, mask=_save(tmp_path, np.zeros((200, 300), np.uint8), 'empty.png'))


def test_a_busy_background_is_an_error_that_says_what_to_give(tmp_path):
  noise = np.random.default_rng(0).integers(0, 256, (60, 60, 3), np.uint8)
  path = _save(tmp_path, noise)
  with pytest.raises(UserError, match='cannot be separated from the background') as e:
    photo.load_view(path)
  assert path in str(e.value) and '--mask=FILE' in str(e.value)


def test_other_sizes(tmp_path):
  view = photo.load_view(_save(tmp_path, _picture()), image_size=64)
  assert view.shape == (64, 64, 4)
  np.testing.assert_allclose((view[..., 3] > 128).any(1).sum(), EXTENT / 2, atol=1)


def test_errors_name_the_file_and_the_reason(tmp_path):
  def message(path):
    with pytest.raises(UserError) as e:
      photo.load_view(str(path))
    assert str(path) in str(e.value) and '\n' not in str(e.value)
    return str(e.value)

  assert 'does not exist' in message(tmp_path / 'missing.png')
  assert 'cannot be read' in message(tmp_path)  # a folder
  (tmp_path / 'text.png').write_text('hello')
  assert 'not a readable image' in message(tmp_path / 'text.png')
  (tmp_path / 'empty.png').write_bytes(b'')
  assert 'empty file' in message(tmp_path / 'empty.png')
  noise = np.random.default_rng(0).integers(0, 256, (60, 60, 3), np.uint8)
  for suffix in ('png', 'jpg', 'webp', 'tiff', 'gif', 'bmp'):
    whole = _save(tmp_path, noise, f'whole.{suffix}')
    with open(whole, 'rb') as f:
      data = f.read()
    (tmp_path / f'cut.{suffix}').write_bytes(data[: len(data) // 2])
    assert 'cannot be read' in message(tmp_path / f'cut.{suffix}')
  clear = np.zeros((9, 9, 4), np.uint8)
  assert 'transparent' in message(_save(tmp_path, clear, 'clear.png'))
  assert 'a single colour' in message(_save(tmp_path, np.full((9, 9, 3), 7, np.uint8), 'flat.png'))
  bomb = _save(tmp_path, Image.new('1', (20_000, 10_000)), 'bomb.png')
  assert 'shrink' in message(bomb)
