"""Pictures of every kind have the right colours; what unpacks to too much is refused unread."""

import io
import struct
import zlib

import numpy as np
import PIL.Image
import pytest

from cvn.errors import UserError
from datagen.reading.images import MAX_PIXELS, check_image, to_rgba

COLOR = (200, 100, 50)


def picture(size=(6, 4), color=COLOR):
  return PIL.Image.new('RGB', size, color)


def encoded(image, format, **options):
  stream = io.BytesIO()
  image.save(stream, format, **options)
  return stream.getvalue()


def decoded(content, max_side=2048):
  check_image(content)
  with PIL.Image.open(io.BytesIO(content)) as image:
    return to_rgba(image, max_side)


def png_header(width, height):
  """All of a PNG file but its pixels."""
  chunk = b'IHDR' + struct.pack('>IIBBBBB', width, height, 8, 2, 0, 0, 0)
  header = b'\x89PNG\r\n\x1a\n' + struct.pack('>I', 13) + chunk
  return header + struct.pack('>II4s', zlib.crc32(chunk), 0, b'IDAT')


@pytest.mark.parametrize(
  'format', ['PNG', 'JPEG', 'BMP', 'TGA', 'TIFF', 'WEBP', 'DDS', 'PPM', 'PCX']
)
def test_formats(format):
  pixels = decoded(encoded(picture(), format))
  assert pixels.shape == (4, 6, 4) and pixels.dtype == np.uint8
  np.testing.assert_allclose(pixels, np.broadcast_to([*COLOR, 255], pixels.shape), atol=3)


@pytest.mark.parametrize(
  ('mode', 'format'), [('CMYK', 'JPEG'), ('CMYK', 'TIFF'), ('YCbCr', 'TIFF'), ('LAB', 'TIFF')]
)
def test_colour_spaces(mode, format):
  pixels = decoded(encoded(picture().convert(mode), format))
  np.testing.assert_allclose(pixels[0, 0], [*COLOR, 255], atol=3)


def test_palette():
  color = decoded(encoded(picture().convert('P'), 'PNG'))[0, 0]
  np.testing.assert_allclose(color, [*COLOR, 255], atol=5)  # of the web's palette
  assert decoded(encoded(picture().convert('1'), 'PNG'))[..., :3].max() == 255


def test_transparency():
  clear = picture(color=(0, 255, 0))
  for image in (clear, clear.convert('L'), clear.convert('P')):
    key = image.getpixel((0, 0))
    assert decoded(encoded(image, 'PNG', transparency=key))[0, 0, 3] == 0
  half = picture().convert('RGBA')
  half.putalpha(128)
  for format in ('PNG', 'TGA', 'TIFF', 'WEBP'):
    assert decoded(encoded(half, format))[0, 0, 3] == 128
  assert list(decoded(encoded(half.convert('LA'), 'PNG'))[0, 0, 2:]) == [124, 128]


def test_deep_greys_are_not_cut_off():
  """PIL turns all above 255 of 65535 into white."""
  middle = np.full((4, 6), 0x8000)
  assert decoded(encoded(PIL.Image.fromarray(middle.astype(np.uint16)), 'PNG'))[0, 0, 0] == 128
  assert decoded(encoded(PIL.Image.fromarray(middle.astype(np.int32)), 'TIFF'))[0, 0, 0] == 128
  floats = np.array([[0.5, np.nan, 7.0]], np.float32)
  pixels = decoded(encoded(PIL.Image.fromarray(floats), 'TIFF'))
  assert pixels[0, :, 0].tolist() == [128, 0, 255]


def test_animations_show_their_first_frame():
  frames = [picture(), picture(color=(0, 0, 255))]
  for format in ('GIF', 'PNG', 'WEBP', 'TIFF'):
    content = encoded(frames[0], format, save_all=True, append_images=frames[1:])
    np.testing.assert_allclose(decoded(content)[0, 0], [*COLOR, 255], atol=5)


def test_orientation_is_that_of_the_pixels():
  """Texture coordinates mean the pixels as they are stored, whatever EXIF says of a photo."""
  exif = PIL.Image.Exif()
  exif[0x0112] = 6
  assert decoded(encoded(picture(), 'JPEG', exif=exif)).shape == (4, 6, 4)


@pytest.mark.parametrize('mode', ['RGB', 'RGBA', 'P', 'L'])
def test_shrinks(mode):
  pixels = decoded(encoded(picture((40, 10)).convert(mode), 'PNG'), max_side=16)
  assert pixels.shape == (4, 14, 4)
  grey = mode == 'L'
  np.testing.assert_allclose(pixels[0, 0, :3], [124] * 3 if grey else COLOR, atol=5)


@pytest.mark.parametrize(
  ('content', 'reason'),
  [
    (b'', 'not a readable image'),
    (b'<svg/>', 'not a readable image'),
    (b'\x89PNG\r\n\x1a\n', 'not a readable image'),
    (encoded(picture(), 'EPS'), 'not a readable image'),  # a program that an interpreter would run
    (png_header(8192, 8193), '8192 x 8193 pixels'),
    (png_header(30000, 30000), f'more than {MAX_PIXELS} pixels'),
    (png_header(2**31 - 1, 2**31 - 1), 'pixels'),
  ],
)
def test_what_is_refused(content, reason):
  with pytest.raises(UserError, match=reason):
    check_image(content)


def test_headers_are_enough():
  check_image(png_header(8192, 8192))


def test_truncated_pictures_are_errors():
  content = encoded(PIL.Image.effect_noise((64, 64), 50), 'PNG')[:1000]
  with pytest.raises(OSError):
    decoded(content)
