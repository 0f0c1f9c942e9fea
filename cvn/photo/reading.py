"""Image files -> upright 8-bit sRGB pixels with straight alpha.

An embedded colour profile (Display P3, Adobe RGB, CMYK, ...) is applied; without one, colours are
sRGB. Of an animation, the first frame is read. Values of 10 or 12 bits in a 16-bit file are
recognised by their maximum.
"""

import io
import warnings
from typing import NamedTuple

import numpy as np
import tifffile
from PIL import Image, ImageCms, ImageOps

from cvn.errors import UserError

try:
  import pillow_heif  # optional: pip install 'cvn[photo]'
except ImportError:
  pillow_heif = None

FORMATS = (
  *('PNG', 'JPEG', 'WEBP', 'AVIF', 'GIF', 'BMP', 'TIFF', 'JPEG2000', 'PPM', 'TGA'),
  *(('HEIF',) if pillow_heif else ()),
)
MAX_PIXELS = 100_000_000  # a decompression bomb otherwise

# First bytes (and where they stand) of formats that users try, and what to do about each.
_HEIC = 'convert it to JPEG or PNG' + ('' if pillow_heif else ", or pip install 'cvn[photo]'")
_KNOWN = (
  (b'ftyphe', 4, 'HEIC', _HEIC),
  (b'ftypmif1', 4, 'HEIC', _HEIC),
  (b'ftypmsf1', 4, 'HEIC', _HEIC),
  (b'ftypavi', 4, 'AVIF', 'convert it to JPEG or PNG'),
  (b'ftypcrx', 4, "a camera's raw file", 'develop it to JPEG or PNG'),
  (b'\x00\x00\x00\x0cJXL ', 0, 'JPEG XL', 'convert it to JPEG or PNG'),
  (b'\xff\x0a', 0, 'JPEG XL', 'convert it to JPEG or PNG'),
  (b'%PDF', 0, 'PDF', 'export the picture as JPEG or PNG'),
  (b'8BPS', 0, 'PSD', 'export it as PNG'),
  (b'\x76\x2f\x31\x01', 0, 'OpenEXR', 'convert it to a PNG'),
  (b'#?RADIANCE', 0, 'Radiance HDR', 'convert it to a PNG'),
  (b'FUJIFILMCCD-RAW', 0, "a camera's raw file", 'develop it to JPEG or PNG'),
)
_TIFF = (b'II*\x00', b'MM\x00*', b'II+\x00', b'MM\x00+')
_TIFF_COLORS = tuple(tifffile.PHOTOMETRIC[n] for n in ('MINISWHITE', 'MINISBLACK', 'RGB'))
_ORIENTATION = 0x0112  # EXIF's and TIFF's tag
_NEARLY_BLACK = 24  # of 255
_HIGHLIGHT = 16  # floats above 1 and up to here are brighter than white; larger ones count to 255


class Picture(NamedTuple):
  """A decoded image."""

  rgba: np.ndarray  # [H, W, 4] u8, sRGB and straight alpha
  warnings: tuple[str, ...]  # what was guessed on the way, as ends of sentences


def read_picture(path: str) -> Picture:
  """Reads an image file.

  Args:
    path: a file in one of FORMATS, with any suffix; any colour mode, 8 to 16 bits or float. EXIF
      orientation is applied.

  Raises:
    UserError: the file does not exist, is not an image, is damaged or too large, or has an
      unsupported format.
  """
  notes = []
  try:
    with warnings.catch_warnings():
      warnings.simplefilter('ignore')  # Pillow's: on size (checked here) and on damaged metadata
      image = _open_deep_tiff(path, notes) or _open(path)
      image = _to_8_bits(image, notes)
      rgba = np.asarray(_to_srgb(image, notes))
  except FileNotFoundError as e:
    raise UserError(f'{path} does not exist') from e
  except UserError:
    raise
  except Image.DecompressionBombError as e:
    raise UserError(f'{path} has more than {MAX_PIXELS} pixels: shrink it first') from e
  except Image.UnidentifiedImageError as e:
    raise UserError(_explain(path)) from e
  except Exception as e:  # damaged bytes make Pillow's parsers fail in every way there is
    reason = getattr(e, 'strerror', None) or str(e).split('\n', 1)[0] or type(e).__name__
    raise UserError(f'{path} cannot be read: {reason}') from e
  if rgba[..., :3].max(initial=0) <= _NEARLY_BLACK and rgba[..., 3].any():
    notes.append(f'is nearly black (its largest value is {rgba[..., :3].max()} of 255)')
  return Picture(rgba, tuple(notes))


def read_mask(path: str, size: tuple[int, int]) -> np.ndarray:
  """Reads a mask: an image of the photo's size, white (or opaque) on the object.

  Args:
    path: path of the mask.
    size: (height, width) of the upright photo.

  Returns:
    bool [height, width].

  Raises:
    UserError: the mask cannot be read, has another size or selects nothing.
  """
  rgba = read_picture(path).rgba
  if rgba.shape[:2] != tuple(size):
    raise UserError(
      f'{path} has {rgba.shape[1]} x {rgba.shape[0]} pixels, its image {size[1]} x {size[0]}:'
      ' a mask must have the size of the upright image'
    )
  opaque = rgba[..., 3].min() == 255
  level = rgba[..., :3].max(-1) if opaque else rgba[..., 3]
  mask = level >= 128
  if not mask.any():
    raise UserError(f'{path} selects nothing: the object is white (or opaque) in a mask')
  return mask


