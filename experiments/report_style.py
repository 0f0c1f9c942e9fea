"""How the report's page looks: light or dark as the reader's system, on paper and on a phone."""

STYLE = """
:root { --ink: #1d2126; --soft: #626a73; --line: #d9dde2; --faint: #f4f5f7; --ground: #fff;
  --accent: #2f6fb5; --picture: #fff; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e4e7ea; --soft: #9aa3ad; --line: #363c43; --faint: #1f2429; --ground: #16191d;
    --accent: #82abd8; --picture: #f1f1f1; }
}
* { box-sizing: border-box; }
html { scroll-behavior: smooth; }
body { margin: 0 auto; max-width: 1120px; padding: 0 1.25rem 5rem; background: var(--ground);
  color: var(--ink); font: 16px/1.55 system-ui, 'Segoe UI', 'Helvetica Neue', Arial, sans-serif; }
header { padding-top: 3.5rem; }
h1 { font-size: clamp(1.7rem, 4.5vw, 2.5rem); line-height: 1.15; letter-spacing: -.02em; margin: 0;
  max-width: 22em; text-wrap: balance; }
h3 { font-size: 1.05rem; margin: 2.2rem 0 .6rem; color: var(--accent); }
h2 { font-size: 1.4rem; line-height: 1.25; letter-spacing: -.01em; margin: 0 0 .8rem; }
section { margin-top: 2.5rem; padding-top: 2rem; border-top: 1px solid var(--line); }
p, ul { max-width: 46rem; margin: .7rem 0; }
ul { padding-left: 1.2rem; }
li { margin: .25rem 0; }
a { color: var(--accent); text-decoration: none; }
a:hover { text-decoration: underline; }
.made, .caption, figcaption, .time { color: var(--soft); font-size: .875rem; }
.abstract { font-size: 1.06rem; }
.missing { color: var(--soft); border-left: 3px solid var(--line); padding-left: .8rem; }
nav { display: flex; flex-wrap: wrap; gap: .3rem 1.2rem; margin-top: 1.4rem; font-size: .9rem; }
code { font: .85em/1.5 ui-monospace, 'SF Mono', Consolas, 'Liberation Mono', monospace;
  background: var(--faint); padding: .1em .3em; border-radius: 3px; overflow-wrap: anywhere; }
figure { margin: 1.6rem 0; }
figcaption { margin-top: .5rem; max-width: 46rem; }
.table figcaption { margin: 0 0 .5rem; color: var(--ink); font-weight: 600; font-size: .95rem; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-size: .9rem; line-height: 1.35;
  border-top: 2px solid var(--ink); border-bottom: 2px solid var(--ink); }
thead { border-bottom: 1px solid var(--ink); }
th { font-weight: 400; }
thead th { color: var(--soft); vertical-align: bottom; }
thead .group { color: var(--ink); font-weight: 600; border-bottom: 1px solid var(--line);
  text-align: center; }
th, td { padding: .3rem .4rem; text-align: right; white-space: nowrap; }
tbody th, thead td { text-align: left; padding-left: 0; position: sticky; left: 0;
  background: var(--ground); }
tbody tr + tr { border-top: 1px solid var(--line); }
tbody th { min-width: 8rem; max-width: 13rem; white-space: normal; }
td { font-variant-numeric: tabular-nums; }
.start { padding-left: 1rem; }
.detail { color: var(--soft); font-size: .78rem; text-align: left; padding-left: 0; }
.best { font-weight: 700; }
.words th, .words td { text-align: left; vertical-align: top; white-space: normal; }
.words tbody th { white-space: nowrap; }
.plot { overflow-x: auto; }
.plot svg { width: 100%; height: auto; min-width: 560px; max-width: 860px; display: block; }
.plot svg * { stroke-linejoin: round; stroke-linecap: butt; }
.plot svg text { font-family: inherit !important; }
.picture img { max-width: 100%; display: block; background: var(--picture); padding: 8px;
  border-radius: 6px; }
.example .row { display: flex; flex-wrap: wrap; gap: .8rem; }
.example .row > div { flex: 1 1 0; min-width: 132px; max-width: 280px; }
.example span { display: block; text-align: center; font-size: .85rem; margin-top: .3rem; }
.example small { display: block; color: var(--soft); font-variant-numeric: tabular-nums; }
.view, .viewer { display: block; width: 100%; aspect-ratio: 1; border-radius: 6px;
  background: var(--faint); }
.viewer { cursor: grab; touch-action: pan-y; }
.viewer:active { cursor: grabbing; }
details { margin: .8rem 0; }
summary { cursor: pointer; }
.commands { padding-left: 2rem; font-size: .9rem; }
.commands li { margin: .35rem 0; color: var(--soft); }
.commands code { color: var(--ink); }
.commands code span { display: inline-block; max-width: 100%; }
@media (max-width: 640px) {
  body { padding: 0 .9rem 3rem; font-size: 15px; }
  header { padding-top: 2rem; }
  .example .row > div { flex-basis: 42%; max-width: none; }
}
@media print {
  :root { --ink: #000; --soft: #444; --line: #bbb; --faint: #f4f5f7; --ground: #fff; }
  body { max-width: none; font-size: 10pt; padding: 0; }
  nav { display: none; }
  figure, tr { break-inside: avoid; }
  h2 { break-after: avoid; }
  .scroll { overflow: visible; }
  table { font-size: 7.5pt; }
  th, td { padding: .15rem .3rem; }
}
"""
