"""Images from strangers: checked before they are decoded, and converted to RGBA.

A few kilobytes can decode to gigabytes, and some formats are programs (EPS). So only formats of
textures are read, and only up to a number of pixels.
"""

import io
import warnings

import numpy as np
import PIL.Image

from cvn.errors import UserError

FORMATS = (
  'PNG', 'JPEG', 'BMP', 'DIB', 'TGA', 'GIF', 'TIFF', 'WEBP', 'AVIF', 'DDS', 'PPM', 'PCX', 'SGI',
)  # fmt: skip
KTX2 = b'\xabKTX 20\xbb'
MAX_PIXELS = 1 << 26  # of one picture: 8192 x 8192


def check_image(content: bytes) -> None:
  """Reads the header of an image file.

  Raises:
    UserError: it is not an image in one of the `FORMATS`, or has more than `MAX_PIXELS`.
  """
  with warnings.catch_warnings():
    warnings.simplefilter('ignore')  # of its size: that is what the check is about
    try:
      with PIL.Image.open(io.BytesIO(content), formats=FORMATS) as image:
        width, height = image.size
    except PIL.Image.DecompressionBombError as e:
      raise UserError(f'has more than {MAX_PIXELS} pixels') from e
    except MemoryError:
      raise
    except Exception as e:  # PIL's readers raise whatever a broken header leads them to
      if is_ktx2(content):
        raise UserError('is in KTX2 format (Basis), which cannot be read: convert it to PNG') from e
      raise UserError('is not a readable image: convert it to PNG or JPEG') from e
  if width * height > MAX_PIXELS:
    raise UserError(f'has {width} x {height} pixels, more than {MAX_PIXELS}')


def is_ktx2(content: bytes) -> bool:
  """Whether a file is a KTX2 texture, a GPU format that cannot be read here."""
  return content.startswith(KTX2)


def to_rgba(image: PIL.Image.Image, max_side: int) -> np.ndarray:
  """The first frame of an image, shrunk by whole factors until no side exceeds `max_side`.

  Returns:
    [H, W, 4] uint8.

  Raises:
    OSError, ValueError: its data are damaged.
  """
  shrink = -(-max(image.size) // max_side)
  if image.mode[0] in 'IF':  # 16 or 32 bits, or floats: PIL would cut them off at 255
    values = np.nan_to_num(np.asarray(image, np.float32))
    top = 1 if image.mode == 'F' else 65535
    image = PIL.Image.fromarray((values.clip(0, top) * (255 / top) + 0.5).astype(np.uint8))
  elif image.mode in ('RGB', 'L') and 'transparency' not in image.info:
    image = image.reduce(shrink)  # before alpha is added: it takes less memory
    shrink = 1
  return np.array(image.convert('RGBA').reduce(shrink))
