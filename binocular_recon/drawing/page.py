# SPDX-License-Identifier: Apache-2.0
"""The page of the calibration report: its frame, its style and the parts of a section."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from string import Template


def section(title: str, words: str, *content: str) -> str:
    """Return a section with its title, an explanation and its figures and tables."""
    return (
        f'<section><h2>{title}</h2><p>{words}</p><div class="content">{"".join(content)}</div>'
        '</section>'
    )


def figure(picture: str, caption: str, *, wide: bool = False) -> str:
    """Return a picture with what it shows."""
    kind = ' class="wide"' if wide else ''
    return f'<figure{kind}>{picture}<figcaption>{caption}</figcaption></figure>'


def legend(*entries: tuple[str, str]) -> str:
    """Return the key to colours, given as (name, colour)."""
    return ' '.join(
        f'<span class="key"><i style="background:{color}"></i>{escape(name)}</span>'
        for name, color in entries
    )


def table(head: Sequence[str], rows: Iterable[Sequence[str]], *, kind: str = '') -> str:
    """Return a table; its cells are HTML."""
    top = ''.join(f'<th>{escape(name)}</th>' for name in head)
    body = ''.join('<tr>' + ''.join(f'<td>{cell}</td>' for cell in row) + '</tr>' for row in rows)
    return f'<table class="{kind}"><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table>'


PAGE = Template("""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>Stereo calibration</title>
<style>$style</style>
</head>
<body>
<header><h1>Stereo calibration</h1></header>
<main>
$sections
</main>
<footer>binocular_recon $version. Uncertainties are one standard deviation.</footer>
</body>
</html>
""")

STYLE = """
:root { color: #22313f; font: 16px/1.5 system-ui, 'Segoe UI', Helvetica, Arial, sans-serif; }
body { margin: 0; background: #f3f5f7; }
header { background: #0a3d4a; color: white; padding: 1.6rem max(1rem, calc(50% - 31rem)); }
h1 { margin: 0; font-weight: 600; font-size: 1.7rem; }
main, footer { max-width: 64rem; margin: 0 auto; padding: 1rem; }
footer { color: #71808f; font-size: .85rem; }
section, .notes, .good { background: white; border-radius: 6px; padding: 1.2rem 1.5rem;
  margin: 1.2rem 0; box-shadow: 0 1px 2px #0002; }
.notes { border-left: 5px solid #e0a13a; padding-left: 2.4rem; }
.good { border-left: 5px solid #0b7a75; }
h2 { margin: 0 0 .3rem; font-size: 1.2rem; }
section > p { margin: 0 0 1rem; color: #4a5a68; max-width: 48rem; }
.cards { list-style: none; display: grid; gap: .8rem;
  grid-template-columns: repeat(auto-fit, minmax(10.5rem, 1fr)); padding: 0; margin: 1.2rem 0; }
.cards li { background: white; border-radius: 6px; padding: .9rem 1.1rem;
  border-top: 4px solid #0b7a75; box-shadow: 0 1px 2px #0002; }
.cards b { display: block; font-size: 1.2rem; font-weight: 600; }
.cards span { color: #71808f; font-size: .85rem; line-height: 1.3; display: block; }
.content { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(27rem, 100%), 1fr));
  gap: 1.2rem 1.5rem; align-items: start; }
figure { margin: 0; }
.wide { grid-column: 1 / -1; }
figure svg, figure img { width: 100%; height: auto; display: block; }
figcaption { font-size: .85rem; color: #4a5a68; margin-top: .3rem; }
.key { margin-right: 1rem; white-space: nowrap; }
.key i { display: inline-block; width: .8em; height: .8em; border-radius: 2px;
  margin-right: .35em; }
table { border-collapse: collapse; font-size: .9rem; font-variant-numeric: tabular-nums;
  width: 100%; }
th { text-align: right; font-weight: 600; border-bottom: 2px solid #22313f;
  padding: .25rem .6rem; }
td { text-align: right; border-bottom: 1px solid #e4e9ee; padding: .22rem .6rem; }
th:first-child, td:first-child { text-align: left; }
.total tbody tr:last-child td { font-weight: 600; border-top: 2px solid #22313f; }
.pictures { grid-column: 1 / -1; display: grid; gap: 1rem 1.5rem;
  grid-template-columns: repeat(auto-fill, minmax(min(27rem, 100%), 1fr)); }
figure img { border-radius: 3px; }
.left-out figcaption { color: #c8553d; }
.advice { grid-column: 1 / -1; margin: 0; padding-left: 1.3rem; }
@media print { body { background: white; } section { break-inside: avoid; box-shadow: none; } }
"""
