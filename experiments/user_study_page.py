"""The user study's page: one HTML file that needs nothing beside it, and no network.

A result is a sheet of pictures from all around, which the page turns. Sheets and pairs have names
that tell nothing of the methods: which is which stands in a file that the subjects never see.

Order and sides of the pairs are drawn in the browser, anew for each subject, from a seed that is
saved with the answers. They look like this, one file a subject:

  {"format": 1, "page": ..., "subject": ..., "seed": ..., "started": ..., "finished": ...,
   "answers": [{"pair": ..., "left": sheet, "right": sheet, "choice": sheet, "milliseconds": ...}]}
"""

import base64
import hashlib
import html
import json
from typing import NamedTuple

from experiments.user_study_script import SCRIPT

ANSWERS_FORMAT = 1
SUBJECT = r'[A-Za-z0-9_\-]{1,40}'  # a regular expression, of JavaScript and Python alike


class Sheet(NamedTuple):
  """Pictures of a result from all around, row by row in one image."""

  image: bytes  # WebP
  width: int  # of one picture, pixels
  height: int


class Pair(NamedTuple):
  """Two results to choose from."""

  picture: int
  sheets: tuple[str, str]  # names


class Study(NamedTuple):
  """All that the page shows."""

  about: str
  pictures: tuple[bytes, ...]  # PNG
  sheets: dict[str, Sheet]  # by name
  frames: int  # pictures on a sheet
  columns: int  # of a sheet
  pairs: dict[str, Pair]  # by name


def identify(study: Study) -> str:
  """A name of the page, another one for each content."""
  return hashlib.sha256(repr(study).encode()).hexdigest()[:12]


def render(study: Study) -> str:
  """The page as HTML."""
  content = {
    'page': identify(study),
    'format': ANSWERS_FORMAT,
    'frames': study.frames,
    'columns': study.columns,
    'pictures': [_encode(p) for p in study.pictures],
    'sheets': {k: s._replace(image=_encode(s.image))._asdict() for k, s in study.sheets.items()},
    'pairs': [{'name': k, **p._asdict()} for k, p in study.pairs.items()],
  }
  parts = {
    'style': _STYLE,
    'about': html.escape(f'Page {content["page"]}. {study.about}'),
    'pairs': str(len(study.pairs)),
    'subject': SUBJECT,
    'content': json.dumps(content),
    'script': SCRIPT,
  }
  text = _DOCUMENT
  for name, part in parts.items():
    text = text.replace('{' + name + '}', part, 1)
  return text


def _encode(image: bytes) -> str:
  return base64.b64encode(image).decode()


_DOCUMENT = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src data:;
  style-src 'unsafe-inline'; script-src 'unsafe-inline'">
<link rel="icon" href="data:,">
<title>Which 3D model do you prefer?</title>
<style>{style}</style>
</head>
<body>
<noscript><p>This page needs JavaScript.</p></noscript>

<main id="start" hidden>
<h1>Which 3D model do you prefer?</h1>
<p>You will see <b>{pairs} pairs</b> of 3D models. The two of a pair were made by computer programs
from one picture, which stands between them. Choose the one you like better as a model of the object
in the picture. If both seem alike, follow your first impression: there is no right or wrong, and no
time limit.</p>
<p>The models turn by themselves, so that you see all their sides.</p>
<table>
<tr><th><kbd>←</kbd> <kbd>→</kbd></th>
<td>choose the left or the right one, as do the buttons</td></tr>
<tr><th><kbd>↑</kbd> <kbd>↓</kbd></th><td>turn both, as does dragging them</td></tr>
<tr><th><kbd>Space</kbd></th><td>stop and go on turning</td></tr>
<tr><th><kbd>Backspace</kbd></th><td>back to the pair before</td></tr>
</table>
<form id="form">
<label for="subject">Your code; keep the one given or enter the one you were told, not your name:
</label>
<input id="subject" required pattern="{subject}" autocomplete="off" spellcheck="false"
  title="1 to 40 letters, digits, _ or -">
<button class="main">Start</button>
</form>
<p class="small">Your answers stay in this browser, also when you close or reload the page, until
you save them as a file at the end.</p>
</main>

<main id="pair" hidden>
<header>
<button id="back" type="button">Back</button>
<div id="bar" role="progressbar" aria-label="progress" aria-valuemin="0"><div></div></div>
<span id="progress" aria-live="polite"></span>
</header>
<h2 id="question" tabindex="-1">Which 3D model of this object do you prefer?</h2>
<div id="board">
<figure id="left"><canvas class="turntable" role="img" aria-label="left model"></canvas>
<div class="sides"></div><button class="main" type="button">← Left</button></figure>
<figure id="given"><img id="picture" alt="the picture"><figcaption>The picture</figcaption></figure>
<figure id="right"><canvas class="turntable" role="img" aria-label="right model"></canvas>
<div class="sides"></div><button class="main" type="button">Right →</button></figure>
</div>
<p class="small keys"><kbd>←</kbd> <kbd>→</kbd> choose <kbd>↑</kbd> <kbd>↓</kbd> or drag: turn
<kbd>Space</kbd> stop or go on <kbd>Backspace</kbd> back</p>
</main>

