"""A viewer of GLB files in HTML pages, turned with the mouse, a finger or the arrow keys.

Nothing is loaded from elsewhere: `embed` puts a file into the page, and `SCRIPT`, once at the end
of the page, shows all embedded files.
"""

import base64
import html
from importlib import resources

SCRIPT = resources.files('experiments.lib').joinpath('viewer.js').read_text(encoding='utf-8')


def embed(name: str, glb: bytes, *, size: int, group: str = '', azimuth: float = 30) -> str:
  """The HTML of a canvas and of the file that it shows.

  Args:
    name: of the file in the page, unique there.
    glb: a file of cvn.export, plain or compressed by gzip.
    size: pixels of the canvas.
    group: canvases of one group turn together.
    azimuth: of the first view, degrees.
  """
  shared = f' data-group="{html.escape(group)}"' if group else ''
  return (
    f'<canvas class="viewer" data-glb="{html.escape(name)}"{shared} data-azimuth="{azimuth:g}"'
    f' width="{size}" height="{size}" tabindex="0"></canvas>'
    f'<script type="text/plain" id="{html.escape(name)}">{base64.b64encode(glb).decode()}</script>'
  )
