# SPDX-License-Identifier: Apache-2.0
"""The HTML page of every report: its frame, its style and the parts of a section.

A page is one file that needs nothing from the network, for the screen and for print.
"""

from __future__ import annotations

import re
from base64 import b64encode
from collections.abc import Iterable, Sequence
from html import escape
from string import Template

import cv2

from binocular_recon import __version__
from binocular_recon.images import ByteImage


def page(title: str, sections: Iterable[str], footer: str = '') -> str:
    """Return a whole page.

    Parameters
    ----------
    title : str
        Plain text.
    sections : iterable of str
        HTML of each section.
    footer : str
        Plain text behind the name and the version of the package.

    """
    return _PAGE.substitute(
        title=escape(title),
        style=_STYLE,
        sections='\n'.join(sections),
        footer=escape(f'binocular_recon {__version__}. {footer}'.strip()),
    )


def section(title: str, text: str, *content: str) -> str:
    """Return a section: its title, an explanation (HTML) and its figures and tables."""
    return (
        f'<section><h2>{escape(title)}</h2><p>{text}</p>'
        f'<div class="content">{"".join(content)}</div></section>'
    )


def figure(content: str, caption: str, *, kind: str = '') -> str:
    """Return a figure; content and caption are HTML. ``kind`` may be ``wide`` or ``left-out``."""
    attribute = f' class="{kind}"' if kind else ''
    return f'<figure{attribute}>{content}<figcaption>{caption}</figcaption></figure>'


def embedded_image(data: bytes, format_: str, text: str) -> str:
    """Return an image of the page: the bytes of a JPEG or PNG file, and what it shows."""
    plain = escape(re.sub('<.*?>', '', text), quote=True)
    encoded = b64encode(data).decode()
    return f'<img alt="{plain}" src="data:image/{format_};base64,{encoded}">'


def image_figure(image: ByteImage, caption: str, *, photo: bool = False) -> str:
    """Return a figure of a BGR image: a photo as JPEG, a map of colours exactly, as PNG."""
    suffix, format_ = ('.jpg', 'jpeg') if photo else ('.png', 'png')
    data = cv2.imencode(suffix, image)[1].tobytes()
    return figure(embedded_image(data, format_, caption), caption)


def legend(*entries: tuple[str, str]) -> str:
    """Return the key to colours, given as (name, CSS colour)."""
    return ' '.join(
        f'<span class="key"><i style="background:{color}"></i>{escape(name)}</span>'
        for name, color in entries
    )


def table(
    head: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    kind: str = '',
    marked: Iterable[int] = (),
) -> str:
    """Return a table; its cells are HTML. The rows numbered in ``marked`` stand out."""
    top = ''.join(f'<th>{escape(name)}</th>' for name in head)
    marked = set(marked)
    body = ''.join(
        ('<tr class="ours">' if number in marked else '<tr>')
        + ''.join(f'<td>{cell}</td>' for cell in row)
        + '</tr>'
        for number, row in enumerate(rows)
    )
    return f'<table class="{kind}"><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table>'


_PAGE = Template("""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>$title</title>
<style>$style</style>
</head>
<body>
<header><h1>$title</h1></header>
<main>
$sections
</main>
<footer>$footer</footer>
</body>
</html>
""")

_STYLE = """
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
.scroll { grid-column: 1 / -1; overflow-x: auto; }
.scroll th { white-space: normal; vertical-align: bottom; }
.scroll td { white-space: nowrap; }
tr.ours td { background: #eef6ee; }
th { text-align: right; font-weight: 600; border-bottom: 2px solid #22313f;
  padding: .25rem .6rem; }
td { text-align: right; border-bottom: 1px solid #e4e9ee; padding: .22rem .6rem; }
th:first-child, td:first-child { text-align: left; }
.total tbody tr:last-child td { font-weight: 600; border-top: 2px solid #22313f; }
.images { grid-column: 1 / -1; display: grid; gap: 1rem 1.5rem;
  grid-template-columns: repeat(auto-fill, minmax(min(27rem, 100%), 1fr)); }
figure img { border-radius: 3px; }
.left-out figcaption { color: #c8553d; }
.advice { grid-column: 1 / -1; margin: 0; padding-left: 1.3rem; }
.small { grid-column: 1 / -1; display: grid; gap: .9rem;
  grid-template-columns: repeat(auto-fill, minmax(18rem, 1fr)); }
@page { size: A4; margin: 14mm; }
@media print {
  :root { font-size: 11px; }
  body { background: none; print-color-adjust: exact; -webkit-print-color-adjust: exact; }
  header { background: none; color: inherit; padding: 0; }
  main, footer { max-width: none; padding: 0; }
  section, .notes, .good { box-shadow: none; padding: 0; }
  .notes, .good { padding: 0 0 0 1.5rem; }
  .cards li { box-shadow: none; border: 1px solid #e4e9ee; border-top: 4px solid #0b7a75; }
  h2, section > p { break-inside: avoid; break-after: avoid; }
  figure, table, tr, li, footer { break-inside: avoid; }
  footer { break-before: avoid; }
  thead { display: table-header-group; }
  .content, .images { grid-template-columns: repeat(2, minmax(0, 1fr)); }
  .small { grid-template-columns: repeat(3, minmax(0, 1fr)); }
  .scroll { overflow: visible; }
  .scroll table { font-size: .75rem; }
  .scroll th, .scroll td { white-space: normal; overflow-wrap: anywhere; padding: .2rem .3rem; }
}
"""