<main id="end" hidden>
<h1>Thank you</h1>
<p>That was the last pair. Save your answers now, and give the file to the person who invited
you.</p>
<p><button id="save" class="main" type="button">Save answers</button>
<button id="again" type="button">Back to the last pair</button></p>
<p id="saved" role="status"></p>
<p><button id="next" type="button" hidden>Next person on this computer</button></p>
</main>

<footer><span>{about}</span> <span id="who"></span>
<button id="reset" type="button" hidden>Start over</button></footer>
<script type="application/json" id="content">{content}</script>
<script>{script}</script>
</body>
</html>
"""

_STYLE = """
* { box-sizing: border-box; }
[hidden] { display: none !important; }
body { font: 17px/1.5 system-ui, sans-serif; color: #222; background: #fff; margin: 0;
  min-height: 100vh; display: flex; flex-direction: column; }
main { flex: 1; width: 100%; max-width: 1400px; margin: 0 auto; padding: 1em 1.2em; }
#start, #end { max-width: 700px; padding-top: 4vh; }
h1 { line-height: 1.2; }
h2 { font-size: 1.3em; font-weight: 600; text-align: center; margin: .5em 0 .6em; }
#question:focus-visible { outline: none; }
th { font-weight: normal; text-align: left; padding: .2em 1.2em .2em 0; white-space: nowrap; }
kbd { font: inherit; font-size: .85em; border: 1px solid #bbb; border-bottom-width: 2px;
  border-radius: 4px; padding: 0 .45em; background: #fafafa; }
form { margin: 1.6em 0; }
label { display: block; margin-bottom: .4em; }
input, button { font: inherit; padding: .45em 1em; border-radius: 6px; border: 1px solid #999;
  background: #fff; color: inherit; }
button { cursor: pointer; }
button:hover { background: #f0f0f0; }
button:disabled { opacity: .4; cursor: default; }
button.main { background: #2f63a0; border-color: #2f63a0; color: #fff; font-weight: 600; }
button.main:hover { background: #234d80; }
:focus-visible { outline: 3px solid #f0a030; outline-offset: 2px; }
header { display: flex; align-items: center; gap: 1em; }
#bar { flex: 1; height: 8px; border-radius: 4px; background: #e3e3e3; overflow: hidden; }
#bar div { height: 100%; background: #2f63a0; transition: width .2s; }
#progress { font-variant-numeric: tabular-nums; }
#board { display: grid; grid-template-columns: minmax(0, 1fr) 220px minmax(0, 1fr); gap: 1.2em;
  align-items: center; }
figure { margin: 0; text-align: center; }
#left, #right { background: #f6f6f6; border: 3px solid #ddd; border-radius: 10px; padding: .6em; }
#board figure { position: relative; }
#board .earlier { border-color: #9db8d8; }
#board .earlier::before { content: 'your choice before'; position: absolute; top: .3em; left: .8em;
  font-size: .82em; color: #2f63a0; }
#board .chosen { border-color: #2f63a0; }
.turntable { display: block; width: 100%; height: clamp(160px, 100vh - 415px, 560px);
  object-fit: contain; cursor: grab; touch-action: pan-y; }
.sides { display: flex; gap: .4em; margin: .4em 0 .7em; }
.sides canvas { flex: 1; min-width: 0; height: 74px; object-fit: contain; cursor: pointer;
  border-bottom: 3px solid transparent; }
.sides canvas.now { border-color: #888; }
#left button, #right button { width: 100%; }
#picture { width: 100%; border-radius: 6px; border: 1px solid #ddd; display: block; }
.small, footer { font-size: .82em; color: #555; }
.keys { text-align: center; }
.keys kbd:not(kbd + kbd) { margin-left: 1.2em; }
footer { max-width: 1400px; width: 100%; margin: 0 auto; padding: .5em 1.5em; display: flex;
  gap: 1.5em; align-items: center; }
footer button { margin-left: auto; padding: .1em .7em; }
@media (max-width: 760px) {
  #board { grid-template-columns: minmax(0, 1fr) minmax(0, 1fr); gap: .6em; }
  #given { grid-area: 1 / 1 / 2 / 3; width: 150px; margin: 0 auto; }
  .turntable { height: 60vw; }
  .sides canvas { height: 40px; }
  .keys { display: none; }
}
"""