def _open(path):
  """The first frame, upright."""
  if pillow_heif:
    pillow_heif.register_heif_opener()
  with Image.open(path, formats=FORMATS) as image:
    if image.width * image.height > MAX_PIXELS:
      raise Image.DecompressionBombError
    image.load()
    return ImageOps.exif_transpose(image)


def _open_deep_tiff(path, notes):
  """A TIFF that Pillow does not read, or reads wrongly; None for other files."""
  with open(path, 'rb') as f:
    if f.read(4) not in _TIFF:
      return None
  with tifffile.TiffFile(path) as tiff:
    page = tiff.pages[0]
    # Pillow has no floats in several channels, and mixes up deep channels stored one by one.
    planar = page.planarconfig == tifffile.PLANARCONFIG.SEPARATE and page.samplesperpixel > 1
    real = page.sampleformat == tifffile.SAMPLEFORMAT.IEEEFP
    deep = page.samplesperpixel > 1 and page.bitspersample > (8 if planar else 16)
    if not (deep or real) or page.photometric not in _TIFF_COLORS:
      return None
    if page.imagewidth * page.imagelength > MAX_PIXELS:
      raise Image.DecompressionBombError
    values = page.asarray()
    if planar:
      values = np.moveaxis(values, 0, -1)
    orientation = page.tags.get(_ORIENTATION)
    profile = page.tags.get('InterColorProfile')
  values = _scale(values, notes)
  if page.photometric == tifffile.PHOTOMETRIC.MINISWHITE:
    values = 255 - values
  values = np.ascontiguousarray(values.reshape(*values.shape[:2], -1)[..., :4])
  image = Image.fromarray(values.squeeze(-1) if values.shape[-1] == 1 else values)
  if orientation:
    image.getexif()[_ORIENTATION] = orientation.value
  image = ImageOps.exif_transpose(image)
  if profile:
    image.info['icc_profile'] = profile.value
  return image


def _to_8_bits(image, notes):
  """Grey of 16 or 32 bits or floats -> 8 bits; other modes already have 8."""
  if not (image.mode.startswith('I') or image.mode == 'F'):
    return image
  grey = Image.fromarray(_scale(np.asarray(image), notes))
  grey.info = image.info
  return grey


def _scale(values, notes):
  """Numbers of any type and range -> u8."""
  if values.dtype == bool:
    return values * np.uint8(255)
  if values.dtype == np.uint8:
    return values
  real = np.issubdtype(values.dtype, np.floating)
  values = np.nan_to_num(values.astype(np.float32), posinf=np.inf, neginf=0)
  largest = float(values[np.isfinite(values)].max(initial=0))
  if real and largest <= _HIGHLIGHT:
    white = 1.0
    if largest > 1:
      notes.append(f'has values up to {largest:.3g}, cut off at 1')
  else:
    # Sensors and scanners write 10 or 12 bits into 16. A 16-bit picture as dark as that is black.
    levels = (255, 1023, 4095, 65535, *(() if real else (2**32 - 1,)))
    white = next((float(w) for w in levels if largest <= w), largest)
  return np.round(np.clip(values / white, 0, 1) * 255).astype(np.uint8)


def _to_srgb(image, notes):
  """RGBA in sRGB, by the embedded profile if there is a usable one."""
  profile = image.info.get('icc_profile')
  if image.mode == 'LAB':
    lab, srgb = (ImageCms.createProfile(name) for name in ('LAB', 'sRGB'))
    image = ImageCms.profileToProfile(image, lab, srgb, outputMode='RGB')
  elif profile:
    image = _apply_profile(image, profile, notes)
  return image.convert('RGBA')


def _apply_profile(image, profile, notes):
  alpha = None
  if image.mode not in ('L', 'RGB', 'CMYK'):
    rgba = image.convert('RGBA')
    image, alpha = rgba.convert('RGB'), rgba.getchannel('A')
  try:
    source = ImageCms.ImageCmsProfile(io.BytesIO(profile))
    space = source.profile.xcolor_space.strip()
    if image.mode == 'L' and space == 'RGB':
      image = image.convert('RGB')
    if 'srgb' not in (source.profile.profile_description or '').lower():
      if space != {'L': 'GRAY'}.get(image.mode, image.mode):
        raise ImageCms.PyCMSError(f'a profile of {space} colours in a picture of {image.mode}')
      target = ImageCms.createProfile('sRGB')
      intent = ImageCms.Intent.RELATIVE_COLORIMETRIC
      image = ImageCms.profileToProfile(image, source, target, intent, 'RGB')
  except (ImageCms.PyCMSError, OSError, ValueError, TypeError) as e:
    reason = str(e).split('\n', 1)[0]
    notes.append(f'has a colour profile that cannot be used ({reason}): colours are taken as sRGB')
  if alpha is not None:
    image = image.convert('RGB')
    image.putalpha(alpha)
  return image


def _explain(path):
  """The reason why Pillow does not recognise the file, and what to do."""
  with open(path, 'rb') as f:
    start = f.read(1024)
  if not start:
    return f'{path} is an empty file'
  for magic, at, name, advice in _KNOWN:
    if start[at : at + len(magic)] == magic:
      return f'{path} is {name}: {advice}'
  if b'<svg' in start.lower():
    return f'{path} is SVG, a drawing: export it as PNG'
  return f'{path} is not a readable image ({", ".join(FORMATS)}): convert it to PNG'
