"""Files of pictures -> upright sRGB: colour profiles, deep pixels, formats that are not read."""

import io

import numpy as np
import pytest
import tifffile
from PIL import Image, ImageCms

from cvn.errors import UserError
from cvn.photo import reading

COLORS = np.array([[200, 40, 40], [40, 70, 200], [40, 150, 60], [245, 245, 245]], np.uint8)
PATCHES = COLORS.reshape(2, 2, 3).repeat(16, 0).repeat(16, 1)


def profile_of(primaries):
  """An RGB profile: linear light is the given matrix times XYZ's (D50), gamma 2.2."""

  def number(x):
    return round(x * 65536).to_bytes(4, 'big', signed=True)

  def xyz(values):
    return b'XYZ \0\0\0\0' + b''.join(map(number, values))

  curve = b'curv\0\0\0\0' + (1).to_bytes(4, 'big') + (round(2.2 * 256)).to_bytes(2, 'big') + b'\0\0'
  text = b'desc\0\0\0\0' + (5).to_bytes(4, 'big') + b'wide\0' + b'\0' * 79
  tags = [(b'desc', text), (b'wtpt', xyz((0.9642, 1, 0.8249)))]
  tags += list(zip((b'rXYZ', b'gXYZ', b'bXYZ'), map(xyz, primaries), strict=True))
  tags += [(b'rTRC', curve), (b'gTRC', curve), (b'bTRC', curve)]
  table, data, start = b'', b'', 128 + 4 + 12 * len(tags)
  for name, value in tags:
    value += b'\0' * (-len(value) % 4)
    place = (start + len(data)).to_bytes(4, 'big')
    table += name + place + len(value).to_bytes(4, 'big')
    data += value
  body = len(tags).to_bytes(4, 'big') + table + data
  head = (128 + len(body)).to_bytes(4, 'big') + b'\0\0\0\0' + b'\x02\x10\0\0mntrRGB XYZ '
  head += b'\0' * 12 + b'acsp' + b'\0' * 28 + b''.join(map(number, (0.9642, 1, 0.8249)))
  return head.ljust(128, b'\0') + body


# Bruce Lindbloom's matrices, adapted to D50: rows are red, green, blue.
ADOBE_RGB = profile_of(
  [(0.60974, 0.31111, 0.01947), (0.20528, 0.62567, 0.06087), (0.14919, 0.06322, 0.74457)]
)
SRGB = ImageCms.ImageCmsProfile(ImageCms.createProfile('sRGB')).tobytes()


def save(tmp_path, image, name='a.png', **options):
  path = str(tmp_path / name)
  (image if isinstance(image, Image.Image) else Image.fromarray(image)).save(path, **options)
  return path


def in_profile(profile):
  """The patches in numbers of another profile."""
  source, target = (ImageCms.ImageCmsProfile(io.BytesIO(p)) for p in (SRGB, profile))
  intent = ImageCms.Intent.RELATIVE_COLORIMETRIC
  return ImageCms.profileToProfile(Image.fromarray(PATCHES), source, target, intent)


@pytest.mark.parametrize('name', ['a.png', 'a.tif', 'a.webp'])
def test_wide_colours_come_back_as_srgb(tmp_path, name):
  stored = in_profile(ADOBE_RGB)
  assert np.abs(np.asarray(stored).astype(int) - PATCHES).max() > 15
  options = {'lossless': True} if name == 'a.webp' else {}
  rgba, warnings = reading.read_picture(
    save(tmp_path, stored, name, icc_profile=ADOBE_RGB, **options)
  )
  assert warnings == ()
  np.testing.assert_allclose(rgba[..., :3].astype(int), PATCHES, atol=2)


def test_a_profile_leaves_alpha_alone(tmp_path):
  stored = in_profile(ADOBE_RGB).convert('RGBA')
  alpha = np.arange(32 * 32, dtype=np.uint32).reshape(32, 32).astype(np.uint8)
  stored.putalpha(Image.fromarray(alpha))
  rgba, _ = reading.read_picture(save(tmp_path, stored, icc_profile=ADOBE_RGB))
  np.testing.assert_array_equal(rgba[..., 3], alpha)
  np.testing.assert_allclose(rgba[..., :3].astype(int), PATCHES, atol=2)


def test_srgb_stays_bit_for_bit(tmp_path):
  rgba, _ = reading.read_picture(save(tmp_path, PATCHES, icc_profile=SRGB))
  np.testing.assert_array_equal(rgba[..., :3], PATCHES)


@pytest.mark.parametrize('profile', [b'nonsense', ADOBE_RGB[:200]])
def test_a_broken_profile_is_a_doubt(tmp_path, profile):
  rgba, (warning,) = reading.read_picture(save(tmp_path, PATCHES, 'a.tif', icc_profile=profile))
  assert 'profile that cannot be used' in warning
  np.testing.assert_array_equal(rgba[..., :3], PATCHES)


def test_a_profile_of_other_colours_is_a_doubt(tmp_path):
  press = Image.fromarray(PATCHES).convert('CMYK')
  path = save(tmp_path, press, 'a.tif', icc_profile=ADOBE_RGB)
  rgba, (warning,) = reading.read_picture(path)
  assert 'a profile of RGB colours in a picture of CMYK' in warning
  np.testing.assert_allclose(rgba[..., :3].astype(int), PATCHES, atol=2)


