# SPDX-License-Identifier: Apache-2.0
"""The HTML page of every report: its frame, its style and the parts of a section.

A page is one file that needs nothing from the network, for the screen and for print.
"""

from __future__ import annotations

import re
from base64 import b64encode
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path
from string import Template

import cv2

from binocular_recon import __version__
from binocular_recon.images import ByteImage


def page(
    title: str,
    sections: Iterable[str],
    footer: str = '',
    *,
    subtitle: str = '',
    logo: str = '',
    script: str = '',
) -> str:
    """Return a whole page.

    Parameters
    ----------
    title : str
        Plain text; on paper it stands at the foot of every page, too.
    sections : iterable of str
        HTML of each section.
    footer : str
        Plain text behind the name and the version of the package.
    subtitle : str
        Plain text below the title.
    logo : str
        HTML of an image beside the title.
    script : str
        JavaScript.

    """
    return _PAGE.substitute(
        title=escape(title),
        style=asset('page.css'),
        running=_css_string(title),
        subtitle=f'<p class="subtitle">{escape(subtitle)}</p>' if subtitle else '',
        logo=logo,
        sections='\n'.join(sections),
        footer=escape(f'binocular_recon {__version__}. {footer}'.strip()),
        script=f'<script>{script}</script>\n' if script else '',
    )


def asset(name: str) -> str:
    """Return the text of a file of the pages' style and scripts."""
    return Path(__file__).with_name('assets').joinpath(name).read_text(encoding='utf-8')


def _css_string(text: str) -> str:
    """Return a string of CSS; all but letters, digits and spaces as their number."""
    return "'" + ''.join(c if c.isalnum() or c == ' ' else f'\\{ord(c):x} ' for c in text) + "'"


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


def cards(entries: Iterable[tuple[str, str]], warned: Iterable[int] = ()) -> str:
    """Return key figures: (value, what it is), HTML; those numbered in ``warned`` stand out."""
    warned = set(warned)
    items = ''.join(
        f'<li{" class=warn" * (number in warned)}><b>{value}</b><span>{label}</span></li>'
        for number, (value, label) in enumerate(entries)
    )
    return f'<ul class="cards">{items}</ul>'


def colour_bar(colours: ByteImage, labels: Iterable[str]) -> str:
    """Return a bar of BGR colours (N, 3), with labels below at equal distances."""
    stops = ', '.join(f'rgb({red}, {green}, {blue})' for blue, green, red in colours.tolist())
    below = ''.join(f'<span>{escape(label)}</span>' for label in labels)
    return (
        f'<div class="scale"><i style="background:linear-gradient(to right, {stops})"></i>'
        f'<div>{below}</div></div>'
    )


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
<style>$style
@page { @bottom-left { content: $running; font: 8pt sans-serif; color: #5b6b78; }
  @bottom-right { content: counter(page) ' / ' counter(pages); font: 8pt sans-serif;
  color: #5b6b78; } }
</style>
</head>
<body>
<header><div class="masthead"><div><h1>$title</h1>$subtitle</div>$logo</div></header>
<main>
$sections
</main>
<footer>$footer</footer>
$script</body>
</html>
""")
