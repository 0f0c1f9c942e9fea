"""Charts for pages, as PNG and as SVG.

In a page the SVG takes the font and the text colour of the page, light or dark.
"""

import html
import io
import re

import matplotlib
import matplotlib.figure

from experiments.lib.page import Picture

INK = '#222222'  # replaced by the text colour of the page
STYLE = {
  'svg.fonttype': 'none',  # text stays text
  'svg.hashsalt': 'cvn',  # the same chart has the same bytes
  'font.size': 9,
  'axes.titlesize': 9.5,
  'text.color': INK,
  'axes.labelcolor': INK,
  'axes.edgecolor': INK,
  'xtick.color': INK,
  'ytick.color': INK,
  'axes.spines.top': False,
  'axes.spines.right': False,
  'axes.axisbelow': True,
  'legend.frameon': False,
}
DPI = 144
GRID = {'alpha': 0.18, 'color': INK, 'linewidth': 0.6}


def to_picture(figure: matplotlib.figure.Figure, name: str, caption: str) -> Picture:
  """A chart as a picture of a page; draw it within `matplotlib.rc_context(STYLE)`."""
  with matplotlib.rc_context(STYLE):
    svg, png = io.StringIO(), io.BytesIO()
    figure.savefig(svg, format='svg', transparent=True, metadata={'Date': None})
    figure.savefig(png, format='png', dpi=DPI, metadata={'Software': None})
  text = svg.getvalue()
  text = text[text.index('<svg') :].replace(INK, 'currentColor')
  # Names are global in a page, and several charts use the same ones.
  text = re.sub(r'(\bid="|url\(#|href="#)', rf'\g<1>{name}-', text)
  text = re.sub(r' xmlns(:xlink)?="[^"]*"', '', text).replace('xlink:href', 'href')
  # A style element would apply to the whole page; page.css has it instead.
  text = re.sub(r'<(metadata|style).*?</\1>', '', text, flags=re.DOTALL)
  text = re.sub(r'font: ([\d.]+)px [^;"]+', r'font-size: \1px', text)
  text = text.replace('<svg', f'<svg role="img" aria-label="{html.escape(caption)}"', 1)
  return Picture(name, png.getvalue(), caption, text)