def test_lab(tmp_path):
  to_lab = (ImageCms.createProfile(n) for n in ('sRGB', 'LAB'))
  lab = ImageCms.profileToProfile(Image.fromarray(PATCHES), *to_lab, outputMode='LAB')
  rgba, _ = reading.read_picture(save(tmp_path, lab, 'a.tif'))
  np.testing.assert_allclose(rgba[..., :3].astype(int), PATCHES, atol=10)  # Lab of 8 bits is coarse


@pytest.mark.parametrize('white', [255, 1023, 4095, 65535])
def test_bits_are_told_by_the_largest_value(tmp_path, white):
  grey = np.linspace(0, white, 256).round().astype(np.uint16).reshape(16, 16)
  rgba, _ = reading.read_picture(save(tmp_path, grey))
  np.testing.assert_allclose(rgba[..., 0].ravel(), np.arange(256), atol=1)


@pytest.mark.parametrize('white', [1, 255, 65535])
@pytest.mark.parametrize('channels', [1, 3, 4])
def test_floats(tmp_path, white, channels):
  values = np.linspace(0, white, 16 * 16 * channels, dtype=np.float32).reshape(16, 16, channels)
  values[0, 0, 0] = np.nan
  tifffile.imwrite(
    tmp_path / 'a.tif', values.squeeze(), photometric='rgb' if channels > 1 else 'minisblack',
    extrasamples=['unassalpha'] if channels == 4 else None,
  )  # fmt: skip
  rgba, _ = reading.read_picture(str(tmp_path / 'a.tif'))
  expected = np.nan_to_num(values / white) * 255
  count = max(3, channels)
  np.testing.assert_allclose(rgba[..., :count], np.broadcast_to(expected, (16, 16, count)), atol=1)


def test_highlights_above_white_are_cut_off_and_told(tmp_path):
  values = np.full((8, 8, 3), 0.5, np.float32)
  values[2, 2] = 4
  tifffile.imwrite(tmp_path / 'a.tif', values, photometric='rgb')
  rgba, (warning,) = reading.read_picture(str(tmp_path / 'a.tif'))
  assert 'cut off at 1' in warning
  assert rgba[0, 0, 0] in (127, 128) and rgba[2, 2, 0] == 255


@pytest.mark.parametrize('planar', ['contig', 'separate'])
@pytest.mark.parametrize('bits', [8, 16, 32])
def test_colours_of_any_depth_in_tiff(tmp_path, planar, bits):
  values = PATCHES.astype(f'u{bits // 8}') * np.array((2**bits - 1) // 255, f'u{bits // 8}')
  stored = np.moveaxis(values, -1, 0) if planar == 'separate' else values
  tifffile.imwrite(tmp_path / 'a.tif', stored, photometric='rgb', planarconfig=planar)
  rgba, _ = reading.read_picture(str(tmp_path / 'a.tif'))
  np.testing.assert_allclose(rgba[..., :3].astype(int), PATCHES, atol=1)


def test_deep_tiff_is_turned_upright(tmp_path):
  values = np.rot90(PATCHES).astype(np.float32) / 255  # a quarter anticlockwise
  extra = [(0x0112, 'H', 1, 6, True)]
  tifffile.imwrite(tmp_path / 'a.tif', values, photometric='rgb', extratags=extra)
  rgba, _ = reading.read_picture(str(tmp_path / 'a.tif'))
  np.testing.assert_array_equal(rgba[..., :3], PATCHES)


def test_a_black_picture_is_a_doubt(tmp_path):
  _, (warning,) = reading.read_picture(save(tmp_path, PATCHES // 16))
  assert 'nearly black' in warning


@pytest.mark.parametrize(
  ('start', 'name', 'advice'),
  [
    (b'\0\0\0\x18ftypheic', 'HEIC', 'JPEG or PNG'),
    (b'\0\0\0\x18ftypcrx ', 'raw file', 'JPEG or PNG'),
    (b'%PDF-1.7', 'PDF', 'PNG'),
    (b'8BPS\0\1', 'PSD', 'PNG'),
    (b'<?xml version="1.0"?><SVG width="9"/>', 'SVG', 'PNG'),
    (b'\x76\x2f\x31\x01', 'OpenEXR', 'PNG'),
    (b'\xff\x0a\xfa', 'JPEG XL', 'PNG'),
    (b'whatever', 'not a readable image', 'convert it to PNG'),
  ],
)
def test_other_formats_are_named(tmp_path, start, name, advice):
  path = tmp_path / 'a.jpg'
  path.write_bytes(start + bytes(100))
  with pytest.raises(UserError, match=name) as e:
    reading.read_picture(str(path))
  assert str(path) in str(e.value) and advice in str(e.value)


@pytest.mark.skipif(not reading.pillow_heif, reason='pillow-heif is not installed')
def test_heic(tmp_path):
  reading.pillow_heif.register_heif_opener()
  rgba, _ = reading.read_picture(save(tmp_path, PATCHES, 'a.heic', quality=-1))
  np.testing.assert_allclose(rgba[8:24:15, 8:24:15, :3], PATCHES[8:24:15, 8:24:15], atol=12)
